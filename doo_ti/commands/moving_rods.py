"""Rods that observations show, held by grippers along a path: where they begin, and what ``--theta`` and the options of losses
say of rest curvature, friction, damping and drag."""

from argparse import Namespace
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

import doo_ti
from doo_ti.commands import doubts, given, loading, results
from doo_ti.contact.surroundings import Surroundings
from doo_ti.dynamics.parameters import Dynamics, Stepping
from doo_ti.io.motion_file import TOOL_AXES, ClampPath, load_path
from doo_ti.io.pose_table import NAMED
from doo_ti.rod.frames import matrix_from_quaternion, smallest_rotation, total_twist
from doo_ti.rod.material import UNITS_IN_MM
from doo_ti.rod.observations import Observations
from doo_ti.rod.start import check_experiment, choose_hypothesis, observation_clamps, start_configuration, turn_hypotheses
from doo_ti.rod.types import Clamp, Clamps, Configuration, Material
from doo_ti.system.errors import InputError, require
from doo_ti.system.terminal import busy, warn

LOSSES = ("bend_damping", "twist_damping", "drag", "quadratic_drag")
MOST_STRETCH = 0.1  # by which the rod's length may differ from that of THETA.json
MOST_LENGTHS = 100.0  # of a rod, between its clamps
FAR_OFF, NEAR = 0.05, 0.01
"""Shares of the rod's length, from a clamp to where its motion begins: more than the first is no error of measurement; up to
the second it begins at the clamp."""


# --- options -------------------------------------------------------------------------------------------------------------


def add_losses(parser) -> None:
    """Damping and drag of rods with inertia."""
    group = parser.add_argument_group("losses", "of rods that observations show (docs/dynamics.md)")
    given.add(group, "--bend-damping", "S", given.not_negative("s"), "bending at the rate ω̇ is resisted by S B ω̇ (default 0)")
    given.add(group, "--twist-damping", "S", given.not_negative("s"), "the same of twist (default 0)")
    given.add(group, "--drag", "C", given.not_negative("1/s"), "force −C v on each unit of mass, 1/s (default 0)")
    given.add(group, "--quadratic-drag", "C2", given.not_negative("1/mm"), "force −C2 |v| v, 1/mm (default 0)")


def add_motion(parser) -> None:
    """The path of the grippers of observed rods, and how its file states it."""
    given.add(parser, "--motion", "PATH", str, "poses of the clamps over time: .npz, or .csv such as a robot's log")
    parser.add_argument("--relative", action="store_true",
                        help="apply the motion relative to each observation's own clamps, instead of as absolute poses")
    group = parser.add_argument_group("the motion's file", "docs/motions.md")
    given.add(group, "--motion-columns", "time=NAME,…", str, "in a .csv: the column of the time, and what the columns of the "
              "grippers begin with, as in start=left,end=right")
    given.add(group, "--motion-axis", "AXIS|AXIS,AXIS", str, "the axis, x, y, z, -x, -y or -z, of the tools at the start and "
              "at the end that points along the rod, where orientations are stated (default x)")
    group.add_argument("--motion-unit", choices=tuple(UNITS_IN_MM), help="unit of all lengths in PATH (default: --unit, else "
                       "as its columns state, else mm)")
    given.add(group, "--motion-up", "X,Y,Z|AXIS", given.direction, "direction against gravity in PATH, which is "
              "turned about the origin so that it becomes that of OBS (default: both have the same coordinates)")


OF_MOTIONS = ("motion", "motion_columns", "motion_axis", "motion_unit", "motion_up", "relative")
"""Options that only paths of grippers have a use for."""


# --- rods ----------------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class HeldRods:
    """N rods held by grippers that move, under G materials: R = G·N, material by material.

    names       R of them
    start       (R) the rods as they begin, or one for all; those of observations have the whole turns of :func:`settled`
    clamps      (N) how they are held at first
    path        where the grippers go: N paths, or one for all
    material    G rows, which the columns of ``theta`` state
    newtons     (R,) N in the unit of force, or None
    observations  (N) that show them, or None
    """

    name: str
    names: list[str]
    start: Configuration
    clamps: Clamps
    path: ClampPath
    material: Material
    theta: dict[str, np.ndarray]
    newtons: np.ndarray | None
    up: np.ndarray
    surroundings: Surroundings
    observations: Observations | None = None


def held_rods(options: Namespace, out: Path, kinds: tuple[Clamp | None, Clamp | None], moving: bool = False) -> HeldRods:
    """The rods of the file ``options.source``, whose clamps go along ``--motion``, at first of these ``kinds``; ``moving`` with
    inertia."""
    require(options.motion is not None, given.SOURCE, "--motion", "missing", "name a file of poses, or give a scene of motion")
    grid, surroundings, theta = given.grid(options), given.surroundings(options), given.theta(options)
    if theta is not None and theta.friction is not None:
        use = "that of all obstacles" if surroundings.bodies else "ignored without obstacles"
        options.friction_note = f"; its friction of {theta.friction:.3g} is {use}"
        surroundings = surroundings.rubbing(theta.friction)
    observations = loading.load(options, options.source)
    results.refuse_overwriting(out, options.source, options.motion)
    path = _path(options, observations.up)
    if not (path.tangents_only or options.relative):  # rods are held by the frames of the path's first moment, without own ones
        frames = {name: np.broadcast_to(value[0], (observations.count, 3, 3)) for name, value in
                  (("start_frame", path.start_frame), ("end_frame", path.end_frame))
                  if value is not None and getattr(observations, name) is None and value.shape[1] in (1, observations.count)}
        observations = replace(observations, **frames)
    require(path.count in (1, observations.count) or observations.count <= 1, options.motion, "positions_mm",
            f"{path.count} motions for {observations.count} observations", "give one motion, or one for each observation")
    if observations.count < path.count:
        observations = observations.take(np.zeros(path.count, dtype=np.int64))
    clamps = observation_clamps(observations, *kinds)
    check_experiment(observations, clamps, grid.axes[-1].values[-1], 0.0)
    path = path.relative_to(clamps) if options.relative else path
    check_reach(path, clamps, float(observations.rest_length.sum()))
    materials = with_rest_curvature(options, grid.materials(), observations.rest_length, moving)
    names = [f"cell {cell}, " * (materials.count > 1) + f"observation {label}"
             for cell in range(materials.count) for label in observations.labels]
    newtons = given.newtons(options, materials.weight)
    return HeldRods(observations.name, names, settled(observations, clamps, materials, surroundings.at(0)), clamps, path,
                    materials, grid.cell_values(), None if newtons is None else np.repeat(newtons, observations.count),
                    observations.up, surroundings, observations)


@dataclass(frozen=True)
class SimulatedRods:
    """What is to be simulated of R rods: arguments of :func:`doo_ti.dynamics.simulate.simulate`, N in their unit of force, or
    None, and (R, V, 3) the ``first_force`` of contact at the first instant, or one for all."""

    name: str
    names: list[str]
    start: Configuration
    material: Material
    grippers: "doo_ti.Grippers"
    dynamics: Dynamics
    stepping: Stepping
    up: np.ndarray
    pairs: tuple[np.ndarray, np.ndarray]
    surroundings: Surroundings
    newtons: np.ndarray | None
    first_force: np.ndarray | float


def simulated_rods(options: Namespace, out: Path, changes: dict) -> SimulatedRods:
    """Rods that observations show, at rest where their motion begins.

    changes  fields of :class:`doo_ti.dynamics.parameters.Stepping`
    """
    from doo_ti.dynamics.theta import simulated
    from doo_ti.motion.path import LARGEST_TURN
    from doo_ti.motion.predict import begun, grippers_along, rate_of

    given.refuse(options, ("fill_gaps", "smoothing"), "given, but the motion has no markers", "leave it out")
    start, end = given.clamps(options)
    held = held_rods(options, out, (start, Clamp.FREE if options.free_end else end), True)
    rate = options.rate
    path = held.path if rate is None else held.path.resampled(rate) if held.path.timed else replace(
        held.path, time=held.path.time / rate, timed=True)
    require(path.timed, given.SOURCE, "--rate", "missing, and the motion has no times", "give its moments per second")
    options.theta_note = given.EVERYTHING
    theta, stepping = given.theta(options), Stepping(rate_of(path), **changes)
    # Damping, drag and the mass of markers are those of --theta but for what the options give.
    dynamics = Dynamics() if theta is None else simulated([theta])[1]
    dynamics = replace(dynamics, **{name: getattr(options, name) for name in LOSSES if getattr(options, name) is not None})
    warn_of(held, options)
    with busy(f"relaxing {len(held.names)} rods (kernels are compiled once on a machine)"):
        _, rows, (first, clamps, _) = begun(held.start, held.material, held.clamps, path, LARGEST_TURN, held.up,
                                            doo_ti.Newton(), "f64", held.surroundings.at(0))
    warn_of_start(held, first.configuration)
    failed = np.flatnonzero(~first.converged)
    if len(failed):
        raise InputError(options.source, "vertices_mm", f"{held.names[failed[0]]} has no equilibrium where the motion begins",
                         "let the motion begin where the rod is held, within its length")
    each = np.arange(len(rows))
    grippers = grippers_along(path, clamps).take(each % held.observations.count)
    return SimulatedRods(held.name, held.names, first.configuration, held.material, grippers, dynamics, stepping, held.up,
                         (each, rows), held.surroundings, held.newtons,
                         0.0 if first.contact_force is None else first.contact_force)


def _path(options: Namespace, up: np.ndarray) -> ClampPath:
    """The path of the grippers in the file of ``--motion``, in the coordinates of observations with ``up`` (3,) against
    gravity."""
    named, axes, turn = None, [axis.strip() for axis in (options.motion_axis or "x").split(",")], None
    if options.motion_columns is not None:
        parts = [part.partition("=") for part in options.motion_columns.split(",")]
        named = {name.strip(): column.strip() for name, _, column in parts}
        require(all(named.values()) and named.keys() <= set(NAMED), given.SOURCE, "--motion-columns",
                f"{options.motion_columns!r}", f"give NAME=COLUMN for some of {', '.join(NAMED)}")
    axes = axes * 2 if len(axes) == 1 else axes
    if len(axes) != 2 or not set(axes) <= TOOL_AXES.keys():
        known = ", ".join(TOOL_AXES)
        raise InputError(given.SOURCE, "--motion-axis", f"{options.motion_axis!r}", f"give one or two of {known}")
    if options.motion_up is not None:
        turn = matrix_from_quaternion(smallest_rotation(options.motion_up, up))
    return load_path(Path(options.motion), options.motion_unit or options.unit, named, tuple(axes), turn)


def settled(observations: Observations, clamps: Clamps, materials: Material, surroundings: Surroundings) -> Configuration:
    """(G·N) the rods at the start, material by material: of several whole turns that fit, what :func:`.choose_hypothesis`
    takes."""
    index, turns = turn_hypotheses(observations, clamps)
    starts = start_configuration(observations.take(index), clamps.take(index), turns)
    if len(index) == observations.count:
        return starts
    of_material, row = np.divmod(np.arange(materials.count * len(index)), len(index))
    solution = doo_ti.relax(starts, materials, clamps.take(index), up=observations.up, configuration_index=row,
                            material_index=of_material, **surroundings.arguments)
    score = doo_ti.distance(solution.configuration, observations, index[row])
    best = choose_hypothesis(of_material * observations.count + index[row], score, solution.converged & solution.stable,
                             total_twist(solution.configuration.quaternions))
    doubts.warn_of_turns(observations, index[row][best], turns[row][best])
    return starts.take(row[best])


def check_reach(path: ClampPath, clamps: Clamps, length: float) -> None:
    """Raise InputError where clamps are further apart at a moment than :data:`MOST_LENGTHS` of the rod: positions in another
    unit, not a rod that is too short."""
    for moment in range(path.moments):
        held = path.at(moment, clamps)
        apart = np.linalg.norm(held.end_position - held.start_position, axis=-1).max()
        require(not apart > MOST_LENGTHS * length, path.source, f"moment {moment}",
                f"the clamps are {apart:.4g} mm apart, and the rod {length:.4g} mm long", "correct the positions")


def warn_of(held: HeldRods, options: Namespace) -> None:
    """Print a warning where a rod is implausible, and where its path begins farther from its clamps than :data:`FAR_OFF` of it:
    displacements, perhaps, or the path of another rod. To be called once everything is checked."""
    doubts.warn(held.observations, held.surroundings, **loading.stated(options))
    for name, off in _begins_off(held).items():
        if off.max() > FAR_OFF * held.observations.rest_length.sum():
            warn(f"{held.path.source}: {name}_mm: the motion begins {off.max():.4g} mm from the clamp of observation "
                 f"{held.observations.labels[off.argmax()]}; give --relative where these are displacements")
            return


def warn_of_start(held: HeldRods, rods: Configuration) -> None:
    """Print a warning where ``rods`` (R), at rest where their paths begin, are far from the marks of their observations; of
    those whose paths begin where they were observed."""
    row = np.arange(rods.count) % held.observations.count
    there = np.max([*_begins_off(held).values()], axis=0) <= NEAR * held.observations.rest_length.sum()
    doubts.warn_of_distance(held.observations, np.where(there[row], doo_ti.distance(rods, held.observations, row), 0.0))


def _begins_off(held: HeldRods) -> dict[str, np.ndarray]:
    """(N,) mm, of both ends by their names: how far the path begins from the clamps of the observations."""
    first = held.path.at(0, held.clamps)
    return {name: np.linalg.norm(getattr(first, name) - getattr(held.clamps, name), axis=-1)
            for name in ("start_position", "end_position")}


# --- theta ---------------------------------------------------------------------------------------------------------------


def require_length(source, theta, length: float) -> None:
    """Raise InputError, naming the file ``source`` of ``theta``, where that is of a rod of another ``length``, mm."""
    own = float(np.sum(theta.rest_length))
    require(not abs(length - own) > MOST_STRETCH * own, source, "rest_length_mm",
            f"{own:.4g} mm in all, the rods are {length:.4g} mm long", "give the theta of this rod, or the unit of the lengths")


def with_rest_curvature(options: Namespace, material: Material, rest_length: np.ndarray, moving: bool = False) -> Material:
    """The material with what ``--theta`` says of its rest curvature, at the joints of rods of ``rest_length`` (E,), and of rods
    that move of its own weight, that of markers apart. Raises InputError where the rod has another length."""
    theta = given.theta(options)
    if theta is None:
        return material
    require_length(options.theta, theta, float(np.sum(rest_length)))
    weight = material.weight * (1.0 - theta.marker_share) if moving else material.weight
    rest = theta.rest_curvature_at(rest_length) if theta.rest.any() else None
    return Material(material.bend, material.twist, weight, None if rest is None else rest[None])
