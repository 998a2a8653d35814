"""What a simulation returns, and motions that are simulated again: with as many time steps as a rod needs, doubled until two
simulations agree (docs/dynamics.md), and with contact of the rod with itself where it comes near to itself (docs/contact.md).

Every rod is judged by itself, over its whole motion, and moves alone as among others: its steps do not depend on the rods that
are simulated beside it. Axes: R rods, F frames, V vertices, E edges, P parameters.
"""

from collections.abc import Callable
from dataclasses import dataclass, is_dataclass, replace

import numpy as np

from doo_ti.dynamics.parameters import Stepping
from doo_ti.relaxation.self_approach import approach_in_motion
from doo_ti.relaxation.time_steps import Memory
from doo_ti.rod.types import Status
from doo_ti.system.arguments import short_repr


@dataclass(frozen=True)
class Detail:
    """R rods at the start and at F frames; NaN from where a rod failed."""

    quaternions: np.ndarray  # (R, F + 1, E, 4) frames
    velocities: np.ndarray  # (R, F + 1, V, 3) mm/s
    energies: dict[str, np.ndarray]  # (R, F + 1) by name, mm²: see :meth:`doo_ti.dynamics.energies.Account.detail`


@dataclass(frozen=True)
class Trajectory:
    """R rods at F frames. From where a rod failed its positions and forces are NaN, and its work zero.

    positions   (R, F, V, 3) mm
    status      (R, F) Status; a rod that failed keeps its status to the end
    iterations  (R, F) Newton iterations of all steps since the frame before
    residual    (R, F) the largest residual of those steps
    end_force   (R, F, 3) force of the far clamp on the rod, mm (energy in mm² per mm), zero where an end is free, NaN where the
                rod is taut: its tension is not determined
    rate        frames per second
    memory      frames, positions and velocities at the last two instants
    substeps    (R,) time steps from one frame to the next
    error       (R,) mm, estimated error of the time steps, of the vertex and frame where it is largest; NaN where it was not
                estimated, infinite where no finer steps confirm the motion
    slopes      (R, F, P, V, 3) derivatives of positions along the ``directions`` of :func:`.simulate`, or None
    detail      frames, velocities and energies, if asked for, or None
    contact_force  (R, F, V, 3) of obstacles on vertices, friction included, mm (energy per mm): times ``material.newton`` N;
                None without obstacles
    friction_work  (R, F) energy that friction has taken since the start, mm²
    touch       (R, F, V) :class:`.Touch` of each vertex and the edge that ends there, or None without obstacles
    """

    __repr__ = short_repr

    positions: np.ndarray
    status: np.ndarray
    iterations: np.ndarray
    residual: np.ndarray
    end_force: np.ndarray
    rate: float
    memory: Memory
    substeps: np.ndarray
    error: np.ndarray
    slopes: np.ndarray | None = None
    detail: Detail | None = None
    contact_force: np.ndarray | None = None
    friction_work: np.ndarray | None = None
    touch: np.ndarray | None = None

    @property
    def converged(self) -> np.ndarray:
        """(R,) whether all steps of the rod have converged."""
        return self.status[:, -1] == Status.CONVERGED


def joined(parts: list[np.ndarray]) -> np.ndarray:
    """The frames of several launches; a copy only where there are several."""
    return parts[0] if len(parts) == 1 else np.concatenate(parts, axis=1)


MOST_GAIN, LEAST_GAIN = {"bdf2": 2.0, "euler": 1.5}, 1.25
"""Times by which the error is taken to become smaller with half the step, at most and before it can be measured, and at least.
In a smooth motion it is 4 and 2; less where a gripper starts at once or a velocity contradicts it, and in coarse steps."""


def adapted(run: Callable[..., Trajectory], count: int, stepping: Stepping,
            progress: Callable[[int], None] | None) -> Trajectory:
    """The motion of R = ``count`` rods, each with the fewest substeps that reach the tolerance, or with the most.

    run  (stepping, rows (n,), progress): the motion of some rods with fixed steps in one precision

    With d the largest distance of a vertex in any frame between the motions with n/2 and n substeps, and that distance before
    divided by d being the gain g, at most MOST_GAIN, the error of n substeps is estimated as d/(g − 1), of a geometric series.
    """
    steps, rows = stepping.substeps, np.arange(count)
    coarse = _moved(run, stepping, steps, rows, progress)
    found, error = coarse, np.full(count, np.nan if stepping.tolerance is None else np.inf)
    before = np.full(count, np.nan)
    while stepping.tolerance is not None and len(rows) and 2 * steps <= stepping.most_substeps:
        steps *= 2
        fine = _moved(run, stepping, steps, rows)
        apart = _apart(coarse, fine)
        most = MOST_GAIN[stepping.scheme]  # and as assumed where the gain was not measured before
        known = np.isfinite(before) & np.isfinite(apart)
        gain = np.where(known, before, most) / np.where(known, np.maximum(apart, 1e-300), 1.0)
        estimate = apart / (np.clip(gain, LEAST_GAIN, most) - 1.0)
        # A motion that fails only with finer steps is kept as it was.
        better = fine.converged | ~found.converged[rows]
        put(found, rows[better], fine, better)
        error[rows[better]] = estimate[better]
        left = ~(estimate <= stepping.tolerance)
        rows, before = rows[left], apart[left]
        coarse = replace(fine, positions=fine.positions[left], status=fine.status[left])  # enough for comparison
    found = replace(found, error=error)
    return replace(found, detail=_detail(run, _fixed(stepping, steps), found)) if stepping.detailed else found


def _fixed(stepping: Stepping, steps: int, precision: str = "f64") -> Stepping:
    """So many steps, in the precision that ``stepping`` states, or where that is mixed in the one given."""
    precision = precision if stepping.precision == "mixed" else stepping.precision
    return replace(stepping, substeps=steps, precision=precision, tolerance=None, detailed=False)


def _moved(run: Callable[..., Trajectory], stepping: Stepping, steps: int, rows: np.ndarray, progress=None) -> Trajectory:
    """The rods ``rows`` with so many substeps. In mixed precision the first substeps and twice as many are f32, whose rounding
    grows with finer steps, and what it stops is repeated in f64."""
    coarse = "f32" if steps <= 2 * stepping.substeps else "f64"
    found = run(_fixed(stepping, steps, coarse), rows, progress)
    again = np.flatnonzero(~found.converged)
    if stepping.precision == "mixed" and coarse == "f32" and len(again):
        put(found, again, run(_fixed(stepping, steps), rows[again]), slice(None))
    return found


def _apart(coarse: Trajectory, fine: Trajectory) -> np.ndarray:
    """(n,) mm, infinite where one of the two failed."""
    both = coarse.converged & fine.converged
    square = ((coarse.positions - fine.positions) ** 2).sum(axis=-1).max(axis=(1, 2))
    return np.where(both, np.sqrt(square), np.inf)


def put(into, rows: np.ndarray, other, of: np.ndarray | slice) -> None:
    """Write the rods ``of`` of another trajectory, or of a part of it, into those ``rows``, as far as both have them."""
    parts = (vars(value) if is_dataclass(value) else value for value in (into, other))
    for mine, its in zip(*(dict(part).values() for part in parts), strict=True):
        if isinstance(mine, np.ndarray) and its is not None:
            mine[rows] = its[of]
        elif isinstance(mine, dict) or is_dataclass(mine) and its is not None:
            put(mine, rows, its, of)


def _detail(run: Callable[..., Trajectory], fixed: Stepping, found: Trajectory) -> Detail:
    """The detail of rods whose steps have been chosen: simulated once more, where precision is mixed in f64."""
    parts, order = [], []
    for steps in np.unique(found.substeps):
        rows = np.flatnonzero(found.substeps == steps)
        parts.append(run(replace(fixed, substeps=int(steps), detailed=True), rows).detail)
        order.append(rows)
    back = np.argsort(np.concatenate(order))
    energies = {name: np.concatenate([part.energies[name] for part in parts])[back] for name in parts[0].energies}
    return Detail(*(np.concatenate([getattr(part, name) for part in parts])[back] for name in ("quaternions", "velocities")),
                  energies)


def kept_apart(moved: Callable[..., Trajectory], stepping: Stepping, rows: np.ndarray, start: np.ndarray, radius: np.ndarray,
               progress: Callable[[int], None] | None) -> Trajectory:
    """The motion of the rods ``rows``, which are their own obstacles: of all of them as if they were not, and of those that
    may have touched themselves from one frame to the next, or passed through themselves, once more, in f64.

    moved   (stepping, rows, progress, touching): a motion without or with contact of the rods with themselves, and which rods
            have passed through themselves, as the link of their frames says
    start   (R, V, 3) mm, their places at first
    radius  (1 or R,) mm
    """
    radius = np.asarray(radius, dtype=np.float64).reshape(-1)
    found, near = moved(stepping, rows, progress)
    lengths = np.linalg.norm(np.diff(start, axis=1), axis=-1)
    places = np.concatenate([start[:, None], found.positions], axis=1)
    own = np.arange(len(rows))
    near = near | approach_in_motion(places[:, 0], places[:, 0], own, lengths, radius)
    for frame in range(found.positions.shape[1]):
        near |= approach_in_motion(places[:, frame], places[:, frame + 1], own, lengths, radius)
    if found.contact_force is None:
        found = replace(found, contact_force=0.0 * found.positions,  # NaN where these are
                        touch=np.zeros(found.positions.shape[:3], dtype=np.int8))
    again = np.flatnonzero(near)
    if len(again):
        put(found, again, moved(replace(stepping, precision="f64"), rows[again], None, True)[0], slice(None))
    return found
