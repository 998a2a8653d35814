"""Simulation: many rods through time, every implicit step the minimum of an energy (docs/dynamics.md)."""

from collections.abc import Callable, Sequence
from copy import copy
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike

from doo_ti.contact.obstacles import Obstacle
from doo_ti.contact.surroundings import Moving, Surroundings
from doo_ti.dynamics.energies import Account, Losses, add_loads, damping_shares, stiffened, vertex_numbers
from doo_ti.dynamics.grippers import Grippers, clamp_path, obstacle_path, refined_within_reach
from doo_ti.dynamics.parameters import RATES, Direction, Dynamics, MovingStart, Stepping
from doo_ti.dynamics.trajectory import Trajectory, adapted, joined, kept_apart
from doo_ti.relaxation.external import PointLoads, Springs, check_rows
from doo_ti.relaxation.input_tables import paired_rows, tables, under
from doo_ti.relaxation.newton import MOST_IN_CONTACT, Newton
from doo_ti.relaxation.tables import Tables, whole_start
from doo_ti.relaxation.time_loop import END_FORCE, FRICTION_WORK, MOMENT, RELINKED, STATE, TRIPS
from doo_ti.relaxation.time_slopes import NUMBERS, REMEMBERED
from doo_ti.relaxation.time_steps import Memory, Slopes, Steps, make_steps, slope_memory
from doo_ti.relaxation.time_sweep import INERTIA, LOAD, PLACE_2, VELOCITY_1
from doo_ti.rod.frames import quaternion_product, smallest_rotation, tangent_from_quaternion, unit_vectors
from doo_ti.rod.types import Clamp, Configuration, Material, Status, unit_up
from doo_ti.system.arguments import typed
from doo_ti.system.errors import InputError

NUMBERS_AT_ONCE = 32_000_000  # numbers of positions that a launch writes


@typed
def simulate(
    start: Configuration | MovingStart,
    material: Material,
    grippers: Grippers,
    dynamics: Dynamics,
    stepping: Stepping,
    *,
    springs: Springs | None = None,
    loads: PointLoads | None = None,
    up: ArrayLike = (0.0, 0.0, 1.0),
    pairs: tuple[np.ndarray, np.ndarray] | None = None,
    directions: Sequence[Direction] = (),
    obstacles: Sequence[Obstacle | Moving] = (),
    radius: ArrayLike | None = None,
    progress: Callable[[int], None] | None = None,
) -> Trajectory:
    """Move rods from ``start`` through the instants of ``grippers``.

    start       S rods at the first instant, at rest or, as a :class:`.MovingStart`, with velocities
    material    G rows; dynamics has G or one
    grippers    of S rods, or of one that all share, at T instants
    stepping    how fast the instants follow each other, and the time steps between them
    springs     at the vertices, one row for all rods or R of them
    loads       forces, masses with their inertia, and springs at the vertices, in the place of ``springs``
    pairs       (R,) rows of start and of material that make up each rod; by default they pair one to one, a single row with
                every row of the other
    directions  P parameters to differentiate the positions by, in f64
    obstacles   what the rods may touch but not enter, with friction where it states a coefficient; without directions. A
                :class:`.Moving` has the instants of the grippers
    radius      of the rods, mm, one or (R,), with obstacles
    progress    called with the number of frames that are done

    Returns the T − 1 later instants. A rod whose step fails stops alone; one whose grippers are further apart than it is long
    is infeasible from that instant on. Raises InputError for inputs that do not match.
    """
    begin = start if isinstance(start, MovingStart) else MovingStart(start)
    if directions:
        _check_derivatives(stepping, obstacles)
    given = begin.configuration, material, grippers, dynamics
    direction = unit_up(up, "simulate")
    index = paired_rows(begin.configuration.count, material.count, *((None, None) if pairs is None else pairs), "simulate")
    surroundings = Surroundings.checked("simulate", obstacles, radius, len(index[0]))
    loads = _all_loads(springs, loads, len(index[0]), begin.configuration.edges + 1)
    many = loads is not None and loads.count > 1

    def moved(stepping: Stepping, rows: np.ndarray, progress=None, touching: bool = False) -> tuple[Trajectory, np.ndarray]:
        own, pairs = loads.take(rows) if many else loads, tuple(part[rows] for part in index)
        motion = _Motion(*given, stepping, own, direction, pairs, surroundings.take(rows), touching)
        memory, remembered = motion.begin(begin, directions)
        return motion.run(memory, progress, directions, remembered), motion.relinked

    def run(stepping: Stepping, rows: np.ndarray, progress=None) -> Trajectory:
        if surroundings.itself is None:
            return moved(stepping, rows, progress)[0]
        start = begin.configuration.vertices[index[0][rows]]
        return kept_apart(moved, stepping, rows, start, surroundings.take(rows).radius, progress)

    if stepping.tolerance is None and stepping.precision != "mixed":
        return run(stepping, np.arange(len(index[0])), progress)
    return adapted(run, len(index[0]), stepping, progress)


def _check_derivatives(stepping: Stepping, obstacles: Sequence[Obstacle | Moving]) -> None:
    """Raises InputError where positions are not to be differentiated under those options."""
    for name, value, plain in (("precision", stepping.precision, "f64"), ("tolerance", stepping.tolerance, None)):
        if value != plain:
            raise InputError("simulate", name, f"{value} with directions", f"give {plain}")
    if obstacles:
        raise InputError("simulate", "obstacles", "given with directions", "leave one of the two out")


def _all_loads(springs: Springs | None, loads: PointLoads | None, rods: int, vertices: int) -> PointLoads | None:
    """Springs as loads, or loads. Raises InputError where both are given, and for those of other rods."""
    if springs is not None and loads is not None:
        raise InputError("simulate", "springs", "given beside loads", "give PointLoads(…, springs=springs)")
    for given in (springs, loads):
        check_rows("simulate", given, rods, vertices)
    return loads if springs is None else PointLoads(np.zeros((springs.count, vertices, 3)), springs=springs)


class _Motion:
    """A motion laid out for the kernels."""

    def __init__(self, start, material, grippers, dynamics, stepping, loads, up, pairs, surroundings, touching):
        if grippers.count not in (1, start.count):
            raise InputError("simulate", "grippers", f"{grippers.count} rods, start has {start.count}", "give one, or as many")
        if dynamics.count not in (1, material.count):
            raise InputError("simulate", "dynamics", f"{dynamics.count} rows, material has {material.count}",
                             "give one, or as many")
        self.stepping, self.substeps, self.step = stepping, stepping.substeps, stepping.step
        self.start, self.material, self.dynamics, self.loads, self.up = start, material, self._acting(dynamics), loads, up
        self.grippers = refined_within_reach(grippers, stepping.substeps, start.rest_length)
        self.pairs, self.surroundings, self.touching = pairs, surroundings, touching
        first = grippers.at(0)
        self.first = first if grippers.count == start.count else first.take(np.zeros(start.count, dtype=np.int64))
        self.poses = None
        if surroundings.moves:
            self.poses = obstacle_path(surroundings, stepping, grippers.instants, start.take(pairs[0]))
        self.watched = surroundings.itself is not None and not touching
        self.relinked = np.zeros(0, dtype=bool)

    def _acting(self, dynamics: Dynamics) -> Dynamics:
        """What of it acts: damping does not in quasi-static steps, nor does what :meth:`numbers` leaves out."""
        if not self.stepping.quasi_static:
            return dynamics
        return replace(dynamics, bend_damping=0.0 * dynamics.bend_damping, twist_damping=0.0 * dynamics.twist_damping)

    def table(self, rate: float) -> Tables:
        """The tables of the rods, at the ``rate`` a/h of a step."""
        vertices = self.start.edges + 1
        external = Springs(np.zeros((1, vertices, 3)), np.zeros((1, vertices)))
        still = self.surroundings.at(0)
        obstacles = still.obstacles if self.touching else still.bodies
        material = stiffened(self.material, self.dynamics, rate)
        table = tables(self.start, material, self.first, self.up, self.pairs, external, None, obstacles,
                       self.surroundings.radius, in_motion=True)
        # Damping gives joints a rest shape of their own, which the kernel of isotropic rods does not know.
        undamped = (damping_shares(self.dynamics, material.count, rate) == 0).all(axis=1)
        table = replace(table, isotropic=table.isotropic & undamped)
        return replace(table, contact=table.contact.touching(np.arange(table.count))) if self.touching else table

    def numbers(self, table: Tables, rate: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """(numbers (N, V, -), shares (N, 2), (R,) row of each rod), see :func:`.make_steps`."""
        lengths = table.rest_length
        of_rod = self.loads is not None and self.loads.count != 1 or len(lengths) > 1
        rows = table.count if of_rod else self.material.count
        of_material = table.material_index if of_rod else np.arange(rows)
        if len(lengths) > 1:
            lengths = lengths[table.configuration_index]
        numbers = vertex_numbers("simulate", self.material, self.dynamics, lengths, of_material, rate)
        if self.loads is not None:
            add_loads(numbers, self.loads, rate)
        if self.stepping.quasi_static:
            numbers[..., : LOAD - INERTIA] = 0.0
        index = np.arange(table.count) if of_rod else table.material_index
        return numbers, damping_shares(self.dynamics, self.material.count, rate)[of_material], index

    def slopes(self, table: Tables, rate: float, directions: Sequence[Direction], memory: np.ndarray) -> Slopes | None:
        """How what the kernel is given changes along ``directions``; ``memory`` is how what the rods remember does."""
        if not directions:
            return None
        changes = []
        for direction in directions:
            given = [self._under(table, *other, rate) for other in (direction.before, direction.after)]
            changes.append([(after - before) / direction.distance for before, after in zip(*given, strict=True)])
        return Slopes(*(np.stack(change) for change in zip(*changes, strict=True)), memory)

    def _under(self, table: Tables, material: Material, dynamics: Dynamics, rate: float):
        """Of another material and other dynamics, what the kernel is given: its tables of materials, of numbers, of shares."""
        if material.count != self.material.count or dynamics.count != self.dynamics.count:
            raise InputError("simulate", "directions", f"{material.count} and {dynamics.count} rows",
                             f"give as many as of material, {self.material.count}, and of dynamics, {self.dynamics.count}")
        other = copy(self)
        other.material, other.dynamics = material, self._acting(dynamics)
        numbers, shares, _ = other.numbers(table, rate)
        return under(table, stiffened(material, other.dynamics, rate)).material, numbers[..., :NUMBERS], shares

    def begin(self, start: MovingStart, directions: Sequence[Direction]) -> tuple[Memory, np.ndarray]:
        """The memory of rods that start so, and its derivatives.

        The acceleration is that of one step of backward Euler, not shorter than twice the age of the velocity: where a measured
        velocity contradicts the clamps, it is changed at once, by an acceleration that grows without limit as the step shrinks.
        """
        ahead = min(max(1, round(2.0 * start.velocity_age / self.step)), self.grippers.instants - 1)
        trial_step = ahead * self.step
        rate = 1.0 / trial_step
        table = self.table(rate)
        index = table.configuration_index
        frames = whole_start(table.start, table.clamp)[index]
        x = self.start.vertices[index]
        v, age = start.velocity[index], start.velocity_age
        a = np.zeros_like(v)
        remembered = np.zeros((table.count, len(directions), table.edges + 1, REMEMBERED))
        feasible = table.feasible[index]
        status = np.where(feasible, int(Status.CONVERGED), int(Status.INFEASIBLE)).astype(np.int8)
        if start.smooth and not self.stepping.quasi_static:
            trial = _memory(frames, x, v, a, trial_step, status.copy())
            numbers, shares, rows = self.numbers(table, rate)
            table.external_index[:] = rows
            path = clamp_path(self.grippers, self.start, slice(ahead - 1, ahead))
            slopes = self.slopes(table, rate, directions, remembered)
            time = np.array([trial_step, 1.0, 0.0, 1.0, 0.0])
            poses = None if self.poses is None else np.ascontiguousarray(self.poses[:, [0, ahead]])
            newton = _newton(self.stepping, bool(self.surroundings))
            make_steps(table, trial, Steps(path, time, 1, poses), numbers, shares, newton, 64, slopes)
            moved = trial.places[..., VELOCITY_1 : VELOCITY_1 + 3]
            a = np.where((trial.status == Status.CONVERGED)[:, None, None], (moved - v) / trial_step, 0.0)
            v = v + age * a
            da = remembered[..., VELOCITY_1 : VELOCITY_1 + 3] / trial_step
            da[trial.status != Status.CONVERGED] = 0.0
            remembered = slope_memory(
                lambda change: _memory(frames, x, v + age * change, a + change, self.step, status), da)
        return _memory(frames, x, v, a, self.step, status), remembered

    def account(self, table: Tables, numbers: np.ndarray, rate: float, memory: Memory) -> Account:
        """The account of the rods' energies; ``numbers`` (R, V, -) are those of each rod."""
        length = table.rest_length if len(table.rest_length) == 1 else table.rest_length[table.configuration_index]
        length = np.broadcast_to(length, (table.count, table.edges))
        losses = Losses.of(self.material, self.dynamics, table.material_index, length, numbers, rate, self.up)
        kinds = np.broadcast_to(self.grippers.kinds, (2, self.start.count))
        held = (kinds.T != Clamp.FREE)[table.configuration_index]
        return Account(losses, self.stepping.scheme, self.step, held, memory, bool(self.surroundings))

    def run(self, memory: Memory, progress, directions: Sequence[Direction], remembered: np.ndarray) -> Trajectory:
        """All steps, in launches of bounded size."""
        factor, bits = RATES[self.stepping.scheme], 32 if self.stepping.precision == "f32" else 64
        rate = factor / self.step
        table = self.table(rate)
        slopes = self.slopes(table, rate, directions, remembered)
        numbers, shares, table.external_index[:] = self.numbers(table, rate)
        time = np.array([self.step, factor, (factor - 1.0) / factor, self.stepping.least_way, self.watched])
        frames = (self.grippers.instants - 1) // self.substeps
        numbers_a_frame = 3 * table.count * (table.edges + 1) * (1 if slopes is None else 1 + slopes.count)
        at_once = max(1, min(frames, NUMBERS_AT_ONCE // max(1, numbers_a_frame)))

        def launch(first: int, last: int, every: int):
            path = clamp_path(self.grippers, self.start, slice(first, last))
            newton = _newton(self.stepping, bool(self.surroundings))
            poses = None if self.poses is None else np.ascontiguousarray(self.poses[:, first : last + 1])
            return make_steps(table, memory, Steps(path, time, every, poses), numbers, shares, newton, bits, slopes)

        account = None
        if self.stepping.detailed:
            account = self.account(table, numbers[table.external_index], rate, memory)
            at_once = 1
        if self.touching and (account is not None or at_once < frames):
            table = replace(table, contact=table.contact.for_launches)
        parts = []
        for first in range(0, frames, at_once):
            last = min(frames, first + at_once)
            if account is None:
                parts.append(launch(first * self.substeps, last * self.substeps, self.substeps))
            else:
                parts.append(_step_by_step(launch, first * self.substeps, last * self.substeps, memory, account))
            if progress is not None:
                progress(last)
        positions, outcomes, changes, forces, touches = zip(*parts, strict=True)
        positions, outcome = joined(positions), joined(outcomes)
        lost = np.isnan(positions[..., 0, 0])[..., None]
        status = outcome[..., STATE].astype(np.int8)
        self.relinked = (outcome[..., RELINKED] > 0).any(axis=1) & table.spins_held[table.configuration_index]
        return Trajectory(
            positions, status, outcome[..., TRIPS].astype(np.int32), outcome[..., MOMENT],
            np.where(lost, np.nan, outcome[..., END_FORCE:FRICTION_WORK]), self.stepping.rate, memory,
            np.full(table.count, self.substeps), np.full(table.count, np.nan),
            None if slopes is None else joined(changes), None if account is None else account.detail(status),
            None if forces[0] is None else np.where(lost[..., None], np.nan, joined(forces)), outcome[..., FRICTION_WORK],
            None if touches[0] is None else joined(touches))


def _step_by_step(launch, first: int, last: int, memory: Memory, account: Account):
    """What one launch of the steps from ``first`` to ``last`` returns, of launches of one step, which ``account`` sees."""
    trips = moment = relinked = 0
    for step in range(first, last):
        positions, outcome, changes, forces, touches = launch(step, step + 1, 1)
        account.see(memory, outcome[:, 0, END_FORCE:FRICTION_WORK], 0.0 if forces is None else forces[:, 0], step + 1 == last)
        trips, moment = trips + outcome[..., TRIPS], np.maximum(moment, outcome[..., MOMENT])
        relinked = np.maximum(relinked, outcome[..., RELINKED])
    outcome[..., TRIPS], outcome[..., MOMENT], outcome[..., RELINKED] = trips, moment, relinked
    return positions, outcome, changes, forces, touches


def _newton(stepping: Stepping, in_contact: bool) -> Newton:
    """Of a time step: from where the rod would go by itself, undamped, and never off a saddle, unless nothing but its energy
    decides where it goes. A quasi-static step that takes long is divided instead; one with inertia cannot be."""
    newton = Newton(first_shift=0.0, gap_tolerance=stepping.gap_tolerance)
    if stepping.quasi_static:
        return newton
    return replace(newton, max_iterations=MOST_IN_CONTACT if in_contact else newton.max_iterations, max_escapes=0)


def _memory(frames, x, v, a, h: float, status) -> Memory:
    """The memory of rods at places ``x`` with velocities ``v`` and accelerations ``a``, all (R, V, 3)."""
    places = np.concatenate([x, x - h * v + 0.5 * h**2 * a, v, v - h * a], axis=-1)
    edges = np.diff(places[..., PLACE_2 : PLACE_2 + 3], axis=1)
    tangents = unit_vectors(edges)
    turn = smallest_rotation(tangent_from_quaternion(frames), tangents)
    before = quaternion_product(turn, frames)
    return Memory(frames.copy(), np.ascontiguousarray(before), places, np.zeros((len(x), 3)), np.zeros((len(x), 3)), status)

