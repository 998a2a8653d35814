"""Prediction of motion: the configuration of a rod after its clamps have moved (§III-D).

    Γ_2 = F(… F(F(Γ_1, E_Θ, C_1+δ), E_Θ, C_1+2δ) …, E_Θ, C_2)

Γ_1 is a minimum of E_Θ under C_1. The clamps move to C_2 in sub-steps, as many as their motion needs; after each the rod is
relaxed from its last configuration, so that it follows its branch of minima. Where the branch ends the rod jumps to another
one; jumps are counted. The motion is quasi-static, without inertia.

Axes: T moments, G materials, N motions, R = G·N rods, material by material, E edges, K candidate poses.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import accumulate
from typing import Annotated

import numpy as np
from numpy.typing import ArrayLike

from doo_ti.contact.obstacles import Obstacle
from doo_ti.contact.surroundings import Surroundings, obstacle_list
from doo_ti.io.motion_file import ClampPath
from doo_ti.motion.journey import Journey
from doo_ti.motion.path import LARGEST_TURN, Motion, motion_between
from doo_ti.relaxation.newton import Newton
from doo_ti.relaxation.point_loads import PointLoads, check_rows
from doo_ti.relaxation.relax import relax
from doo_ti.rod.frames import angle_about, matrix_from_quaternion, smallest_rotation, total_twist, vertices_from_quaternions
from doo_ti.rod.material import doubt_angle
from doo_ti.rod.types import Clamp, Clamps, Configuration, Material, Solution, Status, sticky
from doo_ti.system.arguments import short_repr, typed
from doo_ti.system.errors import InputError

STILL = 1e-9  # mm and rad: clamps that move by less count as fixed
REPORTED = ("energy", "residual", "iterations", "status", "stable", "end_force")
"""Fields of :class:`doo_ti.rod.types.Solution` that are kept of every moment."""


@dataclass(frozen=True)
class Prediction:
    """R rods at T moments.

    time          (T,) s
    start         (T, R, 3) mm, vertex 0
    quaternions   (T, R, E, 4) frames
    rest_length   (E,) mm
    energy, residual, iterations, status, stable (T, R), end_force (T, R, 3)
                  as in :class:`doo_ti.rod.types.Solution`; iterations since the moment before, and of the statuses so far the
                  first one that is not converged
    jumps         (T, R) jumps to another branch since the moment before
    end_rotation  (T, R) rad by which the far clamp has turned the rod about its tangent, whole turns included
    material, motion  (R,) rows
    contact_force  (T, R, V, 3) of obstacles on the vertices, mm (energy per mm); None without obstacles
    substeps      (R,) time steps from one moment to the next, of rods with inertia or friction; else None
    step_error    (R,) mm, estimated error of the time steps, where a tolerance was given; else None
    """

    __repr__ = short_repr

    time: np.ndarray
    start: np.ndarray
    quaternions: np.ndarray
    rest_length: np.ndarray
    energy: np.ndarray
    residual: np.ndarray
    iterations: np.ndarray
    status: np.ndarray
    stable: np.ndarray
    end_force: np.ndarray
    jumps: np.ndarray
    end_rotation: np.ndarray
    material: np.ndarray
    motion: np.ndarray
    contact_force: np.ndarray | None = None
    substeps: np.ndarray | None = None
    step_error: np.ndarray | None = None

    @property
    def vertices(self) -> np.ndarray:
        """(T, R, V, 3) mm."""
        shape = self.quaternions.shape
        flat = vertices_from_quaternions(self.start.reshape(-1, 3), self.quaternions.reshape(-1, *shape[2:]), self.rest_length)
        return flat.reshape(*shape[:2], -1, 3)

    @property
    def total_twist(self) -> np.ndarray:
        """(T, R) Σ m_i, rad, whole turns included."""
        return total_twist(self.quaternions)

    @property
    def followed(self) -> np.ndarray:
        """(T, R) bool: at every moment so far the rod converged to a certified minimum; else there is no prediction."""
        return np.logical_and.accumulate((self.status == Status.CONVERGED) & self.stable, axis=0)

    def at(self, moment: int) -> Configuration:
        """The R rods at a moment."""
        return Configuration(self.start[moment], self.quaternions[moment], self.rest_length)


@typed
def predict(
    configuration: Configuration, material: Material, clamps: Clamps, path: ClampPath, *, sub_step: float = LARGEST_TURN,
    between: int = 1, up: ArrayLike = (0.0, 0.0, 1.0), solver: Newton | None = None, precision: str = "mixed",
    advance: Callable[[int], None] = lambda rods: None, obstacles: Sequence[Obstacle] = (), radius: ArrayLike | None = None,
    loads: PointLoads | None = None,
) -> Prediction:
    """Move the clamps of rods along a path, quasi-statically, and return the rods at its moments (§III-D).

    configuration  R = G·N rods, material by material, or N, at or near equilibrium under ``clamps``
    material       G rows, each for N rods
    clamps         (N) clamps of the rods; from these they are first moved to the path's first moment
    path           of N motions, or of one for all
    sub_step       rad: largest rotation of a clamp in a sub-step; its shift is bounded in proportion
    between        number of returned states per interval of the path, its end included
    precision      of the returned states, as in :func:`doo_ti.relaxation.relax.relax`; sub-steps run in f32, or f64 if this is
                   "f64"
    advance        called with the number of rods at each moment, (T − 1)·between·R in all
    obstacles, radius  as in :func:`doo_ti.relaxation.relax.relax`, without friction and at rest; for others there is
                   :func:`doo_ti.motion.moving.predict_moving` with quasi-static steps
    loads          forces and masses at the vertices, of R rows or one

    A rod that fails keeps that status at all later moments; the next interval begins at its last configuration. Raises
    InputError where numbers of rods and motions do not match.
    """
    surroundings = Surroundings(obstacle_list("predict", obstacles), radius)
    if surroundings.rub:
        raise InputError("predict", "obstacles", "with friction, which depends on the way",
                         "give predict_moving with quasi-static steps, or obstacles without friction")
    time = path.states(between)
    go, rods, (solution, held, jumps) = begun(configuration, material, clamps, path, sub_step, up, solver or Newton(),
                                              precision, surroundings, loads)
    motions, here = clamps.count, solution.configuration
    moments = [(solution, jumps, np.zeros(len(rods)))]
    for moment in range(path.moments - 1):
        motion = motion_between(held, path.at(moment + 1, clamps), path.rotation(moment, motions))
        for part in range(between):
            leg = _part(motion, part / between, (part + 1) / between)
            solution, jumps = go(here, leg)
            here, held = _finite(solution.configuration, here), leg.at(1.0)
            moments.append((solution, jumps, moments[-1][2] + np.tile(rotation_about_rod(leg), len(rods) // motions)))
            advance(len(rods))
    solutions, jumps, rotation = zip(*moments, strict=True)
    return Prediction(time=time, rest_length=configuration.rest_length.copy(), jumps=np.stack(jumps),
                      end_rotation=np.stack(rotation), material=rods, motion=np.arange(len(rods)) % motions,
                      **_reported(solutions))


def _finite(shape: Configuration, before: Configuration) -> Configuration:
    """``shape``, but rods that are not finite as they were ``before``."""
    lost = ~np.isfinite(shape.quaternions).all(axis=(1, 2))
    return Configuration(np.where(lost[:, None], before.start, shape.start),
                         np.where(lost[:, None, None], before.quaternions, shape.quaternions), shape.rest_length)


def _reported(solutions: Sequence[Solution]) -> dict[str, np.ndarray]:
    """Fields of :class:`Prediction` that are those of the solutions at its moments."""
    found = {name: np.stack([getattr(solution, name) for solution in solutions]) for name in REPORTED}
    found["status"] = np.array(list(accumulate(found["status"], sticky)))
    if solutions[0].contact_force is not None:
        found["contact_force"] = np.stack([solution.contact_force for solution in solutions])
    for name in ("start", "quaternions"):
        found[name] = np.stack([getattr(solution.configuration, name) for solution in solutions])
    return found


def begun(configuration: Configuration, material: Material, clamps: Clamps, path: ClampPath, sub_step: float, up,
          solver: Newton, precision: str, surroundings: Surroundings, loads: PointLoads | None = None):
    """The beginning of :func:`predict`: a function that carries rods along a motion and gives the rods and their jumps, the
    rods' (R,) rows of ``material``, and (the R rods at rest at the path's first moment, their N clamps there, (R,) jumps)."""
    motions = clamps.count
    if not motions:
        raise InputError(path.source, "motion", "no clamps to move", "give those of one rod or more")
    if configuration.count not in (motions, motions * material.count) or path.count not in (1, motions):
        raise InputError(path.source, "motion", f"{path.count} motions and {configuration.count} rods for {motions} clamps and "
                         f"{material.count} materials", "give one motion for all, or one for each rod")
    rods = np.arange(motions * material.count)
    if configuration.count == motions:
        configuration = configuration.take(rods % motions)
    check_rows("predict", loads, len(rods), configuration.edges + 1)

    def go(there: Configuration, motion: Motion) -> tuple[Solution, np.ndarray]:
        way = Journey(motion, material, sub_step, configuration.rest_length, up, solver, precision, surroundings, loads)
        return way.end(there)

    solution = relax(configuration, material, clamps.take(rods % motions), solver, up=up, precision=precision,
                     configuration_index=rods, material_index=rods // motions, external=loads, **surroundings.arguments)
    jumps = np.zeros(len(rods), dtype=np.int32)
    approach = motion_between(clamps, path.at(0, clamps))
    parts = (approach.start_shift, approach.end_shift, approach.start_turn, approach.end_turn)
    if any((np.linalg.norm(part, axis=-1) > STILL).any() for part in parts if part is not None):
        solution, jumps = go(solution.configuration, approach)
    return go, rods // motions, (solution, approach.at(1.0), jumps)


@typed
def predict_step(
    configuration: Configuration, material: Material, clamps: Clamps, goal: Annotated[Clamps, "K"], *,
    rotation: Annotated[ArrayLike | None, "() | 1K"] = None, sub_step: float = LARGEST_TURN, up: ArrayLike = (0.0, 0.0, 1.0),
    precision: str = "f32", watch: bool = True, obstacles: Sequence[Obstacle] = (), radius: ArrayLike | None = None,
    loads: PointLoads | None = None,
) -> tuple[Solution, np.ndarray | None]:
    """One rod after each of K candidate motions of its clamps, for planners: the solution, K rods, and (K,) how often each has
    jumped to another branch.

    configuration  one rod at rest under ``clamps``, one row
    material       one row
    goal           (K) clamps, of the kinds of ``clamps``
    rotation       (K,) rad by which the far frame turns about the rod, whole turns included; None: the shortest way
    watch          whether jumps are detected, and sub-steps that look like one are repeated in smaller ones. Without it a call
                   takes three quarters of the time and returns None in place of the jumps
    obstacles, radius  as in :func:`doo_ti.relaxation.relax.relax`, for K rods; without friction
    loads          forces and masses at the vertices, of K rows or one

    The number of sub-steps of a rod depends on its own motion. A rod that does not converge in one of them keeps that status.
    Raises InputError where there is more than one rod or material.
    """
    for name, rows in (("configuration", configuration.count), ("material", material.count),
                       ("clamps", len(clamps.start_position))):
        if rows != 1:
            raise InputError("predict_step", name, f"{rows} rows", "give one; only `goal` has a row for each motion")
    doubt_angle("predict_step", "rotation", rotation)
    count = len(goal.start_position)
    surroundings = Surroundings.checked("predict_step", obstacles, radius, count)
    check_rows("predict_step", loads, count, configuration.edges + 1)
    rows = np.zeros(count, dtype=np.int64)
    motion = motion_between(clamps.take(rows), goal, None if rotation is None else np.broadcast_to(rotation, count))
    still = {f"{end}_{part}": None for end in ("start", "end") for part in ("shift", "turn")
             if not getattr(motion, f"{end}_{part}").any()}
    journey = Journey(replace(motion, **still), material, sub_step, configuration.rest_length, up, precision=precision,
                      surroundings=surroundings, loads=loads)
    solution, jumps = journey.end(configuration.take(rows), watch)
    return solution, jumps if watch else None


def _part(motion: Motion, first: float, last: float) -> Motion:
    """The part of a motion from one share of it to another."""
    def share(value):
        return None if value is None else (last - first) * value
    return replace(motion, clamps=motion.at(first), start_shift=share(motion.start_shift), end_shift=share(motion.end_shift),
                   start_turn=share(motion.start_turn), end_turn=share(motion.end_turn), end_spin=share(motion.end_spin))


def rotation_about_rod(motion: Motion) -> np.ndarray:
    """(N,) rad by which a motion turns the far frame about its tangent, beyond the parallel transport of the frame; whole turns
    are those of the motion's own rotation vector and roll."""
    before, after = motion.clamps.end_frame, motion.at(1.0).end_frame
    carried = matrix_from_quaternion(smallest_rotation(before[..., 0], after[..., 0]))
    m1 = np.einsum("nij,nj->ni", carried, before[..., 1])
    angle = angle_about(after[..., 0], m1, after[..., 1])
    spin = 0.0 if motion.end_spin is None else motion.end_spin
    along = 0.0 if motion.end_turn is None else np.sum(motion.end_turn * before[..., 0], axis=-1)
    held = np.broadcast_to(np.asarray(motion.clamps.end) == Clamp.FRAME, len(angle))
    return np.where(held, angle + 2 * np.pi * np.round((spin + along - angle) / (2 * np.pi)), 0.0)
