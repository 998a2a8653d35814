"""The same Newton in plain JAX, for comparison with the package's kernel.

Same rods, formulas, policy and precision (docs/chain.md; but it does not leave saddles, and has λ + δλ for λ), one program
that XLA compiles as a whole. For a fair comparison the obvious ways to write it were tried; this is the fastest of them, up
to the noise of the measurement. On two cores of an AMD EPYC shared with other processes, f32, 33 edges:

4096 rods, thousands a second           51 best, 33 median; in f64 24 and 20
  in step until the last rod is done    11 best, 8 median
  refilled, 1024 rods under way         54 best, 35 median; in f64 24 and 18
a trip, µs of wall clock (of processor) a rod, 1024 rods in the trailing axis, each number an array: 2.7 (4.8)
  vmap over rods, leading axis          3.6 (6.1); trailing axis 5.9 (9.7)
  arctan2 for the polynomial            3.6 (5.8)
  no barrier behind the frames          an eighth more processor time
  scan unrolled by 2                    15 (27), against 3.2 (5.9) in that run
derivatives of the pairs                0.7 (1.2); by autodiff see tools/bench/pair_in_jax.py
elimination and step                    1.5 (1.6)
  by jnp.linalg.solve on whole rods     64 (67), and that counts no inertia
  scan, elimination only                1.9; with blocks as (3, 7, W) arrays 7, with jnp.linalg.solve on blocks 13
all of it the plain way, rods a second  f32 125, f64 93: jax.hessian of the whole Lagrangian, jnp.linalg.solve, the inertia by
                                        Cholesky on closure's null space (XLA's scheduler at times hangs on two cores)

The kernel takes the least-squares λ at every accepted point. Here that made a trip no faster and rods need 6.02 trips for 5.89
(f64: 6.83 for 6.61), so λ + δλ is kept.
"""

from dataclasses import dataclass
from functools import partial
from statistics import median
from typing import NamedTuple

import numpy as np

from doo_ti.bench.clock import timed
from doo_ti.bench.workload import UP, Rods
from doo_ti.errors import InputError
from doo_ti.frames import quaternion_from_matrix
from doo_ti.relaxation.newton import Newton
from doo_ti.relaxation.newton_policy import (
    CLOSING_DISTANCE,
    DECAY,
    DECAY_TROUBLED,
    NEGLIGIBLE,
    NEGLIGIBLE_TROUBLED,
    SHIFT_REJECTED,
    SHIFT_WRONG_INERTIA,
)

try:
    import jax
except ImportError:  # rate and relaxed say so
    jax = None
else:
    import jax.numpy as jnp
    from jax import lax

    from tools.bench import chain_in_jax as chain
    from tools.bench.pair_in_jax import DERIVATIVES

BATCH = 4096
SHRINK = (1024, 256, 64)
"""Sizes to which a batch is reduced: once no more rods than that are unfinished, they continue in a smaller batch."""

POLICY = Newton()


@dataclass(frozen=True)
class JaxRate:
    """rods_per_second counts rods that converged; converged is their share, iterations the mean over all rods."""

    rods_per_second: float
    converged: float
    iterations: float
    compile_seconds: float


class State(NamedTuple):
    """Where W rods are: frames four of (E, W), all else (W,) or three of it; and the step ω each is about to try, three of
    (E−2, W), of which it takes the share ``cap``, δλ being ``change``.

    residual max|g + Aλ|, scale the largest diagonal entry of H; trying: the step is judged; closing: it only projects;
    fresh: nothing was evaluated yet; troubled: a step was refused or the inertia wrong.
    """

    frames: tuple
    step: tuple
    energy: np.ndarray
    miss: tuple
    multiplier: tuple
    change: tuple
    shift: np.ndarray
    scale: np.ndarray
    cap: np.ndarray
    residual: np.ndarray
    trying: np.ndarray
    closing: np.ndarray
    fresh: np.ndarray
    troubled: np.ndarray
    trips: np.ndarray
    done: np.ndarray
    converged: np.ndarray


def rate(rods: Rods, bits: int, rounds: int = 3, derivatives: str = "explicit") -> JaxRate:
    """How fast ``rods`` relax in batches of BATCH, compiled before the clock starts: the median of ``rounds``.

    bits is 32 (scaled residual 1e-6) or 64 (1e-9); derivatives selects those of the pairs, "explicit" or
    "automatic". Timed is from NumPy in to NumPy out, without arranging the rods in batches. Raises InputError where jax is
    absent.
    """
    with floats_of(bits):
        batches = batches_of(rods, bits)
        seconds, program = timed(lambda: compiled(batches[0], bits, derivatives))
        runs = [timed(lambda: run(program, batches, rods.count)) for _ in range(rounds)]
    _, _, converged, iterations = runs[0][1]
    per_second = float(converged.sum() / median(run[0] for run in runs))
    return JaxRate(per_second, float(converged.mean()), float(iterations.mean()), seconds)


def relaxed(
        rods: Rods, bits: int, derivatives: str = "explicit") -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """What :func:`rate` times: frames (R, E, 4), energy (R,) as in ``Solution``, converged (R,) bool, iterations (R,).

    A rod that ends on a saddle or at the limit of iterations has not converged. Raises InputError where jax is absent.
    """
    with floats_of(bits):
        batches = batches_of(rods, bits)
        frames, energy, converged, iterations = run(compiled(batches[0], bits, derivatives), batches, rods.count)
    total = np.broadcast_to(rods.starts.rest_length.sum(axis=-1), rods.starts.count)
    height = rods.clamps.start_position @ UP * 2 * total
    energy = energy * rods.material.bend[rods.of_material, 0, 0, 0]
    return frames, energy + rods.material.weight[rods.of_material] * height[rods.of_start], converged, iterations


def floats_of(bits: int):
    """The context in which numbers have that many bits."""
    if jax is None:
        raise InputError("study.py", "--jax", "jax is not installed", "pip install jax")
    if hasattr(jax, "enable_x64"):
        return jax.enable_x64(bits == 64)
    from jax.experimental import enable_x64  # before 0.8

    return enable_x64(bits == 64)


def batches_of(rods: Rods, bits: int) -> list[tuple[np.ndarray, "chain.Task"]]:
    """(frames (W, E, 4), task) of each batch; the last one is filled up with rods from the front."""
    size = min(BATCH, rods.count)
    rows = np.resize(np.arange(rods.count), (-(-rods.count // size), size))
    return [_batch(rods.take(of), np.float32 if bits == 32 else np.float64) for of in rows]


def _batch(rods: Rods, real: type) -> tuple[np.ndarray, "chain.Task"]:
    starts, clamps, material = rods.starts.take(rods.of_start), rods.clamps.take(rods.of_start), rods.material
    frames = starts.quaternions.astype(real)
    frames[:, 0], frames[:, -1] = (quaternion_from_matrix(held) for held in (clamps.start_frame, clamps.end_frame))
    length = np.atleast_2d(starts.rest_length).T
    total = length.sum(axis=0)
    bend = material.bend[rods.of_material, 0, 0, 0]
    weight = material.weight[rods.of_material] / bend
    task = chain.Task(
        length, length + 2 * (total - np.cumsum(length, axis=0)), 1 / (length[1:] + length[:-1]), total, length.max(axis=0),
        material.twist[rods.of_material, 0] / bend, tuple(weight * up for up in UP),
        tuple((clamps.end_position - clamps.start_position).T),
    )
    return frames, jax.tree.map(lambda array: array.astype(real), task)


def compiled(batch: tuple[np.ndarray, "chain.Task"], bits: int, derivatives: str = "explicit"):
    return jax.jit(partial(_relaxation, bits, DERIVATIVES[derivatives])).lower(*batch).compile()


def run(program, batches: list, count: int) -> tuple[np.ndarray, ...]:
    results = [program(*batch) for batch in batches]
    return tuple(np.concatenate([np.asarray(array) for array in column])[:count] for column in zip(*results, strict=True))


def _relaxation(bits: int, pairs, frames, task: "chain.Task"):
    """One batch: frames (W, E, 4), energy over α (W,), converged (W,), iterations (W,)."""
    count = len(frames)
    rows = jnp.arange(count)
    state = _begun(tuple(jnp.transpose(frames, (2, 1, 0))))
    found = _results(state)
    for fewer in (*(size for size in SHRINK if size < count), 0):
        state = lax.while_loop(lambda now: jnp.sum(~now.done) > fewer, partial(_trip, bits, pairs, task), state)
        found = jax.tree.map(lambda of_all, here: of_all.at[..., rows].set(here), found, _results(state))
        left = jnp.argsort(state.done)[:fewer]
        rows, task, state = jax.tree.map(
            lambda array: array[..., left] if array.shape[-1] > 1 else array, (rows, task, state))
    return jnp.transpose(jnp.stack(found[0]), (2, 1, 0)), *found[1:]


def _results(state: State):
    return state.frames, state.energy, state.converged, state.trips


def _begun(frames: tuple) -> State:
    edges, count = frames[0].shape
    zero, no = jnp.zeros_like(frames[0][0]), jnp.zeros(count, bool)
    none = (zero,) * 3
    step = (jnp.zeros_like(frames[0][1:-1]),) * 3
    return State(frames, step, zero, none, none, none, zero, zero, zero, zero, no, no, ~no, no,
                 jnp.zeros(count, jnp.int32), no, no)


def _trip(bits: int, pairs, task: "chain.Task", state: State) -> State:
    """Try the step, evaluate where it leads, eliminate there, and judge; ``pairs`` is one of DERIVATIVES."""
    moving = state.trying | state.fresh | state.closing
    stepped = chain.stepped(state.frames, state.step, state.cap)
    # Without the barriers XLA computes frames and pairs again at each of their many uses.
    frames = lax.optimization_barrier(chain.closed(bits, task, stepped, moving))
    tried = tuple(a + jnp.where(state.trying, b, 0) for a, b in zip(state.multiplier, state.change, strict=True))
    elastic, *of_pairs = lax.optimization_barrier(pairs(bits, task, frames))
    energy, magnitude, miss = chain.energy(task, frames, elastic)
    gradient, diagonal, across, closure = chain.derivatives(task, frames, of_pairs, tried)
    scale = jnp.max(chain.largest(diagonal[0], diagonal[3], diagonal[5]), 0)
    residual = jnp.max(chain.largest(*map(jnp.abs, gradient)), 0)
    shift = _shift_after(state, scale)
    added = jnp.where(shift > 0, shift, 0.0 if bits == 32 else 1e-12 * scale)  # neutral motions pass, as in the kernel
    change, right, step = chain.solved(gradient, chain.on_diagonal(diagonal, added), across, closure, miss)
    noise = (2e-6 if bits == 32 else 1e-10) * magnitude
    downhill = energy + chain.dot(tried, miss) <= state.energy + chain.dot(tried, state.miss) + noise
    taken = jnp.where(state.trying, downhill, jnp.isfinite(energy)) & ~state.done
    there = {"frames": frames, "energy": energy, "miss": miss, "multiplier": tried, "shift": shift, "scale": scale,
             "residual": residual}
    kept = {name: jax.tree.map(partial(jnp.where, taken), new, getattr(state, name)) for name, new in there.items()}
    return _judged(bits, task, state._replace(step=step, change=change, **kept), taken, right)


def _shift_after(state: State, scale):
    """The shift once the step that is tried is taken."""
    smaller = jnp.where(state.troubled, DECAY_TROUBLED, DECAY) * state.shift
    negligible = jnp.where(state.troubled, NEGLIGIBLE_TROUBLED, NEGLIGIBLE) * state.scale
    eased = jnp.where(state.trying, jnp.where(smaller > negligible, smaller, 0), state.shift)
    return jnp.where(state.fresh, POLICY.first_shift * scale, eased)


def _judged(bits: int, task: "chain.Task", state: State, taken, right) -> State:
    """The next step of rods whose trial was ``taken`` or not, the inertia there being ``right`` or not."""
    uphill = state.trying & ~taken
    shift = jnp.where(uphill, jnp.maximum(4 * state.shift, SHIFT_REJECTED * state.scale), state.shift)
    gap = jnp.sqrt(chain.dot(state.miss, state.miss))
    tolerance, closure = (1e-6, 1e-7) if bits == 32 else (1e-9, 1e-12)
    small = taken & (state.residual <= tolerance) & (gap <= closure * task.total)
    bare = shift <= 0
    closing = gap > CLOSING_DISTANCE * task.edge
    wrong = taken & ~right
    raised = wrong & ~closing
    shift = jnp.where(raised, jnp.maximum(4 * shift, SHIFT_WRONG_INERTIA * state.scale), shift)
    certify = small & ~bare
    trying = ~(certify | wrong | closing | uphill)
    longest = jnp.sqrt(jnp.max(chain.dot(state.step, state.step), 0))
    trips = state.trips + ~state.done
    lost = (state.fresh & ~taken) | ~jnp.isfinite(state.residual)
    return state._replace(
        shift=jnp.where(certify, 0, shift),
        cap=jnp.where(trying, jnp.minimum(1, POLICY.max_rotation / (longest + 1e-30)), 0),
        trying=trying,
        closing=closing,
        fresh=jnp.zeros_like(trying),
        troubled=state.troubled | uphill | raised,
        trips=trips,
        done=state.done | (small & bare) | (trips >= POLICY.max_iterations) | lost,
        converged=state.converged | (small & bare & right),
    )
