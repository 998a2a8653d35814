"""Random specimens: a rod of the virtual lab with all parameters drawn from one seed, and changes of its observations.

The rods have edges of 0.5 mm, smooth rest curvature and clips of any length, none of which are inputs of the fit. Every draw
has a random stream of its own: subsets, missing marks and wrong branches do not change which rods a seed gives.
"""

from dataclasses import dataclass, replace

import numpy as np

from doo_ti.io.scene import Synthesis
from doo_ti.lab.synthesis import synthesise
from doo_ti.rod.observations import Observations
from doo_ti.system.errors import InterruptedRunError

BEND, TWIST_RATIO = (1e5, 2e6), (0.3, 1.5)  # mm³ and 1, log-uniform
REST_CURVATURE_RMS, REST_CURVATURE_RANGE = (1 / 2000, 1 / 600), (4.0, 25.0)  # 1/mm and mm, log-uniform
LABEL_NOISE = (0.05, 0.2)  # mm
CLIP_STEP, CLIP_STEPS = 0.5, (2, 8)  # mm, and how many of them a clip has: 1 to 4 mm
PITCH, YAW = (0.3, 0.5), (0.2, 0.4)  # rad: the start points up, the end down and to the side
LARGEST_TILT_DEG = 1.5  # standard deviation of each component, so that few clips are tilted by more than 3°
FINE_EDGE = 0.5  # mm
MOST_DRAWS = 50
TURN = 2 * np.pi
SAME_SHAPE = 0.5
"""Shapes nearer than this, mm averaged over the marks, are the same equilibrium."""

# Keys of the random streams of a seed.
SUBSET, MISSING, WRONG = 1, 2, 3


@dataclass(frozen=True)
class Variant:
    """Changes of the observations of each specimen before they are fitted.

    observations  how many of them are kept, chosen at random
    missing       share of the marks that are made invalid; not the outermost two, from which the clamps follow
    wrong_branch  how many of those kept get the shape of another equilibrium, or a total twist with an error of a whole turn
    """

    observations: int = 60
    missing: float = 0.0
    wrong_branch: int = 0

    @property
    def label(self) -> str:
        parts = [f"{self.observations} observations"]
        parts += [f"{self.missing:.0%} of the marks missing"] if self.missing else []
        parts += [f"{self.wrong_branch} on a wrong branch"] if self.wrong_branch else []
        return ", ".join(parts)

    @property
    def slug(self) -> str:
        """The label for names of files."""
        return f"{self.observations}" + f"-missing-{self.missing:g}" * bool(self.missing) + (
            f"-wrong-{self.wrong_branch}" * bool(self.wrong_branch))


@dataclass(frozen=True)
class Specimen:
    """One rod with its observations; ``redrawn`` counts draws before it that found no stable equilibrium somewhere."""

    recipe: Synthesis
    observations: Observations
    redrawn: int


def drawn(seed: int, attempt: int = 0) -> Synthesis:
    """The recipe of a seed; ``attempt`` gives others of the same seed."""
    random = np.random.default_rng([seed, attempt])
    bend, ratio = log_uniform(random, BEND), log_uniform(random, TWIST_RATIO)
    start_pitch, end_pitch, yaw = random.uniform(*PITCH), -random.uniform(*PITCH), random.uniform(*YAW)
    start_clip, end_clip = CLIP_STEP * random.integers(CLIP_STEPS[0], CLIP_STEPS[1] + 1, size=2)
    return Synthesis(
        bend=bend, twist=bend * ratio, name=f"specimen_{seed}", source=f"specimen {seed}", fine_edge_mm=FINE_EDGE,
        clip_mm=(float(start_clip), float(end_clip)),
        start_direction=direction(start_pitch, 0.0), end_direction=direction(end_pitch, yaw),
        rest_curvature_rms_per_mm=log_uniform(random, REST_CURVATURE_RMS),
        rest_curvature_range_mm=log_uniform(random, REST_CURVATURE_RANGE),
        label_noise_mm=float(random.uniform(*LABEL_NOISE)), end_mark_noise=bool(random.random() < 0.5),
        clip_tilt_deg=float(random.uniform(0.0, LARGEST_TILT_DEG) * (random.random() < 0.5)),
        seed=int(random.integers(2**31)),
    )


def log_uniform(random: np.random.Generator, bounds: tuple[float, float]) -> float:
    return float(np.exp(random.uniform(*np.log(bounds))))


def direction(pitch: float, yaw: float) -> tuple[float, float, float]:
    """The unit vector at angles (rad) above the x-y plane and from x towards y."""
    x, y, z = np.cos(pitch) * np.cos(yaw), np.cos(pitch) * np.sin(yaw), np.sin(pitch)
    return float(x), float(y), float(z)


def specimen(seed: int, variant: Variant) -> Specimen:
    """The first draw of ``seed`` that can be synthesised, its observations as ``variant`` has them.

    Raises InterruptedRunError where none of ``MOST_DRAWS`` can.
    """
    for attempt in range(MOST_DRAWS):
        recipe = drawn(seed, attempt)
        try:
            observations = synthesise(recipe)
        except InterruptedRunError:
            continue
        return Specimen(recipe, changed(recipe, observations, seed, variant), attempt)
    raise InterruptedRunError(f"specimen {seed}: none of {MOST_DRAWS} draws found stable equilibria")


def changed(recipe: Synthesis, observations: Observations, seed: int, variant: Variant) -> Observations:
    """A subset of the observations, some on a wrong branch, some marks missing."""
    rows = np.arange(observations.count)
    if variant.observations < observations.count:
        rows = np.sort(stream(seed, SUBSET).choice(rows, size=variant.observations, replace=False))
    taken = observations.take(rows)
    if variant.wrong_branch:
        taken = on_wrong_branch(recipe, taken, rows, variant.wrong_branch, stream(seed, WRONG))
    return without_marks(taken, variant.missing, stream(seed, MISSING)) if variant.missing else taken


def stream(seed: int, key: int) -> np.random.Generator:
    return np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(key,)))


def without_marks(observations: Observations, share: float, random: np.random.Generator) -> Observations:
    """That share of the marks invalid and without coordinates, but never the two outermost ones of an observation."""
    missing = random.random(observations.valid.shape) < share
    missing[:, [0, -1]] = False
    vertices = np.where(missing[..., None], np.nan, observations.vertices)
    return replace(observations, vertices=vertices, valid=observations.valid & ~missing)


def on_wrong_branch(recipe: Synthesis, observations: Observations, rows: np.ndarray, count: int,
                    random: np.random.Generator) -> Observations:
    """``count`` observations with the marks of another equilibrium, or a total twist off by one turn, at random.

    rows  (D,) which of the recipe's observations these are

    The other equilibria are those that the far clip reaches by turning from the other direction, to end rotations one turn
    lower: clamps are then the same, the twist in the rod is not. The total twist stays that of the observation. Where the rod
    cannot be carried there, or snaps to the same shape, the total twist is off instead.
    """
    chosen = random.choice(observations.count, size=min(count, observations.count), replace=False)
    by_shape = random.random(len(chosen)) < 0.5
    turn = TURN * random.choice([-1.0, 1.0], size=len(chosen))
    vertices, total_twist = observations.vertices.copy(), observations.total_twist.copy()
    other = from_other_direction(recipe) if by_shape.any() else None
    for row, shape, off in zip(chosen, by_shape, turn, strict=True):
        apart = 0.0 if other is None else np.linalg.norm(other[rows[row]] - vertices[row], axis=-1).mean()
        if shape and apart > SAME_SHAPE:
            vertices[row] = other[rows[row]]
        else:
            total_twist[row] += off
    return replace(observations, vertices=vertices, total_twist=total_twist)


def from_other_direction(recipe: Synthesis) -> np.ndarray | None:
    """(R, V, 3) marks of the recipe with every end rotation one turn lower; None where the rod cannot follow."""
    lower = tuple(rotation - 360.0 for rotation in recipe.end_rotations_deg)
    try:
        return synthesise(replace(recipe, end_rotations_deg=lower)).vertices
    except InterruptedRunError:
        return None
