"""The virtual lab: the paper's experiment (§V-A) on rods we make ourselves.

A rod of fine edges, a little curved at rest, hangs between two clips. The far clip is brought to each end distance and
turned through the end rotations, quasi-statically, as in the paper; its marks are then read off with label noise. Nothing
of that is in the model that is fitted, whose edges are longer, straight at rest and clamped at single edges.
"""

import numpy as np

from doo_ti.dataset import Observations
from doo_ti.errors import InterruptedRunError
from doo_ti.frames import (
    bishop_frames,
    matrix_from_quaternion,
    quaternion_about,
    quaternion_from_matrix,
    quaternion_product,
    smallest_rotation,
    total_twist,
)
from doo_ti.motion.path import LARGEST_TURN, carried_clamps, carry
from doo_ti.scene import Synthesis
from doo_ti.types import Clamp, Clamps, Configuration, Material, Solution

APPROACH_STEPS = 60
STEP_MM = 1.0


def synthesise(synthesis: Synthesis) -> Observations:
    """The observations of every end distance with every end rotation, distance running fastest.

    The same recipe gives the same observations, bit for bit. Raises InterruptedRunError where the rod cannot be carried
    to a stable equilibrium.
    """
    random = np.random.default_rng(synthesis.seed)
    return _labelled(synthesis, *_shapes(synthesis, random), random)


def fine_vertices(synthesis: Synthesis) -> np.ndarray:
    """(R, V_fine, 3) mm: the rods themselves behind :func:`synthesise`, clips included, ``fine_edge_mm`` to an edge.

    Raises InterruptedRunError as that does.
    """
    return _shapes(synthesis, np.random.default_rng(synthesis.seed))[0]


def _shapes(synthesis: Synthesis, random: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """(R, V_fine, 3) vertices of the whole rod, and the frames of the edges that were relaxed."""
    material = _specimen(synthesis, random)
    shapes, clamps = _brought_to_distances(synthesis, material)
    vertices, frames = [], []
    angles = np.radians(synthesis.end_rotations_deg)
    at = [f"{distance:g} mm" for distance in synthesis.end_distances_mm]
    for before, after in zip(np.concatenate([[0.0], angles]), angles):
        axis = clamps.end_frame[..., 0]
        steps = max(1, int(np.ceil(abs(after - before) / LARGEST_TURN)))
        path = carried_clamps(clamps, clamps.end_position, (after - before) * axis, steps)
        solution, clamps = carry(shapes, material, path)
        shapes = _sound(solution, synthesis, [f"{place}, {np.degrees(after):g}°" for place in at])
        vertices.append(_with_clips(synthesis, shapes))
        frames.append(shapes.frames)
    return np.concatenate(vertices), np.concatenate(frames)


def _specimen(synthesis: Synthesis, random: np.random.Generator) -> Material:
    """Θ with a random rest curvature, independent at each joint of the fine mesh and the same in every observation."""
    joints = _free_edges(synthesis) - 1
    rest = synthesis.rest_curvature_rms_per_mm * random.normal(size=(1, joints, 2))
    return Material(np.array(synthesis.bend), synthesis.twist, synthesis.weight, rest)


def _free_edges(synthesis: Synthesis) -> int:
    """Fine edges that are relaxed: of each clip only the innermost edge, which is clamped."""
    return round(synthesis.length_mm / synthesis.fine_edge_mm) - 2 * _clip_edges(synthesis)


def _clip_edges(synthesis: Synthesis) -> int:
    """Fine edges of a clip that are left out of the relaxed rod."""
    return round(synthesis.clip_mm / synthesis.fine_edge_mm) - 1


def _brought_to_distances(synthesis: Synthesis, material: Material) -> tuple[Configuration, Clamps]:
    """One rod per end distance at end rotation 0: from straight, the far clip comes to the largest distance, then closer."""
    first = _frame_along(synthesis.start_direction)
    last_tangent = np.array(synthesis.end_direction) / np.linalg.norm(synthesis.end_direction)
    turn = smallest_rotation(first[:, 0], last_tangent)
    offset = _clip_edges(synthesis) * synthesis.fine_edge_mm
    edges = _free_edges(synthesis)
    lengths = np.full(edges, synthesis.fine_edge_mm)
    start = offset * first[:, 0]
    shape = Configuration(start[None], np.tile(quaternion_from_matrix(first), (1, edges, 1)), lengths)
    held = dict(start=Clamp.FRAME, end=Clamp.FRAME, start_position=start[None], start_frame=first[None])
    clamps = Clamps(end_position=shape.vertices[:, -1], end_frame=first[None], **held)
    angle = 2 * np.arccos(np.clip(turn[0], -1, 1))
    rotation = angle * turn[1:] / max(np.linalg.norm(turn[1:]), 1e-300)
    found = {}
    steps = APPROACH_STEPS
    for distance in sorted(synthesis.end_distances_mm, reverse=True):
        goal = np.array([distance, 0.0, 0.0]) - offset * last_tangent
        path = carried_clamps(clamps, goal[None], rotation[None], steps)
        solution, clamps = carry(shape, material, path)
        shape = _sound(solution, synthesis, [f"{distance:g} mm"])
        found[distance] = shape.quaternions[0]
        rotation, steps = np.zeros(3), max(1, int(np.ceil(_gap(synthesis) / STEP_MM)))
    count = len(found)
    positions = np.array([[d, 0.0, 0.0] for d in synthesis.end_distances_mm]) - offset * last_tangent
    shapes = Configuration(np.tile(start, (count, 1)), np.stack([found[d] for d in synthesis.end_distances_mm]), lengths)
    last = np.tile(clamps.end_frame, (count, 1, 1))
    together = Clamps(Clamp.FRAME, Clamp.FRAME, shapes.start, positions, np.tile(first, (count, 1, 1)), last)
    return shapes, together


def _gap(synthesis: Synthesis) -> float:
    """The largest step between end distances, mm."""
    return float(np.max(np.abs(np.diff(np.sort(synthesis.end_distances_mm))), initial=STEP_MM))


def _frame_along(direction) -> np.ndarray:
    """A frame with t along ``direction`` and m1 as near to the y axis as it can be, else to x."""
    t = np.array(direction) / np.linalg.norm(direction)
    across = np.array([0.0, 1.0, 0.0]) if abs(t[1]) < 0.9 else np.array([1.0, 0.0, 0.0])
    return bishop_frames(t[None], across - (across @ t) * t)[0]


def _sound(solution: Solution, synthesis: Synthesis, places: list[str]) -> Configuration:
    bad = np.flatnonzero(~(solution.converged & solution.stable))
    if len(bad):
        raise InterruptedRunError(
            f"{synthesis.source}: synthesis: the rod found no stable equilibrium at {places[bad[0]]}; "
            "give end distances and rotations that it can follow")
    return solution.configuration


def _with_clips(synthesis: Synthesis, shapes: Configuration) -> np.ndarray:
    """(R, V_fine, 3) vertices of the whole rod, the straight parts inside the clips put back."""
    inner = shapes.vertices
    steps = (np.arange(_clip_edges(synthesis)) + 1.0)[:, None] * synthesis.fine_edge_mm
    tangents = shapes.frames[..., 0]
    before = inner[:, :1] - steps[::-1] * tangents[:, :1]
    after = inner[:, -1:] + steps * tangents[:, -1:]
    return np.concatenate([before, inner, after], axis=1)


def _labelled(synthesis: Synthesis, vertices: np.ndarray, frames: np.ndarray, random: np.random.Generator) -> Observations:
    """What a person would write down: marks with noise, the clips' frames, the twist to the nearest rotation step."""
    spacing = synthesis.length_mm / (synthesis.marks - 1)
    every = round(spacing / synthesis.fine_edge_mm)
    marks = vertices[:, ::every].copy()
    held = round(synthesis.clip_mm / spacing) + 1 if synthesis.clip_mm >= spacing else 1
    noise = synthesis.label_noise_mm * random.normal(size=marks.shape)
    noise[:, :held] = noise[:, -held:] = 0.0
    distances, rotations = len(synthesis.end_distances_mm), len(synthesis.end_rotations_deg)
    measured = None
    if synthesis.frames:
        clip = _clip_edges(synthesis)
        middle = np.clip(np.arange(synthesis.marks - 1) * every + every // 2 - clip, 0, frames.shape[1] - 1)
        wobble = synthesis.label_noise_mm * np.sqrt(2) / spacing * random.normal(size=(len(marks), synthesis.marks - 1, 3))
        wobble[:, : max(held - 1, 1)] = wobble[:, -max(held - 1, 1) :] = 0.0
        angle = np.linalg.norm(wobble, axis=-1)
        turn = quaternion_about(wobble / np.maximum(angle, 1e-300)[..., None], angle)
        measured = matrix_from_quaternion(quaternion_product(turn, quaternion_from_matrix(frames[:, middle])))
    twist = np.degrees(total_twist(quaternion_from_matrix(frames)))
    return Observations(
        vertices=marks + noise,
        rest_length=np.full(synthesis.marks - 1, spacing),
        start_frame=frames[:, 0],
        end_frame=frames[:, -1],
        frames=measured,
        total_twist=np.radians(30.0 * np.round(twist / 30.0) + 0.0),
        end_distance=np.tile(synthesis.end_distances_mm, rotations),
        end_rotation=np.repeat(synthesis.end_rotations_deg, distances),
        name=synthesis.name,
        source=synthesis.source,
    )
