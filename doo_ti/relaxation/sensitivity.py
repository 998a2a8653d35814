"""Rods at rest: the forces and moments with which clamps hold their ends, and derivatives by parameters (§III-E).

    loads = end_loads(solution)
    loads.start_force, loads.end_moment, loads.force_unit      # (R, 3), (R, 3), "N"

The derivatives dΓ*/dΘ at stable equilibria follow from the implicit function theorem.

At rest g(ω, Θ) + Aλ = 0 and closure c = 0 hold, so a small change of a parameter θ turns the frames by the solution of

    [H  A] [dω/dθ]     [∂g/∂θ]
    [Aᵀ 0] [dλ/dθ] = − [  0  ],

the very system whose inertia certifies the minimum, with one more right-hand side for each parameter. Vertices follow as
dx_{i+1} = dx_i + l_i (dω_i × t_i). Parameters by name, and the columns each of them adds:

    bend                      α of B = αI: adds to both diagonal entries; mm³
    bend_1, bend_2, bend_12   entries of B; mm³
    twist                     β; mm³
    weight                    μ
    rest_curvature            2: ω̄, constant along the rod; 1/mm
    rest_curvature_per_joint  2 (E−1): joint by joint, its two components together; 1/mm
    up                        2: turns of up about the axes of :func:`doo_ti.rod.frames.tilt_axes`; rad
    gravity                   3: the vector μ up in the world
    length                    ln of a factor on all rest lengths, the clamps staying where they are
    start_shift, end_shift    3 each: displacement of a clamp in the world, the other staying where it is; mm per mm
    start_turn, end_turn      3 each: rotations of a clamped frame in the world, its vertex on the clamp staying where it is;
                              rad. What the clamp does not hold does not turn: the spin of a tangent, all of a position
    modes                     M: changes of ω̄ along the rod, given as an array (M, E−1, 2); 1/mm per 1/mm
    stiffness_modes           M: relative changes at the joints, of B of the edge before and of that after, and of β, given as
                              an array (M, E−1, 3)

With the shifts and the turns a rod follows its clamps. A straight, taut rod cannot: these columns and ``length`` are NaN
where it has no slack.

Among obstacles, contacts that bear a force stay closed and the others open (:mod:`doo_ti.relaxation.contact_sensitivity`).
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from doo_ti.contact.surroundings import smallest_self_gap
from doo_ti.relaxation import parameter_gradient as change
from doo_ti.relaxation import tables as of
from doo_ti.relaxation.external import PointLoads
from doo_ti.relaxation.sensitivity_kernel import run_sensitivity, vertex_forces
from doo_ti.relaxation.tables import Tables
from doo_ti.rod.frames import tilt_axes
from doo_ti.rod.material import force_in_newton
from doo_ti.rod.types import Configuration, Solution
from doo_ti.system import runtime
from doo_ti.system.arguments import short_repr, typed
from doo_ti.system.errors import InputError, require_whole


@dataclass(frozen=True)
class EndLoads:
    """Forces and moments of the clamps on R rods, in the axes of the world; moments about the clamped vertex. The energy grows
    by force · d when a clamp moves by d, and by moment · a when it turns by the small rotation vector a.

    start_force, start_moment, end_force, end_moment  (R, 3), or (R, 3, P) where they are derivatives by P parameters
    physical                                          whether in N and N m; else energies are mm² (relative to weight), forces
                                                      mm and moments mm²
    """

    __repr__ = short_repr

    start_force: np.ndarray
    start_moment: np.ndarray
    end_force: np.ndarray
    end_moment: np.ndarray
    physical: bool

    @property
    def force_unit(self) -> str:
        """"N", or "mm"."""
        return "N" if self.physical else "mm"

    @property
    def moment_unit(self) -> str:
        """"N m", or "mm²"."""
        return "N m" if self.physical else "mm²"

    @classmethod
    def of(cls, loads: np.ndarray, table: Tables, first: int, last: int) -> "EndLoads":
        """``loads`` (R, 4, 3, …) of rods ``first`` to ``last`` of ``table``, in N and N m where materials are physical."""
        physical = table.weight_per_length is not None
        if physical:
            rows = table.material_index[first:last]
            newton = force_in_newton(1.0, table.weight_per_length[rows], table.material[rows, of.WEIGHT])
            loads = loads * np.stack([newton, 1e-3 * newton] * 2, axis=1).reshape(-1, 4, *[1] * (loads.ndim - 2))
        return cls(*(loads[:, k] for k in range(4)), physical)


@typed
@runtime.exclusive
def end_loads(solution: Solution) -> EndLoads:
    """The forces and moments at both ends of every rod of ``solution``, which also holds its materials, clamps and the
    direction of gravity. In N and N m where the material has a weight per length (``Material.from_physical``), else relative to
    weight (:class:`EndLoads`).

    What an end does not hold is zero: the moment at a position clamp, all of a free end. Both forces together carry the rod's
    weight, and point loads. NaN in rods that have not converged, and in taut ones (:class:`doo_ti.rod.types.Solution`).

    Raises InputError for joined solutions, and for rods under an external energy other than forces and masses.
    """
    solution = alone("end_loads", solution)
    table = solution.tables
    nothing = np.zeros((0, 0)), np.zeros((1, table.edges - 1, 3))
    moments = run_sensitivity(solution, solution.converged, *nothing, 0, table.count)[3]
    clamp = table.clamp[table.configuration_index]
    total = 2.0 * table.material[table.material_index, of.WEIGHT, None] * clamp[:, of.TOTAL, None] * table.up
    weight = total - vertex_forces(table).sum(axis=1)
    loads = np.stack([weight - solution.end_force, moments[:, 0], solution.end_force, moments[:, 1]], axis=1)
    loads[~solution.converged | (clamp[:, of.TILT_INNER] == 0)] = np.nan
    return EndLoads.of(loads, table, 0, table.count)


def alone(function: str, solution: Solution) -> Solution:
    """``solution``, an argument of ``function``, as one of rods without an external energy, but for point loads: those held at
    the far end alone hang from there. Raises InputError where it has no tables, and under other external energies."""
    table = solution.tables
    if table is None:
        raise InputError(function, "solution", "joins several calls", "relax where its rods ended")
    loads = table.external
    if loads is None:
        return solution
    if not isinstance(loads, PointLoads) or loads.springs is not None:
        raise InputError(function, "solution", "rods under an external energy",
                         "relax them without, or under forces and masses")
    if table.contact is not None:  # among obstacles vertex 0 is free to move with or without them
        return solution
    clamp = table.clamp.copy()
    loose = clamp[:, of.LOOSE] > 0
    clamp[loose, of.LOOSE], clamp[loose, of.RELEASED], clamp[loose, of.CLOSED] = 0.0, 1.0, 0.0
    return replace(solution, tables=replace(table, clamp=clamp))


CURVATURES = ("rest_curvature", "rest_curvature_per_joint", "modes")
GRIPPERS = ("start_shift", "start_turn", "end_shift", "end_turn")
OF_CLAMPS = ("length", *GRIPPERS)
CLOSED = 2e-3  # of a radius: two parts of a rod that are nearer to each other touch
PARAMETERS = ("bend", "bend_1", "bend_2", "bend_12", "twist", "weight", "up", "gravity", *CURVATURES, *OF_CLAMPS)
STIFFNESS_MODES = "stiffness_modes"


@dataclass(frozen=True)
class Sensitivity:
    """dΓ*/dΘ of R rods for P columns; NaN in rods that are not usable.

    columns        (P,) what each column is the derivative by, such as "bend", "rest_curvature[1]", "up[0]"
    vertices       (R, V, 3, P) dx, mm per unit of the parameter
    rotations      (R, E, 3, P) rotation of each frame in its own axes (t, m1, m2), rad per unit
    loads          (R, 3, P) each: changes of the forces and moments at both ends, per unit of the parameter
    usable         (R,) bool: the rod is at a stable equilibrium
    configuration  the rods
    """

    __repr__ = short_repr

    columns: tuple[str, ...]
    vertices: np.ndarray
    rotations: np.ndarray
    loads: EndLoads
    usable: np.ndarray
    configuration: Configuration

    @property
    def directors(self) -> np.ndarray:
        """(R, E, 3, P) change of m1: its turn about t towards m2, less that about m2 towards −t."""
        frames = self.configuration.frames
        about_t, about_m2 = self.rotations[:, :, None, 0], self.rotations[:, :, None, 2]
        return frames[..., 2, None] * about_t - frames[..., 0, None] * about_m2


@typed
@runtime.exclusive
def sensitivity(solution: Solution, parameters: Sequence[str] = ("bend", "twist", "weight"), modes: np.ndarray | None = None,
                first: int = 0, last: int | None = None, *, stiffness_modes: np.ndarray | None = None, rotations: bool = True,
                loads: bool = True) -> Sensitivity:
    """dΓ*/dΘ of every rod of ``solution``, which also holds its materials, clamps and the direction of gravity.

    solution    of :func:`doo_ti.relaxation.relax.relax` in f64: an equilibrium reached to a residual r is off by about r, and
                so are its derivatives
    parameters  from PARAMETERS or "stiffness_modes", in the order of the columns
    modes, stiffness_modes  (M, E−1, 2) and (M, E−1, 3), where they are among the parameters
    first, last of the rods of ``solution``: derivatives of all of them at once may be more than memory holds
    rotations, loads  whether those are computed; where not, they have no columns, and the call takes a third less time

    Rods that have not converged, are not certified stable, are infeasible, or touch themselves come out as NaN. A round rod
    with both spins free keeps its first spin; along other motions that cost nothing (a weightless bow about its chord, a rod
    that hangs from a point about up) a rod does not move either.

    Forces and masses at vertices (:class:`.PointLoads`) stay as they are.

    Raises InputError for unknown or repeated parameters, modes of another shape, "up" of rods with point masses, and where
    :func:`.end_loads` does.
    """
    solution = alone("sensitivity", solution)
    table = solution.tables
    along = {"modes": modes, STIFFNESS_MODES: stiffness_modes}
    check_parameters("sensitivity", parameters, (*PARAMETERS, STIFFNESS_MODES), along, table)
    last = table.count if last is None else last
    require_whole("sensitivity", "first", first, 0, table.count)
    require_whole("sensitivity", "last", last, first, table.count)
    names, directions, along = parameter_directions(parameters, table.edges, table.up, along)
    vertices, turns, forces, _, sound = run_sensitivity(solution, at_minima(solution), directions, along, first, last,
                                                        rotations, loads)
    start = table.configuration_index[first:last]
    hanging = table.released[start]
    if hanging.any() and "end_shift" in parameters:
        column = names.index("end_shift[0]")
        vertices[hanging, :, :, column : column + 3] += np.eye(3)  # held at the far end alone they go where it goes
    taut = taut_rods(table)[first:last]
    if taut.any():
        columns = [k for k, name in enumerate(names) if name.partition("[")[0] in OF_CLAMPS]
        for array in (vertices, turns)[: 1 + rotations]:
            array[np.ix_(taut, range(array.shape[1]), range(3), columns)] = np.nan
        forces[taut] = np.nan
    return Sensitivity(names, vertices, turns, EndLoads.of(forces, table, first, last), sound,
                       solution.configuration.take(slice(first, last)))


def at_minima(solution: Solution) -> np.ndarray:
    """(R,) rods that have derivatives: at certified minima, where they do not touch themselves."""
    contact = solution.tables.contact
    rests = solution.converged & solution.stable
    if contact is None or contact.surroundings.itself is None:
        return rests
    return rests & (smallest_self_gap(solution.configuration.vertices, contact.radius) >= CLOSED * contact.radius)


def taut_rods(table: of.Tables) -> np.ndarray:
    """(R,) rods that are straight and have no slack to follow their clamps."""
    return (table.clamp[:, of.TILT_INNER] == 0)[table.configuration_index]


@typed
def gripper_jacobian(solution: Solution) -> Sensitivity:
    """The derivatives of R rods at rest by the poses of both grippers, 12 columns: displacement of the start clamp (mm) and its
    rotation about its vertex (rad), then of the end clamp, all in the axes of the world.

        jacobian = gripper_jacobian(solution)
        jacobian.vertices            # (R, V, 3, 12) mm per mm and mm per rad
        jacobian.loads.end_moment    # (R, 3, 12)

    See :func:`sensitivity` for rods that have none.
    """
    return sensitivity(solution, GRIPPERS)


def parameter_directions(parameters: Sequence[str], edges: int, up: np.ndarray, given: dict[str, np.ndarray | None]
                         ) -> tuple[tuple[str, ...], np.ndarray, np.ndarray]:
    """Names (P,) of the columns of ``parameters``, what changes along each (P, DIRECTION_COLUMNS), and the changes along the
    rod (M, E−1, 3) that these refer to: of rest curvature, or of ln B and ln β. ``given``: modes."""
    names, blocks, along = [], [], [np.zeros((0, edges - 1, 3))]
    for name in parameters:
        if name in CURVATURES or name == STIFFNESS_MODES:
            own = _modes(name, edges, given.get(name))
            block = _unchanged(len(own))
            block[:, change.MODE] = sum(map(len, along)) + np.arange(len(own))
            block[:, change.STIFFENS] = name == STIFFNESS_MODES
            along.append(np.pad(own, ((0, 0), (0, 0), (0, 3 - own.shape[2]))))
        else:
            block = _directions(name, up)
        names += [name] if len(block) == 1 else [f"{name}[{k}]" for k in range(len(block))]
        blocks.append(block)
    along = np.concatenate(along)
    # Kernels take no arrays without entries.
    return tuple(names), np.concatenate(blocks), along if len(along) else np.zeros((1, edges - 1, 3))


def check_parameters(function: str, parameters: Sequence[str], known: tuple[str, ...], given: dict[str, np.ndarray | None],
                     table: of.Tables) -> None:
    """Raise InputError, naming ``function``, unless ``parameters`` are ``known`` and they and the modes ``given`` suit
    ``table``."""
    every = ", ".join(known)
    if isinstance(parameters, str) or not parameters:
        raise InputError(function, "parameters", f"{parameters!r}", f"give a list of {every}")
    for name in parameters:
        if name not in known:
            raise InputError(function, "parameters", f"{name!r} is unknown", f"use {every}")
    if len(set(parameters)) < len(parameters):
        raise InputError(function, "parameters", f"{', '.join(parameters)}", "give each parameter once")
    for name, modes in given.items():
        if (name in parameters) != (modes is not None):
            raise InputError(function, name, "given without their parameter, or the parameter without them", "give both")
        size = table.edges - 1, 3 if name == STIFFNESS_MODES else 2
        if modes is not None and (np.ndim(modes) != 3 or np.shape(modes)[1:] != size):
            raise InputError(function, name, f"shape {np.shape(modes)}", f"give (M, {size[0]}, {size[1]})")
    if "up" in parameters and table.external is not None and table.external.mass.any():
        raise InputError(function, "parameters", "'up' of rods with point masses, whose weight turns too",
                         "give their weight as forces, which do not turn")


def _modes(name: str, edges: int, given: np.ndarray | None) -> np.ndarray:
    """(M, E−1, 2) of a parameter among CURVATURES, or (M, E−1, 3) of STIFFNESS_MODES."""
    if given is not None:
        return np.asarray(given, dtype=np.float64)
    if name == "rest_curvature":
        return np.repeat(np.eye(2)[:, None], edges - 1, axis=1)
    return np.einsum("ij,ab->iajb", np.eye(edges - 1), np.eye(2)).reshape(2 * (edges - 1), edges - 1, 2)


def _unchanged(count: int) -> np.ndarray:
    rows = np.zeros((count, change.DIRECTION_COLUMNS))
    rows[:, change.MODE] = change.NO_MODE
    return rows


def _directions(name: str, up: np.ndarray) -> np.ndarray:
    """The rows of :func:`parameter_directions` of one parameter that is the same along the rod."""
    axes = np.eye(3)
    entries = {
        "bend": {change.BEND: [[1, 1, 0]]}, "bend_1": {change.BEND: [[1, 0, 0]]}, "bend_2": {change.BEND: [[0, 1, 0]]},
        "bend_12": {change.BEND: [[0, 0, 1]]}, "twist": {change.TWIST: [[1]]}, "weight": {change.PULL: [up]},
        "up": {change.PULL: np.cross(tilt_axes(up), up), change.TIMES_WEIGHT: [[1], [1]]}, "gravity": {change.PULL: axes},
        "length": {change.STRETCH: [[1]]}, "start_shift": {change.MOVE: axes, change.SHIFT: -axes},
        "end_shift": {change.SHIFT: axes}, "start_turn": {change.TURN_START: axes}, "end_turn": {change.TURN_END: axes}}[name]
    rows = _unchanged(len(next(iter(entries.values()))))
    for first, values in entries.items():
        rows[:, first : first + len(values[0])] = values
    return rows
