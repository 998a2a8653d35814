"""Which configurations to measure: how strongly each informs α, β and μ, and in which order they narrow Θ down most.

At an equilibrium the sensitivity J = ∂x*/∂log Θ says how far the marks move when a parameter grows by a factor e. Θ is not
known before the experiment, so J is taken in every cell of a grid, the prior: a rod that is near its snap in one cell must
not speak for all.

Axes: G grid cells, D configurations, P parameters, K picks.
"""

from dataclasses import dataclass, replace

import numpy as np

from doo_ti.dataset import Observations
from doo_ti.errors import InputError
from doo_ti.grid import Grid
from doo_ti.progress import progress
from doo_ti.refinement.sensitivity import sensitivity
from doo_ti.relaxation.newton import Newton
from doo_ti.relaxation.relax import relax
from doo_ti.scene import Synthesis
from doo_ti.start import check_experiment, observation_clamps, start_configuration, turn_hypotheses
from doo_ti.synthesis import synthesise
from doo_ti.types import Clamp

CHUNK_RODS = 4096
MOST_RODS = 1_000_000


@dataclass(frozen=True)
class Plan:
    """What each configuration would tell.

    parameters   names of Θ's parameters: bend, or bend_1 and bend_2, then twist and weight
    strength     (D, P) mm by which a mark moves, root mean square over the rod, when the parameter grows by a factor e:
                 the median over the grid. NaN where no cell gives an equilibrium
    total        (D,) mm, the same over all parameters that the grid varies, together: root of the sum of squares
    order        (K,) rows of the configurations, the one to measure first at the front
    volume       (K,) what is left of the prior's confidence region, by its volume (geometric mean over the grid), after
                 measuring so many of them
    sensed       (D,) cells in which the rod comes to a certified equilibrium; the other cells say nothing
    cells        G
    information  (G, D, Q, Q) of one measurement about the logarithms of the Q parameters in ``asked``; zero where not sensed
    asked        indices of the parameters that the grid varies
    """

    parameters: tuple[str, ...]
    strength: np.ndarray
    total: np.ndarray
    order: np.ndarray
    volume: np.ndarray
    sensed: np.ndarray
    cells: int
    information: np.ndarray
    asked: tuple[int, ...]

    @property
    def least(self) -> int:
        """The configuration that tells least; one that comes to no equilibrium anywhere tells nothing."""
        return int(np.argmin(np.nan_to_num(self.total)))


def planned(synthesis: Synthesis) -> Observations:
    """The configurations that an experiment would go through: every end distance with every end rotation of the recipe.

    They are of the model that is fitted, straight at rest and without label noise, under the recipe's Θ: a guess, which
    decides the branch that each rod is on and nothing else. Raises InterruptedRunError where the rod cannot be carried there.
    """
    spacing = synthesis.length_mm / (synthesis.marks - 1)
    return synthesise(replace(
        synthesis, fine_edge_mm=spacing, clip_mm=spacing, rest_curvature_rms_per_mm=0.0, label_noise_mm=0.0,
        clip_tilt_deg=0.0, clip_offset_mm=0.0, clip_scatter_deg=0.0))


def plan(
    configurations: Observations, grid: Grid, *, sigma: float, picks: int = 10, clamp_start: Clamp | None = None,
    clamp_end: Clamp | None = None, measured=(),
) -> Plan:
    """Rank ``configurations``, observed or planned, by what measuring them would tell about Θ.

    configurations  clamps and shapes to start from, as for a sweep
    grid            the prior: Θ is in one of its cells, each as likely as the others
    sigma           label uncertainty, mm
    picks           K, configurations to rank, none twice
    measured        rows that are measured already: they count, and are not picked

    The order is greedy in the mean over the grid of log det of the information about the logarithms of the parameters that
    the grid varies, on top of a prior as wide as the grid (Bayesian D-optimality). Raises InputError for wrong input.
    """
    clamps = observation_clamps(configurations, clamp_start, clamp_end)
    check_experiment(configurations, clamps, grid.axes[-1].values[-1], 0.0)
    if not (np.isfinite(sigma) and sigma > 0):
        raise InputError("plan", "sigma", f"{sigma}", "give a positive label uncertainty in mm")
    if configurations.count * grid.size > MOST_RODS:
        raise InputError(grid.source, "grid", f"{grid.size:,} cells for {configurations.count} configurations",
                         f"give at most {MOST_RODS // configurations.count:,} cells: a plan needs no fine grid")
    parameters = ("bend", "twist", "weight") if grid.is_isotropic else ("bend_1", "bend_2", "twist", "weight")
    asked = _asked(grid, parameters)
    moved = _moved(configurations, clamps, grid, parameters)
    marks = configurations.valid.sum(axis=1)[:, None]
    squares = np.einsum("gdpp->gdp", moved) / marks
    with np.errstate(invalid="ignore"):
        strength = np.sqrt(_median(squares))
        total = np.sqrt(_median(squares[..., asked].sum(axis=-1)))
    sensed = np.isfinite(moved).all(axis=(2, 3))
    information = np.nan_to_num(moved[:, :, asked][..., asked]) / sigma**2
    order, volume = _greedy(information, _prior(grid, [parameters[k] for k in asked]), list(measured), picks)
    return Plan(parameters, strength, total, order, volume, sensed.sum(axis=0), grid.size, information, asked)


def _asked(grid: Grid, parameters: tuple[str, ...]) -> tuple[int, ...]:
    """The parameters that vary over the grid. Raises InputError where none does, or all do: they share a scale."""
    values = grid.cell_values() | ({"bend": grid.cell_values()["bend_1"]} if grid.is_isotropic else {})
    asked = tuple(k for k, name in enumerate(parameters) if np.ptp(values[name]) > 0)
    if not asked:
        raise InputError(grid.source, "grid", "a single cell, so nothing is unknown", "give at least one range LO:HI:N")
    if len(asked) == len(parameters):
        raise InputError(grid.source, "weight", "varied beside all others", "only ratios matter: keep one parameter fixed")
    logs = np.log(_values(grid, slice(None), [parameters[k] for k in asked]))
    if np.linalg.matrix_rank(logs - logs.mean(axis=0), tol=1e-9) < len(asked):
        raise InputError(grid.source, "twist", "rides on bend, so that no observation tells them apart",
                         "give --twist a number, or --twist-ratio a range")
    return asked


def _moved(configurations: Observations, clamps, grid: Grid, parameters) -> np.ndarray:
    """(G, D, P, P) Jᵀ J over the valid marks, mm², NaN where a rod comes to no certified equilibrium."""
    index, turns = turn_hypotheses(configurations, clamps)
    if len(index) > configurations.count:
        # Nobody knows the turns of a rod that is not measured yet: the half turn nearest to none.
        turns = np.zeros(configurations.count, dtype=np.int64)
    starts = start_configuration(configurations, clamps, turns)
    count = configurations.count
    step = max(1, CHUNK_RODS // count)
    moved = np.empty((grid.size, count, len(parameters), len(parameters)))
    with progress() as bar:
        task = bar.add_task("sensitivities", total=grid.size, unit="cells")
        for first in range(0, grid.size, step):
            last = min(first + step, grid.size)
            cell, row = np.divmod(np.arange((last - first) * count), count)
            solution = relax(starts, grid.materials(slice(first, last)), clamps, Newton(), up=configurations.up,
                             configuration_index=row, material_index=cell)
            found = sensitivity(solution, parameters)
            values = _values(grid, slice(first, last), parameters)[cell]
            scaled = found.vertices * values[:, None, None] * configurations.valid[row][:, :, None, None]
            scaled[~found.usable] = np.nan
            moved[first:last] = np.einsum("rvip,rviq->rpq", scaled, scaled).reshape(last - first, count, *moved.shape[2:])
            bar.advance(task, last - first)
    return moved


def _values(grid: Grid, cells: slice, parameters) -> np.ndarray:
    """(G, P) the parameters' values in ``cells``."""
    values = grid.cell_values(cells)
    return np.stack([values["bend_1" if name == "bend" else name] for name in parameters], axis=-1)


def _median(values: np.ndarray) -> np.ndarray:
    """Over the grid, of the cells that are not NaN; NaN where all are."""
    found = np.full(values.shape[1:], np.nan)
    some = np.isfinite(values).any(axis=0)
    found[some] = np.nanmedian(values[:, some], axis=0)
    return found


def _prior(grid: Grid, names: list[str]) -> np.ndarray:
    """(Q, Q) information of a uniform prior over the grid about the logarithms: one over their covariance."""
    logs = np.log(_values(grid, slice(None), names))
    return np.linalg.inv(np.atleast_2d(np.cov(logs.T)))


def _greedy(information: np.ndarray, prior: np.ndarray, measured: list[int], picks: int):
    """(K,) rows in the order of a greedy search, and (K,) the volume of the region left, relative to the start's."""
    known = prior + information[:, measured].sum(axis=1)
    begun = np.linalg.slogdet(known)[1].mean()
    left = [row for row in range(information.shape[1]) if row not in set(measured)]
    order, volume = [], []
    for _ in range(min(picks, len(left))):
        gain = np.linalg.slogdet(known[:, None] + information[:, left])[1].mean(axis=0)
        best = int(np.argmax(gain))
        order.append(left.pop(best))
        known = known + information[:, order[-1]]
        volume.append(np.exp(0.5 * (begun - gain[best])))
    return np.array(order, dtype=np.int64), np.array(volume)
