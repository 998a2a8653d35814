"""The last step of perception: the rod found, on the detected points themselves (docs/perception.md).

Distance maps have a value for each pixel, and their valley lies up to 0.2 px beside the line, now to this side and now to that.
Where the thread runs along its epipolar lines, that is millimetres of depth. So the rod found is relaxed again, under E/B and

    E_back = Σ_c Σ_k w_k ρ(n·(p(x_k) − q_k))                    doo_ti.vision.image_energy

with q_k the middle of the detected points around the image of place k, and n across the line there. Along the line a place is
free, as which point is whose is found anew after each relaxation; but the last place of the rod moves no farther along its line
than that is wide, else rods would fold in depth between cameras close together. A start that is not exact is free as well: only
its place along the line is held, as firmly as ends of lines are found. Places without points of their direction near them have
no weight: the rod's stiffness alone bridges gaps.

Axes: A rods of as many image sets, C cameras, E edges, K places along an edge.
"""

from collections.abc import Sequence

import numpy as np
from scipy.spatial import cKDTree

from doo_ti.contact.surroundings import Surroundings
from doo_ti.relaxation.newton import Newton
from doo_ti.relaxation.relax import relax
from doo_ti.rod.types import Clamp, Clamps, Configuration, Material, Status
from doo_ti.vision.cameras import Rig
from doo_ti.vision.detection import Detection, thinned
from doo_ti.vision.distance_map import ALIKE, NEAR_PX, coverage
from doo_ti.vision.image_energy import AssignedPoints

ROUNDS, STILL_MM = 20, 0.01  # relaxations, until no vertex moves by more
TOLERANCE = 1e-5  # of their residuals: points, of which many pull, are known to f32
FIRST, LAST = np.s_[:, :, 0, 0], np.s_[:, :, -1, -1]  # of (A, C, E, K) places
NOISE_PX3 = 0.05  # N of docs: what a mark's noise is over its length of line
LEAST_TURN = 2.0  # rad over its length, of a rod of which T is taken
PLACES = 2  # along an edge, for the energy
NEIGHBOURS = 8  # points nearest to a place that are looked at: the nearest may be of a strand that crosses there
COVERED = 0.95  # share of a detected line with which a rod is one of the whole thread
FREE = 1e-3  # share that counts of a distance along the line


def sharpened(rods: Configuration, rig: Rig, detections: Sequence[Sequence[Detection]], material: Material, up: np.ndarray,
              surroundings: Surroundings, exact: np.ndarray, marks: int) -> tuple[Configuration, np.ndarray]:
    """``rods`` (A) with so many ``marks``, relaxed under E + ν E_back, with their first edges held where these are ``exact``
    (A,); and (A,) bool: those that are certified minima and still explain the lines. The others stay as they were."""
    every = np.arange(len(rods.start))
    start, quaternions = rods.start.copy(), rods.quaternions.copy()
    sound, moving = np.zeros(len(every), dtype=bool), every
    nu, stiffness = temperature(rods.vertices, marks) / (2 * NOISE_PX3), float(np.linalg.eigvalsh(material.bend).max())
    lines = line_trees(detections)
    given = _images_of_places(rig, rods.vertices)[0]
    width = np.nan_to_num([[[detection.width_px] for detection in images] for images in detections])
    end_weight = np.array([[NOISE_PX3 / detection.end_sigma**2 for detection in images] for images in detections])
    for _ in range(ROUNDS):
        here = Configuration(start, quaternions, rods.rest_length).take(moving)
        places, ways = _images_of_places(rig, here.vertices)
        points, tangents, found = lines_at(places, ways, [lines[row] for row in moving])
        weight = np.where(found, np.linalg.norm(ways, axis=-1) / PLACES, 0.0)
        along = tangents[LAST]
        slid = ((places[LAST] - given[moving][LAST]) * along).sum(axis=-1, keepdims=True)
        too_far, limit = np.abs(slid) > width[moving], given[moving][LAST] + width[moving] * np.sign(slid) * along
        points[LAST] = np.where(too_far, limit, points[LAST])
        tangents[LAST] = np.where(too_far, along[..., ::-1] * [1.0, -1.0], along)  # across the line: held along it
        loose = ~exact[moving]
        points[loose, :, 0, 0] = given[moving[loose]][FIRST]
        tangents[loose, :, 0, 0] = tangents[loose, :, 0, 0, ::-1] * [1.0, -1.0]
        weight[loose, :, 0, 0] = np.where(found[loose, :, 0, 0], end_weight[moving[loose]], 0.0)
        weight = nu[moving, None, None, None] * weight
        first, kind = here.frames[:, 0], np.where(exact[moving], Clamp.TANGENT, Clamp.FREE)
        solution = relax(here, material, Clamps(kind, Clamp.FREE, here.start, here.start, first, first), Newton(TOLERANCE),
                         up=up, precision="mixed", external=AssignedPoints(rig, points, tangents, weight, stiffness, FREE),
                         external_index=np.arange(len(moving)), **surroundings.arguments)
        start[moving], quaternions[moving] = solution.configuration.start, solution.configuration.quaternions
        sound[moving] = (solution.status == Status.CONVERGED) & solution.stable
        moved = np.abs(solution.configuration.vertices - here.vertices).max(axis=(1, 2))
        moving = moving[moved > STILL_MM]
        if not len(moving):
            break
    new = Configuration(start, quaternions, rods.rest_length)
    before, after = (coverage(rig, shape.vertices, every, detections, NEAR_PX).share for shape in (rods, new))
    sound &= (after >= np.minimum(before, COVERED)).all(axis=1)
    return Configuration(np.where(sound[:, None], start, rods.start),
                         np.where(sound[:, None, None], quaternions, rods.quaternions), rods.rest_length), sound


def temperature(vertices: np.ndarray, marks: int) -> np.ndarray:
    """(A,) 1/mm: T of :mod:`doo_ti.perception.shape_uncertainty`, how strongly rods (A, V, 3) with so many ``marks`` bend."""
    edges = np.diff(vertices, axis=1)
    length = np.linalg.norm(edges, axis=-1)
    turns = np.linalg.norm(np.diff(edges / length[..., None], axis=1), axis=-1)
    bending = (turns**2 * 2.0 / (length[:, :-1] + length[:, 1:])).sum(axis=1)
    return np.maximum(bending, LEAST_TURN**2 / length.sum(axis=1)) / (marks - 2)


def _images_of_places(rig: Rig, vertices: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(A, C, E, K, 2) px: where cameras see the places, and the images of their edges."""
    image = np.nan_to_num(rig.project(vertices).swapaxes(0, 1), nan=-1e6)
    edge = np.diff(image, axis=2)[:, :, :, None]
    return image[:, :, :-1, None] + ((np.arange(PLACES) + 0.5) / PLACES)[:, None] * edge, np.repeat(edge, PLACES, axis=3)


def line_trees(detections: Sequence[Sequence[Detection]]) -> list[list[tuple[np.ndarray, np.ndarray, cKDTree | None]]]:
    """Of each detection its points (N, 2), about one for each pixel of line, their directions, and a tree to search them; None
    without any."""
    lines = [[thinned(detection) for detection in images] for images in detections]
    return [[(points, direction, cKDTree(points) if len(points) else None) for points, direction in views] for views in lines]


def lines_at(places: np.ndarray, ways: np.ndarray, lines: list[list[tuple[np.ndarray, np.ndarray, cKDTree | None]]]
             ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The detected lines, of :func:`line_trees`, at ``places`` (A, C, …, 2) px of images that run along ``ways`` there: their
    points and unit tangents (A, C, …, 2), zero where there is none, and (A, C, …) bool: whether a point of like direction is
    near."""
    points, tangents = np.zeros((2, *places.shape))
    found = np.zeros(places.shape[:-1], dtype=bool)
    for row, c in np.ndindex(places.shape[:2]):
        seen, direction, tree = lines[row][c]
        if tree is None:
            continue
        way = ways[row, c][..., None, :]
        apart, nearest = tree.query(places[row, c], NEIGHBOURS)
        nearest = np.minimum(nearest, len(seen) - 1)
        cosine = (direction[nearest] * way).sum(axis=-1)
        alike = (apart <= NEAR_PX) & (np.abs(cosine) >= ALIKE * np.linalg.norm(way, axis=-1))
        share = (alike / np.maximum(alike.sum(axis=-1, keepdims=True), 1))[..., None]
        along = (share * np.sign(cosine)[..., None] * direction[nearest]).sum(axis=-2)
        points[row, c] = (share * seen[nearest]).sum(axis=-2)
        tangents[row, c] = along / np.maximum(np.linalg.norm(along, axis=-1, keepdims=True), 1e-9)
        found[row, c] = alike.any(axis=-1) & along.any(axis=-1)
    return points, tangents, found
