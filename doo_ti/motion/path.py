"""What clamps do in a quasi-static motion, and how many sub-steps it takes (§III-D)."""

from collections.abc import Iterator
from dataclasses import dataclass, fields, replace
from typing import Annotated

import numpy as np

from doo_ti.relaxation.newton import Newton
from doo_ti.relaxation.relax import relax
from doo_ti.rod import frames
from doo_ti.rod.start import require_frames
from doo_ti.rod.types import Clamp, Clamps, Configuration, Material, Solution, sticky
from doo_ti.system.arguments import typed
from doo_ti.system.errors import InputError

LARGEST_TURN = np.radians(5.0)  # rad, of a clamp in one sub-step
SHIFT_PER_TURN = 0.2  # largest shift of a clamp in one sub-step, as a share of the rod's length, per radian of its largest turn
MOST_STEPS = 100_000  # sub-steps of a motion


@typed
@dataclass(frozen=True)
class Motion:
    """Motion of the clamps of R rods: positions move along lines, each frame turns about one axis, all uniformly.

    clamps                  before the motion
    start_shift, end_shift  (R, 3) mm; None: that position rests
    start_turn, end_turn    (R, 3) rotation vectors in the world, rad, whole turns included; None: that frame rests
    end_spin                (R,) rad, whole turns included, by which the far frame turns about its own tangent as well
    """

    clamps: Clamps
    start_shift: Annotated[np.ndarray | None, "R 3"] = None
    end_shift: Annotated[np.ndarray | None, "R 3"] = None
    start_turn: Annotated[np.ndarray | None, "R 3"] = None
    end_turn: Annotated[np.ndarray | None, "R 3"] = None
    end_spin: Annotated[np.ndarray | None, "R"] = None

    def at(self, share: float | np.ndarray) -> Clamps:
        """The clamps after ``share`` of the motion, 0 to 1, one number or (R,)."""
        here, share = self.clamps, np.asarray(share)[..., None]
        return Clamps(here.start, here.end, _shifted(here.start_position, self.start_shift, share),
                      _shifted(here.end_position, self.end_shift, share),
                      _turned(here.start_frame, self.start_turn, None, share),
                      _turned(here.end_frame, self.end_turn, self.end_spin, share))

    def states(self, steps: int) -> Iterator[Clamps]:
        """The clamps after each of ``steps`` equal parts of the motion."""
        return (self.at(step / steps) for step in range(1, steps + 1))

    @property
    def parts(self) -> dict[str, np.ndarray]:
        """The shifts and turns by name, of what moves."""
        every = {field.name: getattr(self, field.name) for field in fields(self) if field.name != "clamps"}
        return {name: value for name, value in every.items() if value is not None}

    def take(self, rows: np.ndarray) -> "Motion":
        """The motions named by ``rows``, in that order."""
        return Motion(self.clamps.take(rows), **{name: value[rows] for name, value in self.parts.items()})

    def between(self, first: float, last: float) -> "Motion":
        """The part of the motion from one share of it to another."""
        return Motion(self.at(first), **{name: (last - first) * value for name, value in self.parts.items()})

    def needed_steps(self, rest_length: np.ndarray, largest_turn: float = LARGEST_TURN) -> np.ndarray:
        """(R,) sub-steps that keep each clamp's turns below ``largest_turn`` (rad) and its shifts in proportion to it.

        Raises InputError where that would take more than ``MOST_STEPS``.
        """
        if not 0 < largest_turn <= np.pi:
            raise InputError("motion", "sub_step", f"{largest_turn:g} rad",
                             f"give radians, at most pi: 5 degrees are {np.radians(5.0):.4g}")
        end_turn = _size(self.end_turn) + np.abs(0.0 if self.end_spin is None else self.end_spin)
        shift = np.maximum(_size(self.start_shift), _size(self.end_shift)) / (SHIFT_PER_TURN * rest_length.sum(axis=-1))
        need = np.maximum(np.maximum(_size(self.start_turn), end_turn), shift) / largest_turn
        if not (need <= MOST_STEPS).all():
            raise InputError("motion", "end_position, end_turn", f"{np.max(need):.3g} sub-steps",
                             f"move in at most {MOST_STEPS:,}: by less, or with a larger sub_step")
        steps = np.maximum(np.ceil(need - 1e-9), 1).astype(np.int64)
        return np.broadcast_to(steps, len(self.clamps.start_position))


def motion_between(clamps: Clamps, goal: Clamps, rotation: np.ndarray | None = None) -> Motion:
    """The motion from ``clamps`` to ``goal``, R each; held frames take the shortest rotation.

    rotation  (R,) rad by which the far frame turns about the rod, or None. Of the motions to its goal, which differ by whole
              turns, the one nearest to that is taken.

    At an end where ``goal`` holds no whole frame, only its tangent is met: the frame follows the tangent, and turns by
    ``rotation`` exactly.

    Raises InputError where frames of ``goal`` that are held are no rotations.
    """
    for end in ("start", "end"):
        require_frames("clamps", f"{end}_frame", getattr(goal, end), getattr(goal, f"{end}_frame"))
    start_turn = _frame_turn(clamps.start_frame, goal.start_frame, goal.start)
    end_spin = None
    if rotation is None:
        end_turn = _frame_turn(clamps.end_frame, goal.end_frame, goal.end)
    else:
        end_turn, end_spin = _swing_and_spin(clamps.end_frame, goal.end_frame, goal.end, rotation)
    shifts = goal.start_position - clamps.start_position, goal.end_position - clamps.end_position
    return Motion(clamps, *shifts, start_turn, end_turn, end_spin)


def carry(configuration: Configuration, material: Material, path: Iterator[Clamps], **options) -> tuple[Solution, Clamps]:
    """Relax at each clamps of ``path``, from the state before; returns the last solution and its clamps. A rod that does not
    converge in some sub-step keeps that status.

    ``options`` go to :func:`doo_ti.relaxation.relax.relax`; the solver is the careful one, which stays on the branch.
    """
    solution = clamps = None
    for clamps in path:
        status = None if solution is None else solution.status
        solution = relax(configuration, material, clamps, Newton.careful(), **options)
        configuration = solution.configuration
        if status is not None:
            solution = replace(solution, status=sticky(status, solution.status))
    return solution, clamps


def rotation_about_rod(motion: Motion) -> np.ndarray:
    """(N,) rad by which a motion turns the far frame about its tangent, beyond the parallel transport of the frame; whole turns
    are those of the motion's own rotation vector and roll."""
    before, after = motion.clamps.end_frame, motion.at(1.0).end_frame
    angle = frames.turn_about_tangent(before, after)
    spin = 0.0 if motion.end_spin is None else motion.end_spin
    along = 0.0 if motion.end_turn is None else np.sum(motion.end_turn * before[..., 0], axis=-1)
    held = np.broadcast_to(np.asarray(motion.clamps.end) == Clamp.FRAME, len(angle))
    return np.where(held, angle + 2 * np.pi * np.round((spin + along - angle) / (2 * np.pi)), 0.0)


def _shifted(position: np.ndarray, shift: np.ndarray | None, share: np.ndarray) -> np.ndarray:
    return position if shift is None else position + share * shift


def _turned(frame: np.ndarray, turn: np.ndarray | None, spin: np.ndarray | None, share: np.ndarray) -> np.ndarray:
    if turn is None and spin is None:
        return frame
    quaternion = frames.quaternion_from_matrix(frame)
    if turn is not None:
        angle = np.linalg.norm(turn, axis=-1)
        axis = turn / np.maximum(angle, 1e-300)[:, None]
        quaternion = frames.quaternion_product(frames.quaternion_about(axis, share[..., 0] * angle), quaternion)
    if spin is not None:
        own = np.broadcast_to([1.0, 0.0, 0.0], (len(spin), 3))
        quaternion = frames.quaternion_product(quaternion, frames.quaternion_about(own, share[..., 0] * spin))
    return frames.matrix_from_quaternion(quaternion)


def _size(vector: np.ndarray | None) -> np.ndarray:
    """(R,) lengths, or zero."""
    return np.zeros(1) if vector is None else np.linalg.norm(vector, axis=-1)


def _frame_turn(frame: np.ndarray, goal: np.ndarray, kind) -> np.ndarray:
    """(R, 3) the shortest rotation vector from frames to goals, between tangents where only these are held; else zero."""
    kind = np.broadcast_to(kind, len(frame))[:, None]
    swing = frames.rotation_vector(frames.smallest_rotation(frame[..., 0], goal[..., 0]))
    return np.where(kind == Clamp.FRAME, frames.turn_between(frame, goal), np.where(kind == Clamp.TANGENT, swing, 0.0))


def _swing_and_spin(frame: np.ndarray, goal: np.ndarray, kind, rotation: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The rotation vector (R, 3) that brings the tangents to their goals, and the remaining turn (R,) about them."""
    kind = np.broadcast_to(kind, len(frame))
    swing = frames.smallest_rotation(frame[..., 0], goal[..., 0])
    swung = frames.quaternion_product(swing, frames.quaternion_from_matrix(frame))
    rest = frames.quaternion_product(frames.conjugate(swung), frames.quaternion_from_matrix(goal))
    angle = 2 * np.arctan2(rest[..., 1], rest[..., 0])
    spin = np.where(kind == Clamp.FRAME, angle + 2 * np.pi * np.round((rotation - angle) / (2 * np.pi)), rotation)
    held = kind >= Clamp.TANGENT
    return np.where(held[:, None], frames.rotation_vector(swing), 0.0), np.where(held, spin, 0.0)
