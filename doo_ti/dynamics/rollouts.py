"""Recordings as they are predicted under any Θ of one rod: laid out for a simulation, which begins where each recording does,
with its grippers at every step, and rolled out open loop (docs/dynamics.md).

Axes: R recordings, G values of Θ, T frames, V markers, P directions.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from doo_ti.contact.surroundings import Surroundings
from doo_ti.contact.touch import GAP_TOLERANCE
from doo_ti.dynamics.grippers import Grippers
from doo_ti.dynamics.parameters import Direction, MovingStart, Stepping
from doo_ti.dynamics.recorded import LOST, SWAPPED, RecordedMotion
from doo_ti.dynamics.simulate import simulate
from doo_ti.dynamics.theta import MotionTheta, simulated
from doo_ti.dynamics.trajectory import Trajectory
from doo_ti.relaxation.external import Springs
from doo_ti.relaxation.relax import relax
from doo_ti.rod.frames import bishop_frames, edge_frames, quaternion_from_matrix, tangent_from_quaternion
from doo_ti.rod.types import Clamp, Clamps, Configuration, Material
from doo_ti.system.errors import InputError, require_whole

LARGEST_REACH = 0.999  # share of the rod's length between grippers, at most: beyond, the far gripper is moved back
FIT_STIFFNESS = 0.01
"""Of a rod that is fitted to markers, over that of the springs to them and the cube of an edge: it hardly resists."""
HALVINGS, HALVINGS_AMONG_OBSTACLES = 1, 2  # of the edges between markers, for predictions
SMOOTHED = 0.09  # s, over which recordings among obstacles are smoothed
NUMBERS_AT_ONCE = 16_000_000  # numbers of positions that a simulation returns


def require_smoothing(source: str, field: str, frames: int) -> None:
    """Raise InputError unless parabolas can be fitted through so many frames, the middle one among them."""
    require_whole(source, field, frames, 1)
    if frames % 2 == 0:
        raise InputError(source, field, f"{frames}", "give an odd number of frames")


@dataclass(frozen=True)
class Layout:
    """A recorded motion as a simulation begins it: from frames 0 and 1 or, smoothed, from the first few."""

    start: MovingStart  # R rods at frame 1
    grippers: Grippers  # at every step from frame 1 on, missing frames included
    steps: np.ndarray  # (R, T − 1) the step of each frame from 1 on
    smoothing: int  # frames that parabolas were fitted through

    @property
    def held(self) -> np.ndarray:
        """(R, 2 · steps, 3) mm, or twice as many: where the grippers hold the ends of the first and the last edge."""
        grippers, lengths = self.grippers, self.start.configuration.rest_length
        places = [grippers.start_position, grippers.start_position + lengths[0] * grippers.start_frame[..., 0]]
        if grippers.end != Clamp.FREE:
            places += [grippers.end_position, grippers.end_position - lengths[-1] * grippers.end_frame[..., 0]]
        return np.concatenate(places, axis=1)


def roll_reference(motion: RecordedMotion) -> np.ndarray:
    """(3,) the coordinate axis most across the first edges where the recordings begin."""
    first = motion.positions[:, 1, 1] - motion.positions[:, 1, 0]
    direction = first / np.linalg.norm(first, axis=-1, keepdims=True)
    return np.eye(3)[int(np.argmin((direction**2).mean(axis=0)))]


def lay_out(motion: RecordedMotion, rest_length: np.ndarray, reference: np.ndarray, end: Clamp = Clamp.TANGENT,
            smoothing: int = 1) -> Layout:
    """Lay out the recordings of ``motion`` for :func:`doo_ti.dynamics.simulate.simulate`.

    rest_length  (E,) mm; the first and the last edge are as long, from the inner marker of a gripper on
    reference    (3,) direction towards which m1 of the first edge points at frame 1
    end          what the far gripper holds, if there is one
    smoothing    odd number of frames through which parabolas are fitted for the start and the grippers; 1: as recorded
    """
    end = Clamp.FREE if motion.free_end else end
    believed = _believable(motion.positions[:, :, motion.gripped], motion.confused, motion.elapsed)
    believed = _from_inner(believed, rest_length)
    expanded, steps = _with_missing(believed[:, 1:], motion.elapsed[:, 1:])
    width = min(smoothing, expanded.shape[1] - 1 + expanded.shape[1] % 2)  # or as many frames as there are
    if width > 2:
        from scipy.signal import savgol_filter

        expanded = savgol_filter(expanded, width, 2, axis=1)
    if not motion.free_end:
        expanded = _within_reach(expanded, rest_length)
    first = edge_frames(expanded[:, :, 1] - expanded[:, :, 0], np.broadcast_to(reference, (motion.count, 3)))
    whole = motion.positions.copy()
    whole[:, :, motion.gripped] = believed
    x, velocity = _first_state(whole, motion.elapsed, motion.rate, smoothing)
    x[:, motion.gripped] = expanded[:, 0]
    # Without twist at the start.
    frames = bishop_frames(_fitted_tangents(x, rest_length, first[:, 0], motion.free_end), first[:, 0, :, 1])
    # A free end does not read its frames.
    last = first if motion.free_end else edge_frames(expanded[:, :, 3] - expanded[:, :, 2], frames[:, -1, :, 1])
    grippers = Grippers(Clamp.FRAME, end, expanded[:, :, 0], expanded[:, :, -1], first, last)
    rods = Configuration(x[:, 0].copy(), quaternion_from_matrix(frames), rest_length)
    age = 0.5 / motion.rate if smoothing == 1 else 0.0  # a difference of two frames holds for the middle between them
    return Layout(MovingStart(rods, velocity, age), grippers, steps, smoothing)


@dataclass(frozen=True)
class Rollouts:
    """How the recordings of a motion are rolled out.

    motion        R recordings
    layout        where their simulations begin, and their grippers
    stepping      time steps, at the rate of the recordings
    surroundings  what the rods may touch, with one row for all recordings or R; a Θ with friction has that against all of it
                  but the rod itself
    marks         (V,) the vertices of the simulated rods that are markers
    """

    motion: RecordedMotion
    layout: Layout
    stepping: Stepping
    surroundings: Surroundings
    marks: np.ndarray

    @classmethod
    def of(cls, motion: RecordedMotion, theta: MotionTheta, stepping: Stepping, end: Clamp,
           surroundings: Surroundings = Surroundings(), smoothing: int | None = None,
           halvings: int | None = None) -> "Rollouts":
        """The rollouts of a motion.

        theta      of the rod; only its lengths and its roll reference are read
        end        what the far gripper holds, if there is one
        smoothing  as of :func:`.lay_out`; None: 1, but among obstacles the frames of :data:`SMOOTHED`: noise of a gripper
                   shakes the rod, which then slips where it would have stuck
        halvings   how often edges, as long as between markers, are halved, and with them time steps of BDF2; None: as often as
                   for predictions
        """
        if smoothing is None:
            smoothing = 2 * int(0.5 * SMOOTHED * motion.rate) + 1 if surroundings else 1
        rods, lengths, marks = motion, theta.rest_length, np.arange(motion.edges + 1)
        if halvings is None:
            halvings = HALVINGS_AMONG_OBSTACLES if surroundings else HALVINGS
        for _ in range(halvings):
            rods, lengths, among = rods.refined(lengths)
            marks = among[marks]
        if stepping.scheme == "bdf2":
            stepping = replace(stepping, substeps=stepping.substeps * 2**halvings)
        return cls(motion, lay_out(rods, lengths, theta.reference, end, smoothing), stepping, surroundings, marks)

    @property
    def depth(self) -> np.ndarray:
        """(R,) mm by which the rods, as their grippers hold them, are inside an obstacle at some step; zero where they are not.
        Such a recording cannot be rolled out."""
        radius = np.asarray(self.surroundings.radius, dtype=np.float64) if self.surroundings else np.zeros(())
        deepest = np.full(self.motion.count, -np.inf)
        for obstacle in self.surroundings.bodies:
            deepest = np.maximum(deepest, radius - obstacle.distance(self.layout.held)[0].min(axis=1))
        return np.where(deepest > GAP_TOLERANCE * radius, deepest, 0.0)

    @property
    def through_steps(self) -> bool:
        """Whether derivatives go through the time steps. Among obstacles they are differences of rollouts: where a contact
        begins, or begins to slip, no derivative says how much further away that would happen."""
        return not self.surroundings

    def predicted(self, thetas: Sequence[MotionTheta]) -> tuple[np.ndarray, np.ndarray]:
        """((R, G, T, V, 3) positions of the recordings under each Θ, (R, G, T) status): frames 0 and 1 and the grippers'
        vertices as given, the rest predicted; NaN where a rod failed."""
        vertices = self.layout.start.configuration.edges + 1
        at_once = max(1, NUMBERS_AT_ONCE * len(self.marks) // (self.motion.positions.size * vertices))
        parts = [self._shown(self._rolled_out(some), len(some))
                 for some in (thetas[k : k + at_once] for k in range(0, len(thetas), at_once))]
        return tuple(np.concatenate(arrays, axis=1) for arrays in zip(*parts, strict=True))

    def simulated(self, theta: MotionTheta, progress=None) -> tuple[np.ndarray, np.ndarray, dict[str, np.ndarray], Trajectory]:
        """(positions (R, T, V, 3), status (R, T), energies (R, T) by name, the simulation itself) under one Θ, as
        :meth:`predicted`. Energies are NaN in frame 0: the simulation begins at frame 1. Contact forces (R, T, V, 3) and
        :class:`.Touch` (R, T, V) in the simulation, of each marker and the vertices nearest to it, and work of friction (R, T)
        are those at the recordings' frames, and zero in frames 0 and 1; ``end_force`` (R, T − 2, 3) has no values there, and
        ``positions`` (R, T, −, 3) of all vertices are those of the start there."""
        found = replace(self, stepping=replace(self.stepping, detailed=True))._rolled_out([theta], progress=progress)
        positions, status = (value[:, 0] for value in self._shown(found, 1))
        rods = np.arange(self.motion.count)[:, None]
        energies = {name: np.concatenate([np.full((self.motion.count, 1), np.nan), value[rods, self.layout.steps]], axis=1)
                    for name, value in ({} if found.detail is None else found.detail.energies).items()}
        start = self.layout.start.configuration.vertices[:, None]
        found = replace(found, end_force=found.end_force[rods, self._at],
                        positions=np.concatenate([start, start, found.positions[rods, self._at]], axis=1))
        if self.surroundings:
            first = np.insert((self.marks[1:] + self.marks[:-1] + 1) // 2, 0, 0)  # vertex of each marker's
            for name, joined in (("contact_force", np.add), ("touch", np.maximum), ("friction_work", None)):
                value = getattr(found, name)[rods, self._at]
                value = value if joined is None else joined.reduceat(value, first, axis=2)
                found = replace(found, **{name: np.concatenate([np.zeros_like(value[:, :1])] * 2 + [value], axis=1)})
        return positions, status, energies, found

    def differentiated(self, theta: MotionTheta, directions: Sequence[tuple[MotionTheta, MotionTheta, float]]
                       ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """(positions (R, T − 2, W, 3), their derivatives along P directions (R, P, T − 2, W, 3), status (R, T − 2)) of the W
        vertices that :meth:`predicted` predicts. A direction: two values of Θ, and how far apart they are along it."""
        if not self.through_steps:
            return self._differences(theta, directions)
        along = [Direction(simulated([before]), simulated([after]), distance) for before, after, distance in directions]
        found = self._rolled_out([theta], directions=along)
        rods, at, vertices = np.arange(self.motion.count)[:, None, None], self._at[..., None], self.marks[self.motion.predicted]
        slopes = np.moveaxis(found.slopes[rods, at, :, vertices], -2, 1)
        return found.positions[rods, at, vertices], slopes, found.status[rods[..., 0], at[..., 0]]

    def _differences(self, theta: MotionTheta, directions) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """The same by differences; the status is the worst of all rollouts."""
        befores, afters, distances = zip(*directions, strict=True)
        positions, status = self.predicted([theta, *befores, *afters])
        positions, count = positions[:, :, 2:, self.motion.predicted], len(directions)
        distance = np.array(distances).reshape(-1, 1, 1, 1)
        slopes = (positions[:, 1 + count :] - positions[:, 1 : 1 + count]) / distance
        return positions[:, 0], slopes, status[:, :, 2:].max(axis=1)

    @property
    def _at(self) -> np.ndarray:
        """(R, T − 2) frame of the simulation for each that is predicted."""
        return self.layout.steps[:, 1:] - 1

    def _rolled_out(self, thetas: Sequence[MotionTheta], **more) -> Trajectory:
        """The simulation of every recording under every Θ."""
        count, each, layout = self.motion.count, len(thetas), self.layout
        pairs = np.repeat(np.arange(count), each), np.tile(np.arange(each), count)
        lengths = layout.start.configuration.rest_length
        material, dynamics = simulated([replace(theta, rest_length=lengths) for theta in thetas])
        surroundings = self.surroundings.take(pairs[0])
        if thetas[0].friction is not None:
            surroundings = surroundings.rubbing(np.array([theta.friction for theta in thetas])[pairs[1]])
        return simulate(layout.start, material, layout.grippers, dynamics, self.stepping, up=thetas[0].up, pairs=pairs,
                        **surroundings.arguments, **more)

    def _shown(self, found: Trajectory, each: int) -> tuple[np.ndarray, np.ndarray]:
        """What :meth:`predicted` returns, of a simulation under G = ``each`` Θ."""
        motion, at = self.motion, self._at
        rods = np.arange(motion.count)[:, None]
        positions = np.repeat(motion.positions[:, None], each, axis=1)
        inner = found.positions[:, :, self.marks].reshape(motion.count, each, -1, *motion.positions.shape[2:])
        for g in range(each):
            positions[:, g, 2:, motion.predicted] = inner[rods, g, at][:, :, motion.predicted]
        status = np.zeros(positions.shape[:3], dtype=np.int8)
        status[:, :, 2:] = np.moveaxis(found.status.reshape(motion.count, each, -1)[rods, :, at], 2, 1)
        return positions, status


def mean_error(positions: np.ndarray, recorded: np.ndarray) -> np.ndarray:
    """(R, T) mm: mean of |difference| over all markers and coordinates (L1), positions (R, T, V, 3)."""
    return np.abs(positions - recorded).mean(axis=(-1, -2))


# --- how a recording is laid out ---


def _believable(held: np.ndarray, confused: np.ndarray, elapsed: np.ndarray) -> np.ndarray:
    """Gripper markers (R, T, 4, 3), or of one gripper, changed back where ``confused`` (R, T, 2) says they are swapped, and on
    lines between the frames around where they are lost."""
    result, instants = held.copy(), np.cumsum(elapsed, axis=1)
    for end in range(held.shape[2] // 2):
        pair = slice(2 * end, 2 * end + 2)
        swapped = confused[:, :, end] == SWAPPED
        result[swapped, pair] = held[swapped, pair][:, ::-1]
        for r in np.flatnonzero((confused[:, :, end] == LOST).any(axis=1)):
            good = confused[r, :, end] != LOST
            for marker, axis in np.ndindex(2, 3):
                column = result[r, :, 2 * end + marker, axis]
                result[r, :, 2 * end + marker, axis] = np.interp(instants[r], instants[r, good], column[good])
    return result


def _from_inner(held: np.ndarray, rest_length: np.ndarray) -> np.ndarray:
    """Gripper markers (R, T, 4, 3), or of one gripper, with the outer ones as far from the inner ones as the rod's end edges
    are long: in the middle of these a clamp acts."""
    result = held.copy()
    for outer, inner, length in ((0, 1, rest_length[0]), (3, 2, rest_length[-1]))[: held.shape[2] // 2]:
        edge = held[:, :, outer] - held[:, :, inner]
        result[:, :, outer] = held[:, :, inner] + edge * (length / np.linalg.norm(edge, axis=-1, keepdims=True))
    return result


def _within_reach(held: np.ndarray, rest_length: np.ndarray) -> np.ndarray:
    """Gripper markers (R, T, 4, 3) with the far gripper moved towards the near one where the rod would not reach it."""
    first, last = held[:, :, 1] - held[:, :, 0], held[:, :, 3] - held[:, :, 2]
    first = first * (rest_length[0] / np.linalg.norm(first, axis=-1, keepdims=True))
    last = last * (rest_length[-1] / np.linalg.norm(last, axis=-1, keepdims=True))
    line = held[:, :, 3] - last - held[:, :, 0] - first
    span = np.linalg.norm(line, axis=-1, keepdims=True)
    excess = np.maximum(span - LARGEST_REACH * rest_length[1:-1].sum(), 0.0) / span
    result = held.copy()
    result[:, :, 2:] -= (excess * line)[:, :, None]
    return result


def _first_state(positions: np.ndarray, elapsed: np.ndarray, rate: float, smoothing: int) -> tuple[np.ndarray, np.ndarray]:
    """(R, V, 3) places and velocities at frame 1: the difference of two frames or, smoothed, of parabolas through the first."""
    if smoothing == 1:
        return positions[:, 1].copy(), (positions[:, 1] - positions[:, 0]) * rate / elapsed[:, 1, None, None]
    instants = np.cumsum(elapsed[:, :smoothing], axis=1)
    since = (instants - instants[:, 1:2])[..., None] ** np.arange(3.0)
    fitted = np.linalg.pinv(since) @ positions[:, :smoothing].reshape(*since.shape[:2], -1)
    place, slope = (fitted[:, k].reshape(-1, *positions.shape[2:]) for k in range(2))
    return place, slope * rate


def _fitted_tangents(markers: np.ndarray, rest_length: np.ndarray, first: np.ndarray, free_end: bool) -> np.ndarray:
    """(R, E, 3) tangents of rods whose edges have their lengths, whose ends are where the grippers are, and which are otherwise
    as near as possible to ``markers`` (R, V, 3); ``first`` (R, 3, 3) is the frame of the first edge.

    A rod that did not end in its gripper would be thrown there within the first time step. Where there is none: as the markers
    show it.
    """
    edges = np.diff(markers, axis=1)
    tangents = edges / np.linalg.norm(edges, axis=-1, keepdims=True)
    seen = Configuration(markers[:, 0], quaternion_from_matrix(bishop_frames(tangents, first[..., 1])), rest_length)
    end = Clamp.FREE if free_end else Clamp.TANGENT
    clamps = Clamps(Clamp.TANGENT, end, markers[:, 0], markers[:, -1], first, seen.frames[:, -1])
    stiff = FIT_STIFFNESS * rest_length.mean() ** 3
    springs = Springs(markers, np.ones(markers.shape[:2]))
    found = relax(seen, Material(stiff, stiff, 0.0), clamps, up=(0.0, 0.0, 1.0), precision="f64", external=springs,
                  external_index=np.arange(len(markers)))
    return np.where(found.converged[:, None, None], tangent_from_quaternion(found.configuration.quaternions), tangents)


def _with_missing(held: np.ndarray, elapsed: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """((R, steps, 4, 3) gripper markers at every step, (R, T) step of each frame) from (R, T, 4, 3), the last position held
    where a recording is shorter: cubics through frames that are missing, with the velocities on either side."""
    count, frames = held.shape[:2]
    since = elapsed.copy()
    since[:, 0] = 0
    steps = np.cumsum(since, axis=1)
    total = int(steps[:, -1].max()) + 1
    result = np.repeat(held[:, -1:], total, axis=1)
    for r in range(count):
        result[r, steps[r]] = held[r]
    for r, t in np.argwhere(since > 1):
        n = int(since[r, t])
        here, there = held[r, t - 1], held[r, t]
        before = (here - held[r, t - 2]) / max(1, since[r, t - 1]) if t > 1 else (there - here) / n
        after = (held[r, t + 1] - there) / since[r, t + 1] if t + 1 < frames else (there - here) / n
        u = (np.arange(1, n) / n)[:, None, None]
        result[r, steps[r, t - 1] + 1 : steps[r, t]] = (
            (1 + 2 * u) * (1 - u) ** 2 * here + u**2 * (3 - 2 * u) * there
            + n * (u * (1 - u) ** 2 * before + u**2 * (u - 1) * after))
    return result, steps
