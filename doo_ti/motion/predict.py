"""Prediction of motion: the configuration of a rod after its clamps have moved (§III-D).

    Γ_2 = F(… F(F(Γ_1, E_Θ, C_1+δ), E_Θ, C_1+2δ) …, E_Θ, C_2)

Γ_1 is a minimum of E_Θ under C_1. The clamps move to C_2 in sub-steps, as many as their motion needs; after each the rod is
relaxed from its last configuration, so that it follows its branch of minima. Where the branch ends the rod jumps to another
one; jumps are counted. The motion is quasi-static, without inertia; with it, and with damping, drag and friction, it is that
of :func:`predict_moving` (docs/dynamics.md).

Axes: T moments, G materials, N motions, R = G·N rods, material by material, E edges, K candidate poses.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import accumulate
from typing import Annotated

import numpy as np
from numpy.typing import ArrayLike

from doo_ti.contact.obstacles import Obstacle
from doo_ti.contact.surroundings import Moving, Surroundings
from doo_ti.dynamics.grippers import Grippers, refined_within_reach
from doo_ti.dynamics.parameters import Dynamics, Stepping
from doo_ti.dynamics.simulate import simulate
from doo_ti.io.motion_file import ClampPath
from doo_ti.motion.journey import Journey
from doo_ti.motion.path import LARGEST_TURN, Motion, motion_between, rotation_about_rod
from doo_ti.relaxation.external import PointLoads, check_rows
from doo_ti.relaxation.newton import Newton
from doo_ti.relaxation.relax import relax
from doo_ti.rod.frames import edge_frames, total_twist
from doo_ti.rod.material import doubt_angle
from doo_ti.rod.types import POSES, Clamps, Configuration, Material, Solution, Status, finite_rods, sticky
from doo_ti.system.arguments import short_repr, typed
from doo_ti.system.errors import InputError

STILL = 1e-9  # mm and rad: clamps that move by less count as fixed
MOST_TURN = np.radians(170.0)  # of the far frame between two moments: its sense is taken from the shorter way
EVEN = 1e-3  # of an interval: by how much the intervals between moments may differ
REPORTED = ("energy", "residual", "iterations", "status", "stable", "end_force")
"""Fields of :class:`doo_ti.rod.types.Solution` that are kept of every moment."""


@dataclass(frozen=True)
class Prediction:
    """R rods at T moments.

    time          (T,) s
    start         (T, R, 3) mm, vertex 0
    quaternions   (T, R, E, 4) frames
    rest_length   (E,) mm, or (R, E)
    energy, residual, iterations, status, stable (T, R), end_force (T, R, 3)
                  as in :class:`doo_ti.rod.types.Solution`; iterations since the moment before, and of the statuses so far the
                  first one that is not converged
    jumps         (T, R) jumps to another branch since the moment before
    end_rotation  (T, R) rad by which the far clamp has turned the rod about its tangent, whole turns included
    material, motion  (R,) rows
    contact_force  (T, R, V, 3) of obstacles on the vertices, mm (energy per mm): times ``material.newton`` N; None without
                  obstacles
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
        return np.stack([self.at(moment).vertices for moment in range(len(self.start))])

    @property
    def total_twist(self) -> np.ndarray:
        """(T, R) Σ m_i, rad, whole turns included."""
        return total_twist(self.quaternions)

    @property
    def followed(self) -> np.ndarray:
        """(T, R) bool: at every moment so far the rod converged to a certified minimum, or of a rod with inertia all steps
        converged; else there is no prediction."""
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
                   :func:`doo_ti.motion.predict.predict_moving` with quasi-static steps
    loads          forces and masses at the vertices, of R rows or one

    A rod that fails keeps that status at all later moments; the next interval begins at its last configuration. Raises
    InputError where numbers of rods and motions do not match.
    """
    surroundings = Surroundings(obstacles, radius)
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
            leg = motion.between(part / between, (part + 1) / between)
            solution, jumps = go(here, leg)
            here, held = finite_rods(solution.configuration, here), leg.at(1.0)
            moments.append((solution, jumps, moments[-1][2] + np.tile(rotation_about_rod(leg), len(rods) // motions)))
            advance(len(rods))
    solutions, jumps, rotation = zip(*moments, strict=True)
    found = Prediction(time=time, rest_length=here.rest_length.copy(), jumps=np.stack(jumps),
                       end_rotation=np.stack(rotation), material=rods, motion=np.arange(len(rods)) % motions,
                       **_reported(solutions))
    return replace(found, jumps=np.where(found.followed, found.jumps, 0))


def _reported(solutions: Sequence[Solution]) -> dict[str, np.ndarray]:
    """Fields of :class:`Prediction` that are those of the solutions at its moments."""
    found = {name: np.stack([getattr(solution, name) for solution in solutions]) for name in REPORTED}
    found["status"] = np.array(list(accumulate(found["status"], sticky)))
    found["stable"] &= found["status"] == Status.CONVERGED
    if solutions[0].contact_force is not None:
        found["contact_force"] = np.stack([solution.contact_force for solution in solutions])
    for name in ("start", "quaternions"):
        found[name] = np.stack([getattr(solution.configuration, name) for solution in solutions])
    return found


def _of_motions(rest_length: np.ndarray, motions: int) -> np.ndarray:
    """(E,), or (N, E) of N motions: rods come material by material."""
    return rest_length if rest_length.ndim == 1 else rest_length[:motions]


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
        way = Journey(motion, material, sub_step, _of_motions(configuration.rest_length, motions), up, solver, precision,
                      surroundings, loads)
        return way.end(there)

    solution = relax(configuration, material, clamps.take(rods % motions), solver, up=up, precision=precision,
                     configuration_index=rods, material_index=rods // motions, external=loads, **surroundings.arguments)
    jumps = np.zeros(len(rods), dtype=np.int32)
    approach = motion_between(clamps, path.at(0, clamps))
    if any((np.linalg.norm(part, axis=-1) > STILL).any() for part in approach.parts.values()):
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
    still = {name: None for name, part in motion.parts.items() if name != "end_spin" and not part.any()}
    journey = Journey(replace(motion, **still), material, sub_step, configuration.rest_length, up, precision=precision,
                      surroundings=surroundings, loads=loads)
    solution, jumps = journey.end(configuration.take(rows), watch)
    return solution, jumps if watch else None


@typed
def predict_moving(
    configuration: Configuration, material: Material, clamps: Clamps, path: ClampPath, dynamics: Dynamics, stepping: Stepping,
    *, between: int = 1, up: ArrayLike = (0.0, 0.0, 1.0), advance: Callable[[int], None] = lambda rods: None,
    obstacles: Sequence[Obstacle | Moving] = (), radius: ArrayLike | None = None, loads: PointLoads | None = None,
) -> Prediction:
    """As :func:`doo_ti.motion.predict.predict`, with inertia: rods at rest at the path's first moment, then carried along
    it at the speed that the rate gives it.

    dynamics  of G rows or one
    stepping  rate: moments of the path per second; the time steps are between the states that are returned. Quasi-static steps
              have friction without inertia
    between   number of returned states per interval of the path; clamps move between its moments on cubics
    obstacles, radius  as in :func:`doo_ti.dynamics.simulate.simulate`, with friction; a :class:`.Moving` has the instants of
              the states that are returned. On the way to the path's first moment there is no friction, and nothing moves
    loads     forces and masses at the vertices, of R rows or one

    In what is returned ``stable`` says that all steps have converged, since a rod in motion is at no minimum; ``energy`` is
    without the kinetic energy, and ``jumps`` are counted only on the way to the first moment. Raises InputError where numbers
    of rods and motions do not match, and for a far frame that turns by half a turn or more from one moment to the next.
    """
    even = path.states(between)
    _, rods, (first, held, jumps) = begun(configuration, material, clamps, path, LARGEST_TURN, up, Newton(), "f64",
                                         Surroundings(obstacles, radius).at(0), loads)
    rows = np.arange(len(rods)) % clamps.count
    lengths = _of_motions(configuration.rest_length, clamps.count)
    grippers = refined_within_reach(grippers_along(path, held), between, lengths)
    rate, done = stepping.rate * between, 0

    def progress(frames: int) -> None:
        nonlocal done
        advance((frames - done) * len(rods))
        done = frames

    found = simulate(first.configuration, material, grippers.take(rows), dynamics,
                     replace(stepping, rate=rate, detailed=True), up=up, pairs=(np.arange(len(rods)), rods), progress=progress,
                     obstacles=obstacles, radius=radius, loads=loads)
    energies = found.detail.energies
    stored = sum(energies[name] for name in ("bending", "twist", "gravity", "springs", "loads") if name in energies)
    status = sticky(first.status[:, None], found.status).T
    turned = [np.zeros(len(rows))]
    for k in range(grippers.instants - 1):
        turned.append(turned[-1] + rotation_about_rod(motion_between(grippers.at(k), grippers.at(k + 1)))[rows])

    time = even if stepping.quasi_static else np.arange(grippers.instants) / rate + path.time[0]

    def with_first(before, after):
        return np.concatenate([before[None], np.moveaxis(after, 1, 0)])

    return Prediction(
        time=time,
        start=with_first(first.configuration.vertices[:, 0], found.positions[:, :, 0]),
        quaternions=np.moveaxis(found.detail.quaternions, 1, 0), rest_length=first.configuration.rest_length.copy(),
        energy=first.energy + (stored - stored[:, :1]).T, residual=with_first(first.residual, found.residual),
        iterations=with_first(first.iterations, found.iterations), status=np.concatenate([first.status[None], status]),
        stable=np.concatenate([first.stable[None], status == Status.CONVERGED]),
        end_force=with_first(first.end_force, found.end_force),
        jumps=np.concatenate([jumps[None], np.zeros((grippers.instants - 1, len(rows)), dtype=jumps.dtype)]),
        end_rotation=np.stack(turned), material=rods, motion=rows,
        contact_force=None if found.contact_force is None else with_first(first.contact_force, found.contact_force),
        substeps=found.substeps, step_error=None if stepping.tolerance is None else found.error)


def rate_of(path: ClampPath) -> float:
    """Moments per second. Raises InputError where they are not equally far apart."""
    step = np.diff(path.time)
    if np.ptp(step) > EVEN * step.mean():
        raise InputError(path.source, "time_s", f"moments {step.min():.4g} to {step.max():.4g} s apart",
                         "give equal intervals for rods with inertia")
    return float(1.0 / step.mean())


def grippers_along(path: ClampPath, held: Clamps) -> Grippers:
    """The grippers of N motions at the moments of ``path``, ``held`` at the first."""
    turns = [path.rotation(k, len(held.start_position)) for k in range(path.moments - 1)]
    if turns[0] is not None and np.abs(turns).max() > MOST_TURN:
        raise InputError(path.source, "end_rotation", f"{np.degrees(np.abs(turns).max()):.0f} degrees between two moments",
                         f"give moments in between: at most {np.degrees(MOST_TURN):.0f} degrees for rods with inertia")
    clamps = [path.at(k, held) for k in range(path.moments)]
    found = {name: np.stack([getattr(one, name) for one in clamps], axis=1) for name in POSES}
    if path.tangents_only:
        for name in ("start_frame", "end_frame"):
            found[name] = edge_frames(found[name][..., 0], getattr(held, name)[..., 1])
    return Grippers(held.start, held.end, **found)
