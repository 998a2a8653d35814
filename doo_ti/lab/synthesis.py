"""The virtual lab: the paper's experiment (§V-A) on computed rods.

A rod of fine edges, a little curved at rest, hangs between two clips. The far clip is brought to each end distance and
turned through the end rotations, quasi-statically, as in the paper; the positions of the marks are then recorded with label
noise. The fitted model has none of that: its edges are longer, straight at rest, and its clamps hold single edges. The real
clips may be tilted and displaced independently, while the poses of ideal ones are reported (:class:`ClipErrors`).
"""

from dataclasses import dataclass, replace

import numpy as np

from doo_ti.io.scene import Synthesis
from doo_ti.motion.path import LARGEST_TURN, Motion, carry, motion_between
from doo_ti.relaxation.newton import Newton
from doo_ti.relaxation.relax import relax
from doo_ti.rod import frames as rotations
from doo_ti.rod.observations import Observations
from doo_ti.rod.shapes import material_curvature
from doo_ti.rod.types import Clamp, Clamps, Configuration, Material, Solution
from doo_ti.system.errors import InterruptedRunError

APPROACH_STEPS = 60
STEP_MM = 1.0
CLIP_STREAM = 1  # key of the clip errors' own random generator: rest curvature and label noise of a seed do not depend on them


@dataclass(frozen=True)
class ClipErrors:
    """How the two clips really hold a rod in D observations, the start's clip before the end's: tilted, and displaced from the
    pose that is reported. With the ideal clip's frame F and the outer end x of the rod in it, the real clip has

        F' = F exp([0, a, b])    x' = x + F (0, c, d)

    with tilts a, b (rad) about m1 and m2 and offsets c, d (mm) along them: the error turns with the clip.

    tilt     (2, 2) rad, about m1 and m2, the same in all observations
    offset   (2, 2) mm, along m1 and m2, likewise
    scatter  (D, 2, 2) rad, added to ``tilt``, different in each observation
    """

    tilt: np.ndarray
    offset: np.ndarray
    scatter: np.ndarray

    @staticmethod
    def drawn(seed: int, count: int, *, tilt: float, offset: float, scatter: float) -> "ClipErrors":
        """Gaussian errors for ``count`` observations; standard deviations of each component in rad and mm."""
        random = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(CLIP_STREAM,)))
        return ClipErrors(tilt * random.normal(size=(2, 2)), offset * random.normal(size=(2, 2)),
                          scatter * random.normal(size=(count, 2, 2)))

    @property
    def vary(self) -> bool:
        """Whether they differ from observation to observation."""
        return bool(self.scatter.any())

    @property
    def any(self) -> bool:
        """Whether there are errors at all."""
        return bool(self.tilt.any() or self.offset.any()) or self.vary

    def held(self, ideal: Clamps, reach: tuple[float, ...], rows: slice | None = None) -> Clamps:
        """The real clamps (R) of ideal ones (R).

        reach  mm from the rod's outer ends to the vertices that ``ideal`` names, along the rod
        rows   observations whose scatter is added, R of them; None: the constant errors alone
        """
        tilt = self.tilt if rows is None else self.tilt + self.scatter[rows]
        start = _real_clip(ideal.start_position, ideal.start_frame, reach[0], tilt[..., 0, :], self.offset[0])
        end = _real_clip(ideal.end_position, ideal.end_frame, -reach[1], tilt[..., 1, :], self.offset[1])
        return replace(ideal, start_position=start[0], start_frame=start[1], end_position=end[0], end_frame=end[1])


def _real_clip(position: np.ndarray, frame: np.ndarray, reach: float, tilt: np.ndarray, offset: np.ndarray):
    """(R, 3) positions ``reach`` along the rod from its outer end, and (R, 3, 3) frames, of one clip."""
    vector = np.concatenate([np.zeros_like(tilt[..., :1]), tilt], axis=-1)
    outer = position - reach * frame[..., 0] + frame[..., 1:] @ offset
    turned = frame @ rotations.rotation_matrix(vector)
    return outer + reach * turned[..., 0], turned


def synthesise(synthesis: Synthesis) -> Observations:
    """The observations of every end distance with every end rotation, distance running fastest.

    The same recipe gives the same observations, bit for bit. Raises InterruptedRunError where the rod cannot be carried
    to a stable equilibrium.
    """
    random = np.random.default_rng(synthesis.seed)
    return _labelled(synthesis, _rods(synthesis, random), random)


def fine_vertices(synthesis: Synthesis) -> np.ndarray:
    """(R, V_fine, 3) mm: the rods themselves behind :func:`synthesise`, clips included, ``fine_edge_mm`` to an edge. Raises
    InterruptedRunError as that does."""
    return _rods(synthesis, np.random.default_rng(synthesis.seed)).vertices


@dataclass(frozen=True)
class _Rods:
    """R rods at rest, one per observation.

    vertices  (R, V_fine, 3) of the whole rods
    frames    (R, E_relaxed, 3, 3) of the edges that were relaxed
    reported  the ideal clamps of the relaxed edges, or None where the rods are held by these
    """

    vertices: np.ndarray
    frames: np.ndarray
    reported: Clamps | None


def _rods(synthesis: Synthesis, random: np.random.Generator) -> _Rods:
    """Every end distance at every end rotation."""
    material = specimen_material(synthesis, random)
    count = len(synthesis.end_distances_mm) * len(synthesis.end_rotations_deg)
    errors = ClipErrors.drawn(synthesis.seed, count, tilt=np.radians(synthesis.clip_tilt_deg),
                              offset=synthesis.clip_offset_mm, scatter=np.radians(synthesis.clip_scatter_deg))
    shapes, ideal = _brought_to_distances(synthesis, material)
    clamps = ideal
    at = [f"{distance:g} mm" for distance in synthesis.end_distances_mm]
    if errors.any:
        clamps = errors.held(ideal, _reach(synthesis))
        shapes = _sound(_moved(shapes, material, ideal, clamps), synthesis, at)
    vertices, frames, reported = [], [], []
    angles = np.radians(synthesis.end_rotations_deg)
    for row, (before, after) in enumerate(zip(np.concatenate([[0.0], angles]), angles)):
        axis = ideal.end_frame[..., 0]
        steps = max(1, int(np.ceil(abs(after - before) / LARGEST_TURN)))
        path = list(Motion(ideal, end_turn=(after - before) * axis).states(steps))
        ideal = path[-1]
        held = (errors.held(step, _reach(synthesis)) for step in path) if errors.any else path
        solution, clamps = carry(shapes, material, held)
        places = [f"{place}, {np.degrees(after):g}°" for place in at]
        shapes = _sound(solution, synthesis, places)
        if synthesis.yield_curvature_per_mm:
            material = yielded(material, shapes, synthesis.yield_curvature_per_mm)
            shapes = _sound(relax(shapes, material, clamps, Newton.careful()), synthesis, places)
        seen = shapes
        if errors.vary:
            # The path continues without it: otherwise one observation's scatter would decide the branch of the next.
            here = errors.held(ideal, _reach(synthesis), slice(row * len(at), (row + 1) * len(at)))
            seen = _sound(_moved(shapes, material, clamps, here), synthesis, places)
        vertices.append(_with_clips(synthesis, seen))
        frames.append(seen.frames)
        reported.append(ideal)
    return _Rods(np.concatenate(vertices), np.concatenate(frames), Clamps.concatenate(reported) if errors.any else None)


def specimen_material(synthesis: Synthesis, random: np.random.Generator) -> Material:
    """Θ with a random rest curvature, the same in every observation."""
    rest = synthesis.rest_curvature_rms_per_mm * _curvature_field(synthesis, random)[None]
    return Material(np.array(synthesis.bend), synthesis.twist, synthesis.weight, rest)


def _curvature_field(synthesis: Synthesis, random: np.random.Generator) -> np.ndarray:
    """(J, 2) Gaussian numbers of variance 1 at the joints of the fine mesh, about m2 and -m1."""
    joints = _free_edges(synthesis) - 1
    reach = synthesis.rest_curvature_range_mm / synthesis.fine_edge_mm
    if reach == 0:
        return random.normal(size=(joints, 2))
    # White noise under a Gaussian window exp(-s²/range²) is correlated by exp(-s²/(2 range²)). At 4 ranges it is below 2e-7.
    side = int(np.ceil(4 * reach))
    window = np.exp(-((np.arange(-side, side + 1) / reach) ** 2))
    noise = random.normal(size=(joints + 2 * side, 2))
    smooth = np.stack([np.convolve(noise[:, k], window, mode="valid") for k in range(2)], axis=1)
    return smooth / np.linalg.norm(window)


def yielded(material: Material, shapes: Configuration, limit: float) -> Material:
    """A row for each of R rods: its rest curvature after it was bent to ``shapes``, elastic up to ``limit`` 1/mm from rest.

    material  one row for all, or R, with rest curvature
    """
    curvature = material_curvature(shapes)
    elastic = curvature - material.rest_curvature
    kept = np.minimum(1.0, limit / np.maximum(np.linalg.norm(elastic, axis=-1, keepdims=True), 1e-300))
    return Material(material.bend[0, 0], float(material.twist[0, 0]), float(material.weight[0]), curvature - kept * elastic)


def _moved(shapes: Configuration, material: Material, clamps: Clamps, goal: Clamps) -> Solution:
    """The rods after their clamps went from ``clamps`` to ``goal``."""
    motion = motion_between(clamps, goal)
    steps = int(motion.needed_steps(shapes.rest_length).max())
    return carry(shapes, material, motion.states(steps))[0]


def _free_edges(synthesis: Synthesis) -> int:
    """Fine edges that are relaxed: of each clip only the innermost edge, which is clamped."""
    return round(synthesis.length_mm / synthesis.fine_edge_mm) - sum(_clip_edges(synthesis))


def _clip_edges(synthesis: Synthesis) -> tuple[int, ...]:
    """Fine edges of the clips at start and end that are left out of the relaxed rod."""
    return tuple(round(clip / synthesis.fine_edge_mm) - 1 for clip in synthesis.clips_mm)


def _reach(synthesis: Synthesis) -> tuple[float, ...]:
    """mm from the outer ends of the rod to those of the relaxed one."""
    return tuple(edges * synthesis.fine_edge_mm for edges in _clip_edges(synthesis))


def _brought_to_distances(synthesis: Synthesis, material: Material) -> tuple[Configuration, Clamps]:
    """One rod per end distance at end rotation 0: from straight, the far clip moves to the largest distance, then closer."""
    t = np.array(synthesis.start_direction) / np.linalg.norm(synthesis.start_direction)
    # m1 is as close as possible to the y axis, else to x.
    across = np.array([0.0, 1.0, 0.0]) if abs(t[1]) < 0.9 else np.array([1.0, 0.0, 0.0])
    first = rotations.bishop_frames(t[None], across - (across @ t) * t)[0]
    last_tangent = np.array(synthesis.end_direction) / np.linalg.norm(synthesis.end_direction)
    turn = rotations.smallest_rotation(first[:, 0], last_tangent)
    near, far = _reach(synthesis)
    edges = _free_edges(synthesis)
    lengths = np.full(edges, synthesis.fine_edge_mm)
    start = near * first[:, 0]
    shape = Configuration(start[None], np.tile(rotations.quaternion_from_matrix(first), (1, edges, 1)), lengths)
    held = dict(start=Clamp.FRAME, end=Clamp.FRAME, start_position=start[None], start_frame=first[None])
    clamps = Clamps(end_position=shape.vertices[:, -1], end_frame=first[None], **held)
    angle = 2 * np.arccos(np.clip(turn[0], -1, 1))
    rotation = angle * turn[1:] / max(np.linalg.norm(turn[1:]), 1e-300)
    found, steps = {}, APPROACH_STEPS
    largest = float(np.max(np.abs(np.diff(np.sort(synthesis.end_distances_mm))), initial=STEP_MM))
    for distance in sorted(synthesis.end_distances_mm, reverse=True):
        goal = np.array([distance, 0.0, 0.0]) - far * last_tangent
        path = Motion(clamps, end_shift=goal - clamps.end_position, end_turn=rotation[None]).states(steps)
        solution, clamps = carry(shape, material, path)
        shape = _sound(solution, synthesis, [f"{distance:g} mm"])
        found[distance] = shape.quaternions[0]
        rotation, steps = np.zeros(3), max(1, int(np.ceil(largest / STEP_MM)))
    count = len(found)
    positions = np.array([[d, 0.0, 0.0] for d in synthesis.end_distances_mm]) - far * last_tangent
    shapes = Configuration(np.tile(start, (count, 1)), np.stack([found[d] for d in synthesis.end_distances_mm]), lengths)
    last = np.tile(clamps.end_frame, (count, 1, 1))
    together = Clamps(Clamp.FRAME, Clamp.FRAME, shapes.start, positions, np.tile(first, (count, 1, 1)), last)
    return shapes, together


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
    near, far = ((np.arange(edges) + 1.0)[:, None] * synthesis.fine_edge_mm for edges in _clip_edges(synthesis))
    tangents = shapes.frames[..., 0]
    before = inner[:, :1] - near[::-1] * tangents[:, :1]
    after = inner[:, -1:] + far * tangents[:, -1:]
    return np.concatenate([before, inner, after], axis=1)


def _labelled(synthesis: Synthesis, rods: _Rods, random: np.random.Generator) -> Observations:
    """The observations as a person would record them: marks with noise, the clips' frames, the twist rounded to 30 degrees."""
    spacing = synthesis.length_mm / (synthesis.marks - 1)
    every = round(spacing / synthesis.fine_edge_mm)
    frames, start_frame, end_frame = rods.frames, rods.frames[:, 0], rods.frames[:, -1]
    marks = rods.vertices[:, ::every].copy()
    # How many marks each clip holds, the outermost included; the tolerance is for clips of whole spacings.
    held = [int(clip / spacing + 1e-6) + 1 for clip in synthesis.clips_mm]
    if rods.reported is not None:
        start_frame, end_frame = rods.reported.start_frame, rods.reported.end_frame
        # Marks inside clips are reported where ideal clips would hold them.
        ideal, (near, far), (first, last) = rods.reported, _reach(synthesis), held
        along = np.arange(first)[:, None] * spacing - near
        marks[:, :first] = ideal.start_position[:, None] + along * start_frame[:, None, :, 0]
        along = far - np.arange(last)[::-1, None] * spacing
        marks[:, -last:] = ideal.end_position[:, None] + along * end_frame[:, None, :, 0]
    noise = synthesis.label_noise_mm * random.normal(size=marks.shape)
    if not synthesis.end_mark_noise:
        noise[:, : held[0]] = noise[:, -held[1] :] = 0.0
    distances, turns = len(synthesis.end_distances_mm), len(synthesis.end_rotations_deg)
    measured = None
    if synthesis.frames:
        clip = _clip_edges(synthesis)[0]
        middle = np.clip(np.arange(synthesis.marks - 1) * every + every // 2 - clip, 0, frames.shape[1] - 1)
        wobble = synthesis.label_noise_mm * np.sqrt(2) / spacing * random.normal(size=(len(marks), synthesis.marks - 1, 3))
        near, far = (max(count - 1, 1) for count in held)
        wobble[:, :near] = wobble[:, -far:] = 0.0
        turn, own = rotations.quaternion_of_turn(wobble), rotations.quaternion_from_matrix(frames[:, middle])
        measured = rotations.matrix_from_quaternion(rotations.quaternion_product(turn, own))
        if rods.reported is not None:
            measured[:, :near], measured[:, -far:] = start_frame[:, None], end_frame[:, None]
    twist = np.degrees(rotations.total_twist(rotations.quaternion_from_matrix(frames)))
    return Observations(
        marks + noise, rest_length=np.full(synthesis.marks - 1, spacing), start_frame=start_frame, end_frame=end_frame,
        frames=measured, total_twist=np.radians(30.0 * np.round(twist / 30.0) + 0.0),
        end_distance=np.tile(synthesis.end_distances_mm, turns), end_rotation=np.repeat(synthesis.end_rotations_deg, distances),
        name=synthesis.name, source=synthesis.source)
