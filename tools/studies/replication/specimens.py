"""Specimens of a material: the shipped scene with other seeds, so that rest curvature and label noise differ; and those of
laboratories less close to the model."""

from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from doo_ti import Grid, Observations, Pairs, Rig, load_rig
from doo_ti.io.scene import Scene, Synthesis, load_scene
from doo_ti.lab.synthesis import synthesise
from doo_ti.rod.frames import rotation_matrix
from doo_ti.vision.render import RenderOptions
from doo_ti.vision.triangulation import TriangulationOptions, triangulate

SCENES = Path(__file__).resolve().parents[3] / "scenes"
SUTURES = ("nylon", "silk", "vicryl")  # in the order of the paper's tables
APART = 100  # between the seeds of a material's specimens: those of the scenes differ by less
OUTLIERS, OUTLIER_MM = 0.03, 5.0
TILT_DEG, FOCAL = 0.1, 0.003
ANY_PX = 100.0  # labels never contradict each other: a person triangulates all of them


@dataclass(frozen=True)
class Specimen:
    """One rod of a material, and its observations."""

    name: str
    recipe: Synthesis
    grid: Grid
    frame_weight: float
    observations: Observations


def scene(name: str) -> Scene:
    """A shipped scene of the virtual lab. Raises InputError where it is missing."""
    return load_scene(SCENES / f"{name}.toml")


def specimen(name: str, number: int, **changes) -> Specimen:
    """Specimen ``number`` of a material; 0 is the rod of the shipped scene. ``changes`` are fields of its recipe."""
    shipped = scene(name)
    recipe = replace(shipped.observations, seed=shipped.observations.seed + APART * number, **changes)
    return Specimen(name, recipe, shipped.grid, shipped.frame_weight, replace(synthesise(recipe), name=name))


@dataclass(frozen=True)
class Laboratory:
    """What differs from the shipped scenes.

    changes     of the recipe
    outliers    whether 3 % of the marks are off by 5 mm
    calibrated  whether the rig is known up to 0.1° and 0.3 % of its focal lengths only
    look        of the images
    """

    name: str
    changes: dict = field(hash=False)
    outliers: bool = False
    calibrated: bool = True
    look: RenderOptions = RenderOptions()

    @property
    def labelled(self) -> "Laboratory":
        """What of it the labels depend on: laboratories with other images have the same rods and labels."""
        return replace(self, name="", look=RenderOptions())


CURVED = {"rest_curvature_rms_per_mm": 1 / 250, "rest_curvature_range_mm": 15.0}
PLASTIC = {"yield_curvature_per_mm": 0.03}
CLIPS = {"clip_tilt_deg": 3.0, "clip_offset_mm": 0.5, "clip_scatter_deg": 2.0}
OCCLUDED = RenderOptions(occluders=6, occluded_share=0.19)
LABORATORIES = (
    Laboratory("as shipped: rest curvature 1/900 mm⁻¹, labels 0.12 mm", {}),
    Laboratory("curved: smooth rest curvature, 1/250 mm⁻¹ rms", CURVED),
    Laboratory("plastic: yields at a curvature of 1/33 mm⁻¹", PLASTIC),
    Laboratory("clips: tilted by 3°, off by 0.5 mm, 2° anew in each observation", CLIPS),
    Laboratory("labels: 0.4 mm, 3 % of the marks off by 5 mm", {"label_noise_mm": 0.4}, outliers=True),
    Laboratory("calibration: cameras known to 0.1° and 0.3 %", {}, calibrated=False),
    Laboratory("occlusion: a fifth of the thread hidden in six places", {}, look=OCCLUDED),
    Laboratory("all of these", {**CURVED, **PLASTIC, **CLIPS, "label_noise_mm": 0.4}, True, False, OCCLUDED),
)


def made(name: str, number: int, laboratory: Laboratory) -> Specimen:
    """A specimen of the laboratory, as its user would have labelled it."""
    found = specimen(name, number, **laboratory.changes)
    random = np.random.default_rng([found.recipe.seed, 7])
    vertices = found.observations.vertices.copy()
    if not laboratory.calibrated:
        pixels = load_rig(SCENES / "rig.yaml").project(vertices.reshape(-1, 3))
        found_at = triangulate(calibrated(number), pixels, TriangulationOptions(sigma_px=ANY_PX)).position
        vertices = found_at.reshape(vertices.shape)
    if laboratory.outliers:
        inner = vertices[:, 2:-2]
        off = random.normal(size=inner.shape)
        off *= OUTLIER_MM / np.linalg.norm(off, axis=-1, keepdims=True)
        vertices[:, 2:-2] = inner + np.where(random.random(inner.shape[:2])[..., None] < OUTLIERS, off, 0.0)
    return replace(found, observations=replace(found.observations, vertices=vertices))


def calibrated(number: int) -> Rig:
    """The shipped rig with errors of calibration, other ones for each specimen."""
    random, rig = np.random.default_rng([2011, number]), load_rig(SCENES / "rig.yaml")
    cameras = []
    for camera in rig.cameras:
        matrix = camera.matrix.copy()
        matrix[0, 0] *= 1 + FOCAL * random.normal()
        matrix[1, 1] *= 1 + FOCAL * random.normal()
        turn = rotation_matrix(np.radians(TILT_DEG) * random.normal(size=3))
        cameras.append(replace(camera, matrix=matrix, rotation=turn @ camera.rotation, translation=turn @ camera.translation))
    return Rig(tuple(cameras), rig.source)


def forward(rods: Specimen) -> Pairs:
    """Eq. 3 only in the direction in which the clip was turned: rods then jump to other branches on the way."""
    distance, rotation = rods.observations.end_distance, rods.observations.end_rotation
    x, y = np.nonzero((distance[:, None] == distance) & np.isclose(rotation - rotation[:, None], 120.0))
    return Pairs(x, y, np.ones(len(x)), np.radians(rotation[y] - rotation[x]), "forward")
