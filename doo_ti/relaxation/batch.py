"""Launches of the kernels: from the tables of rods to their results.

Scratch memory is allocated once per thread and reused, independent of the number of rods.
"""

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from types import SimpleNamespace

import numpy as np

from doo_ti.physics.number import Number
from doo_ti.relaxation import descent, newton
from doo_ti.relaxation import tables as of
from doo_ti.relaxation.external import Nothing
from doo_ti.relaxation.loading import LANES, TRIPS
from doo_ti.relaxation.newton_policy import CLOSING_DISTANCE
from doo_ti.relaxation.tables import Tables, room
from doo_ti.rod.frames import vertices_from_quaternions
from doo_ti.rod.types import Solution, Status
from doo_ti.system import runtime

PROJECTIONS = 100  # rounds in which Descent's starts are brought onto closure
BLOCK, MOST_THREADS = 64, 1 << 16  # on a GPU, threads in a block, and threads of a launch
WIDER = 4
"""On a GPU, the factor from one stride to the next. A kernel is compiled for one stride: if that were the number of rods, each
launch with another number of rods would compile its kernel again, for seconds."""

UNTOUCHED = np.full(of.RESULTS, np.nan)  # the results of an infeasible rod, which no kernel relaxes
UNTOUCHED[[of.ITERATIONS, of.STATUS]] = 0.0, Status.INFEASIBLE

_last: dict[int, tuple[Number, np.ndarray]] = {}  # by bits: the numbers and the queue of the last launch


def run_newton(table: Tables, options: newton.Newton, bits: int, begin: Solution | None = None, moving: bool = True):
    """Relax every feasible rod from its start, or from where it ended in ``begin``: (R, E, 4) frames and (R, RESULTS), NaN and
    UNTOUCHED in infeasible rows.

    With ``moving`` false only the projection runs, which brings a start onto closure.
    """
    frames = room(table.count, table.edges, 4)
    results = room(table.count, of.LOADED_RESULTS if table.loaded else of.RESULTS)
    if len(table.rods) < table.count:
        infeasible = ~table.feasible[table.configuration_index]
        frames[infeasible], results[infeasible, : of.RESULTS] = np.nan, UNTOUCHED
    if begin is None:
        results[:, of.DRIFT:] = 0.0
        _launch_newton(table, table.rods, options, bits, frames, results, moving)
    else:
        frames[...] = begin.configuration.quaternions
        if table.loaded:
            moved = begin.configuration.start - table.anchor[table.configuration_index]
            results[:, of.DRIFT:] = np.where(table.clamp[table.configuration_index, of.LOOSE, None] > 0, moved, 0.0)
        continue_newton(table, options, bits, frames, results, np.arange(table.count), begin.status == int(Status.CONVERGED))
    return frames, results


def continue_newton(table: Tables, options: newton.Newton, bits: int, frames, results, rows, usable) -> None:
    """Relax the rods ``rows`` further, in place: from their ``frames`` where ``usable`` (R,), else from their starts."""
    again = rows[~usable[rows]]
    results[again, of.DRIFT:] = 0.0
    if table.contact is not None:
        table.contact.forget(again)
    _launch_newton(table, table.continued(usable, rows), options, bits, frames, results)


def pack_trips(bits: int) -> tuple[int, int]:
    """(trips through Newton's loop, all threads together, and rods in a pack) of the last launch in that precision."""
    number, queue = _last[bits]
    return int(queue[TRIPS]), number.width


@runtime.exclusive
def _launch_newton(table: Tables, rods, options: newton.Newton, bits: int, frames, results, moving: bool = True) -> None:
    """Launches over ``rods``, from the starts of the table or from ``frames``. Rods out of reach of all obstacles are relaxed
    without them."""
    near, policy = np.ones(len(rods), dtype=bool), policy_row(table.up, options, bits, moving)
    if table.contact is not None and not table.contact.itself:
        near = table.contact.near[rods[:, of.RESULT_ROW]]
    for reaching, some in of.parted(rods, near):
        own = table if reaching else replace(table, contact=None)
        for isotropic, any_ends, part in own.by_kernel(some):
            _launch_kernel(own, isotropic, any_ends, part, policy, options, bits, frames, results)


def _launch_kernel(table: Tables, isotropic: bool, any_ends: bool, rods, policy: np.ndarray, options: newton.Newton,
                   bits: int, frames, results) -> None:
    """:func:`_launch_newton` over rods of one kernel."""
    contact, more = table.contact, {}
    external = Nothing() if table.external is None and any_ends else table.external
    if external is not None:
        more = {"numbers": external.numbers(), "field": external.field()}
    if contact is not None:
        more |= contact.arguments(contact.forces, options.gap_tolerance)
    kernel = partial(newton.newton_kernel, isotropic=isotropic, external=None if external is None else type(external),
                     any_ends=any_ends, contact=None if contact is None else (contact.has_grid, contact.itself))
    launch(layout_for(len(rods), bits, contact is not None and contact.itself), kernel, start=table.start.reshape(-1),
           rest_length=table.rest_length, clamp=table.clamp, material=table.material, rods=rods, policy=policy,
           frames=frames.reshape(-1), results=results, **more)


def policy_row(up: np.ndarray, options: newton.Newton, bits: int, moving: bool = True) -> np.ndarray:
    """(POLICY_COLUMNS,) what a launch is given besides its tables."""
    return np.array([
        *up, options.tolerance or newton.TOLERANCES[bits], options.max_iterations, options.first_shift,
        options.max_rotation, options.max_escapes, CLOSING_DISTANCE if moving else -1.0])


@runtime.exclusive
def run_descent(table: Tables, options: descent.Descent, bits: int):
    """Relax every feasible rod by the paper's scheme, from its start projected onto closure; as :func:`run_newton`.

    The residual, the status and the certificate are those of the chain of frames, so that they mean the same for both
    solvers: a rod has converged if its moments say so there.
    """
    projection = newton.Newton(max_iterations=PROJECTIONS)
    closed, _ = run_newton(table, projection, 64, moving=False)
    start, outer = closed / np.linalg.norm(closed, axis=-1, keepdims=True), of.outer_edges(table.edges)
    start[:, outer] = closed[:, outer]  # as clamps have them
    lengths, index = table.rest_length, table.configuration_index
    vertices = vertices_from_quaternions(np.zeros((len(start), 3)), start, lengths if len(lengths) == 1 else lengths[index])
    vertices = np.where(table.released[index, None, None], vertices - vertices[:, -1:], vertices)
    frames = np.full((table.count, table.edges, 4), np.nan)
    results = np.tile(UNTOUCHED, (table.count, 1))
    launch(layout_for(len(table.rods), bits), descent.descent_kernel, vertices=np.ascontiguousarray(vertices),
           start=start, rest_length=lengths, clamp=table.clamp, material=table.material,
           up=np.array(table.up, dtype=np.float64), rods=table.rods, tolerance=options.tolerance,
           max_iterations=options.max_iterations, largest_move=options.largest_move, frames=frames, results=results)
    certificate = newton.Newton(tolerance=options.tolerance, max_iterations=1, first_shift=0.0, max_escapes=0)
    certified = np.tile(UNTOUCHED, (table.count, 1))
    finite = np.isfinite(frames[:, 0, 0])
    continue_newton(table, certificate, 64, frames, certified, np.arange(table.count), finite)
    frames[~finite], certified[~finite] = np.nan, UNTOUCHED  # not what the certificate has made of the start
    good = certified[:, of.STATUS] == Status.CONVERGED
    # A rod that converged by the criterion of descent but not by Newton's (its clamp is not reached, say) has stalled.
    own = np.where(results[:, of.STATUS] == Status.CONVERGED, Status.STALLED, results[:, of.STATUS])
    certified[:, of.STATUS] = np.where(good, Status.CONVERGED, own)
    certified[:, of.ITERATIONS] = results[:, of.ITERATIONS]
    return frames, certified


def layout_for(rods: int, bits: int, alone: bool = False, width: int | None = None, most: int = MOST_THREADS
               ) -> tuple[Number, int, int, int]:
    """(kind of number, threads, stride, block) that suit the architecture Taichi runs on; ``alone``: rods that take long enough
    for a few of them to be worth a thread each; ``width``: of packs on a CPU, where they are not to be the widest; ``most``:
    threads on a GPU."""
    if runtime.start() == "cpu":
        widest = 1 if alone and rods <= 2 * runtime.thread_count() else 16 if bits == 32 else 8
        number = Number(width or widest, bits)
        return number, max(1, min(runtime.thread_count(), -(-rods // number.width))), 1, 1
    return layout_of_gpu(rods, bits, most)


def layout_of_gpu(rods: int, bits: int, most: int) -> tuple[Number, int, int, int]:
    """:func:`layout_for` on a GPU: a thread for each rod, at most ``most``."""
    threads, stride = min(max(rods, 1), most), BLOCK
    while stride < threads:
        stride *= WIDER
    return Number(1, bits), threads, stride, BLOCK


def launch(layout: tuple[Number, int, int, int], factory: Callable, **given) -> None:
    """Run a kernel in that ``layout`` (:func:`layout_for`), on as many of its threads as have numbers that 32 bits can count.

    factory  makes it of (number, stride, block); the ``items`` of its loop are the numbers of scratch that a thread needs
    given    its arguments but for the threads, scratch for all of them, and the queue
    """
    number, threads, stride, block = layout
    kernel = factory(number, stride, block)
    size = kernel.loop.items(SimpleNamespace(**given))
    most = max(1, of.MOST_NUMBERS // size)
    threads = min(threads, most)
    if stride > most:
        stride = most
        kernel = factory(number, stride, block)
    # Places of the lanes' rods; motions also have their steps. (A NumPy array: filling a Taichi array takes a launch.)
    queue = np.zeros(LANES + 2 * threads * number.width, dtype=np.int32)
    _last[number.bits] = number, queue
    scratch = runtime.array_for(number, max(threads, stride) * size, number.type)
    kernel(threads=threads, scratch=scratch, queue=queue, **given)
