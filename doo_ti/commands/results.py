"""Shared by the commands: writing files, and printing text or strict JSON."""

import json
import os
import sys
from argparse import Namespace
from collections.abc import Callable, Iterable
from pathlib import Path

import numpy as np

from doo_ti.commands import given
from doo_ti.contact.surroundings import Surroundings
from doo_ti.io.observation_tables import write_rod_table
from doo_ti.rod.grid import Grid, Interval
from doo_ti.rod.types import Clamps, Configuration, Material, Status
from doo_ti.system.errors import InputError
from doo_ti.system.files import write_text, write_whole
from doo_ti.system.terminal import in_line

ROUNDING = 1e-9  # share of a force: smaller components are rounding

# --- files ---------------------------------------------------------------------------------------------------------------


def refuse_overwriting(out: Path, *sources: str | None, option: str = "--out") -> None:
    """Raise InputError where the file to write is also one to read."""
    for source in filter(None, sources):
        if os.path.exists(out) and os.path.exists(source) and out.samefile(source):
            raise InputError(given.SOURCE, option, f"{out} is the input itself", "name another file")


def save_arrays(out: Path, arrays: dict[str, np.ndarray], axes: tuple[str, ...] = ("observation",)) -> None:
    """Write an npz, or by its suffix a CSV file with a row per vertex (:mod:`doo_ti.io.observation_tables`), whole or not;
    arrays that have no place in the table are named on standard error.

    axes  names of the leading axes of the positions
    """
    left_out: list[str] = []
    if out.suffix == ".npz":
        write_whole(out, lambda file: np.savez_compressed(file, **arrays))
    else:
        write_whole(out, lambda file: left_out.extend(write_rod_table(file, arrays, axes)))
    if left_out:
        print(f"doo-ti: note: {', '.join(left_out)} left out of {in_line(out)}; an .npz holds it", file=sys.stderr)


IN_NEWTON = {"start_force": ("N", 1.0), "end_force": ("N", 1.0), "contact_force": ("N", 1.0), "tie_force": ("N", 1.0),
             "tie_moment": ("Nm", 1e-3)}
"""Forces and moments that files have in SI units too: the unit, and N or N m in one N or one N mm."""


def in_newton(arrays: dict[str, np.ndarray], newtons: np.ndarray | None, axis: int) -> dict[str, np.ndarray]:
    """The ``arrays`` of a file and, where ``newtons`` (R,) N in the unit of force of each rod are known, those of
    :data:`IN_NEWTON` in N and N m as well, ``end_force_N`` and so on; rods are on that ``axis``."""
    found = dict(arrays)
    for name, (unit, factor) in IN_NEWTON.items():
        if newtons is not None and name in arrays:
            shape = np.ones(arrays[name].ndim, dtype=int)
            shape[axis] = -1
            found[f"{name}_{unit}"] = arrays[name] * np.reshape(factor * newtons, shape)
    return found


def force_rows(arrays: dict[str, np.ndarray], axis: int) -> list[tuple[str, str]]:
    """The forces of far clamps and obstacles on rods in several moments, of ``arrays`` with forces in N, for :func:`rows`."""
    if "end_force_N" not in arrays:
        return []
    found = []
    if "contact_force_N" in arrays:
        push = np.linalg.norm(np.moveaxis(arrays["contact_force_N"], axis, 0).sum(axis=-2), axis=-1)
        known, last = np.nan_to_num(push), push[:, -1][np.isfinite(push[:, -1])]
        if known.max() > 0:
            at_end = f"; {last.max():.3g} N at the end" if len(last) else ""
            found = [("force", f"obstacles exert {known.max():.3g} N on a rod in all at most, at moment "
                               f"{np.unravel_index(known.argmax(), known.shape)[1]}{at_end}")]
    for name, clamp in (("start_force_N", "near"), ("end_force_N", "far")):
        force = np.moveaxis(arrays.get(name, np.zeros((1, 1, 3))), axis, 0)
        size, last = np.linalg.norm(force, axis=-1), force[:, -1][np.isfinite(force[:, -1]).all(axis=-1)]
        if not last.any():
            continue
        if len(last) == 1:
            whole = np.linalg.norm(last)
            parts = np.where(np.abs(last[0]) < ROUNDING * whole, 0.0, last[0])
            ends = f"{whole:.3g} N ({', '.join(f'{value:.3g}' for value in parts)})"
        else:
            ends = " to ".join(f"{end(np.linalg.norm(last, axis=-1)):.3g}" for end in (np.min, np.max)) + " N"
        found.append(("force", f"the {clamp} clamp exerts {ends} on the rod at the end, {np.nanmax(size):.3g} N at most"))
    return found


def start_force(material: Material, rest_length: np.ndarray, up: np.ndarray, status: np.ndarray, end_force: np.ndarray,
                contact_force: np.ndarray | None) -> np.ndarray:
    """(…, R, 3) of the near clamp on R rods at rest, beside the ``end_force`` of the far one and those of obstacles
    (…, R, V, 3): together they bear the weight. NaN of rods that by their ``status`` (…, R) are not at rest."""
    weight = (2.0 * material.weight * np.sum(rest_length, axis=-1))[:, None] * up
    found = (weight if contact_force is None else weight - contact_force.sum(axis=-2)) - end_force
    return np.where((status == Status.CONVERGED)[..., None], found, np.nan)


def save_json(out: Path, content) -> None:
    """Write what :func:`plain` makes of ``content``."""
    write_text(out, json.dumps(plain(content), indent=2) + "\n")


def plain(value):
    """``value`` as strict JSON holds it: no NumPy types, null for numbers that are not finite."""
    return json.loads(json.dumps(value, default=lambda array: array.tolist()), parse_constant=lambda _: None)


# --- standard output -----------------------------------------------------------------------------------------------------


def report(options: Namespace, summary: dict, lines: Callable[[], list[str]], indent: str = "  ") -> None:
    """Print the ``summary`` as one line of JSON with ``--json``, else the ``lines`` of text, and which files were written: its
    ``out``, or those in ``written``."""
    if options.json:
        print(json.dumps(plain(summary)))
    else:
        files = [f"{indent}written to {in_line(summary['out'])}"] if "out" in summary else []
        print("\n".join([*lines(), *files, *rows(*(("written to", in_line(path)) for path in summary.get("written", ())))]))
    note_theta(options)


def note_theta(options: Namespace) -> None:
    """Say in one line, where ``--theta`` is given, what of the file the command has used."""
    if getattr(options, "theta", None) and getattr(options, "theta_note", None):
        print(f"{in_line(options.theta)}: {options.theta_note}{getattr(options, 'friction_note', '')}", file=sys.stderr)


def theta_text(theta: dict, isotropic: bool) -> str:
    """Θ as text."""
    names = ["bend_1"] if isotropic else ["bend_1", "bend_2"] + ["bend_12"] * bool(theta["bend_12"])
    bend = ", ".join(f"{'bend' if isotropic else name} {theta[name]:.4g} mm³" for name in names)
    return f"{bend}, twist {theta['twist']:.4g} mm³, weight {theta['weight']:.4g}"


def theta_of(grid: Grid, cell: int = 0) -> dict[str, float]:
    """Θ of one cell by its names."""
    return {name: float(value[0]) for name, value in grid.cell_values([cell]).items()} | {"bend_12": grid.bend_12}


def rows(*entries: tuple[str, str | object], width: int = 12) -> list[str]:
    """Lines of labels, padded to ``width`` characters, and their texts. What is not said has the text None, False or empty."""
    return [f"  {label:<{width}}{text}" for label, text in entries if text]


def status_text(counts: dict[str, int]) -> str:
    """``57 converged, 3 iteration limit``."""
    return ", ".join(f"{count} {name.replace('_', ' ')}" for name, count in counts.items())


def listed(names: Iterable, most: int) -> str:
    """The first ``most`` names, and how many more there are."""
    texts = [in_line(name) for name in names]
    return ", ".join(texts[:most]) + f" and {len(texts) - most} more" * (len(texts) > most)


def shortened(lines: list[str], most: int, rest: str) -> list[str]:
    """The first ``most`` lines, then ``rest`` with the number of further lines in place of {}."""
    return lines if len(lines) <= most else [*lines[:most], rest.format(len(lines) - most)]


def contact_summary(surroundings: Surroundings, force: np.ndarray, gap: np.ndarray, status: np.ndarray) -> dict:
    """Of R rods, what the summaries say of contact: nothing without obstacles, else how many rods touch one in some vertex and
    instant, and at the last of several instants, the smallest gap of feasible ones in mm, and how many are infeasible.

    force, gap, status  (R, ...) with or without instants, and vertices
    """
    if not surroundings:
        return {}
    infeasible = status == Status.INFEASIBLE
    rods, finite = len(gap), gap[np.isfinite(gap) & ~infeasible]
    pressed = (np.nan_to_num(force) != 0).any(axis=-1)
    at_end = {"touching_at_end": int(pressed[:, -1].any(axis=-1).sum())} if status.ndim > 1 else {}
    return {"contact": {
        "touching": int(pressed.reshape(rods, -1).any(axis=1).sum()), **at_end,
        "smallest_gap_mm": finite.min() if len(finite) else np.nan,
        "infeasible": int(infeasible.reshape(rods, -1).any(axis=1).sum())}}


def inside_reason(surroundings: Surroundings, clamps: Clamps, start: Configuration, number: np.ndarray) -> str | None:
    """What of infeasible rods of that ``number`` (R,) is inside an obstacle, and by how much; None where nothing is."""
    from doo_ti.relaxation.contact_table import require_clear

    if surroundings and len(number):
        try:
            require_clear("relax", surroundings, clamps, start, number)
        except InputError as error:
            return error.problem
    return None


def contact_row(summary: dict, rods: int) -> tuple[str, str | None]:
    """:func:`contact_summary` as text, for :func:`rows`."""
    found = summary.get("contact")
    if found is None:
        return "contact", None
    gap = "" if np.isnan(found["smallest_gap_mm"]) else f"; smallest gap {found['smallest_gap_mm']:.2g} mm"
    at_end = f", {found['touching_at_end']} at the end" if "touching_at_end" in found else ""
    return "contact", f"{found['touching']} of {rods} rods touch an obstacle{at_end}{gap}; {found['infeasible']} infeasible"


def mesh_summary(rods: Configuration, material: Material, clamps: Clamps, up: np.ndarray, surroundings: Surroundings) -> dict:
    """What the summaries say of rods at rest, one kind of clamps for all: mm, root mean square along a rod, by which finer ones
    rest elsewhere, and ones whose clamps end at the end vertices; NaN where no such rod came to rest."""
    from doo_ti.relaxation.relax import clamp_change, mesh_change

    found = {}
    for name, change in (("mesh_error", mesh_change), ("clamp_error", clamp_change)):
        off = np.sqrt(np.mean(np.sum(change(rods, material, clamps, up, surroundings) ** 2, axis=-1), axis=1))
        off = off[np.isfinite(off)] if np.isfinite(off).any() else np.full(1, np.nan)
        found |= {f"median_{name}_mm": np.median(off), f"largest_{name}_mm": off.max()}
    return found


def mesh_rows(summary: dict) -> list[tuple[str, str | None]]:
    """:func:`mesh_summary` as text, for :func:`rows`; nothing of what is unknown, nor of clamps that hold no edge."""
    return [(label, summary.get(f"largest_{name}_mm", np.nan) > 0 and
             f"{text} {summary[f'median_{name}_mm']:.2g} mm elsewhere (root mean square), the "
             f"worst {summary[f'largest_{name}_mm']:.2g} mm{remedy}")
            for label, name, text, remedy in (
                ("mesh error", "mesh_error", "rods of many edges rest about", ""),
                ("clamps", "clamp_error", "hold half of each outer edge; if they end at the outer marks, rods rest about",
                 " (convert --edges)"))]


def run_lines(result: dict) -> list[str]:
    """Lines of a sweep's overview, or of its summary."""
    grid, statuses, best = Grid.from_dict(result["grid"]), dict(result["rods"]), result["best"]
    count, stable = statuses.pop("count"), statuses.pop("stable")
    cells, terms = result["cells"], "observations" if result["objective"] == "static" else "pairs of observations (Eq. 3)"
    per_cell = count // cells
    others, left_out, jumps = result["cells_not_competing"], result["terms_left_out"], result.get("jumps")
    intervals = (Interval(**entry) for entry in result["intervals_within_5_percent"])
    return [f"{in_line(result['material'])}: {cells} cells x {per_cell} {terms}", *rows(
        ("best cell", theta_text(best, grid.is_isotropic)),
        ("", "(best fit if the rod is straight at rest and clamped exactly as the marks say)"),
        ("distance", f"mean {best['mean_distance_mm']:.4g} mm (Eq. 1)"),
        *(("flatness", f"{interval}{' (at the border of the grid: widen it)' * interval.at_border}") for interval in intervals),
        ("", "(cells within 5 % of the smallest error; this is not an uncertainty)"),
        ("status", f"{status_text(statuses)}; {stable} certified stable"),
        ("competing", f"{result['cells_competing']} of {cells} cells"
                      + f"; in the other {others} some rod has no certified minimum" * bool(others)),
        ("", left_out and f"left out: {left_out} of {per_cell} {terms}, certified in no cell"),
        ("jumps", jumps and f"{jumps['rods_at_best']} of {per_cell} rods jumped to another branch on the way in the best cell, "
                            f"{jumps['rods']} of {count} in all"))]


def hypotheses_lines(summary: dict, labels: np.ndarray) -> list[str]:
    """The chosen hypotheses about whole turns and rolls, where there were several; ``labels`` (D,) of the observations."""
    found = summary.get("hypotheses")
    if found is None:
        return []
    kept, ambiguous = found["kept"], set(found["ambiguous"])
    pairs = zip(kept["observation"], kept["turns"], strict=True)
    settled = [turn for observation, turn in pairs if observation not in ambiguous]
    turns = ", ".join(f"{turn:+d}: {settled.count(turn)}" for turn in sorted(set(settled)))
    return rows(
        ("hypotheses", f"{found['hypotheses']}; decided for {found['resolved']} observations; {len(ambiguous)} are ambiguous "
                       "and take the nearest in each cell"),
        ("", turns and f"observations by whole turns: {turns}; each one's is in summary.json"),
        ("", ambiguous and f"ambiguous observations: {', '.join(map(str, labels[sorted(ambiguous)]))}"))
