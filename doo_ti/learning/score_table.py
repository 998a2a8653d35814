"""Tables of leave-one-out scores as aligned text, Markdown, CSV and JSON (Tables I to III).

An entry is mean ± standard error in mm. Text marks the best entry of a column with ``*`` (the paper: bold) and those
within one standard error of it with ``~``; Markdown sets them bold and italic. The diagonal is in brackets.
"""

import numpy as np

from doo_ti.learning.cross_validation import Scores
from doo_ti.system.files import csv_text

NUMBERS = {("material",): "Table I", ("material", "end-distance"): "Table II", ("objective", "end-distance"): "Table III"}
"""The paper's number of each partition."""
EQUATIONS = {"static": "static (Eq. 2)", "dynamic": "dynamic (Eq. 3)"}

LISTED = 12  # most entries that a note lists


def file_stem(by: tuple[str, ...]) -> str:
    """Name of a partition's files: ``by_material_and_end_distance``."""
    return "by_" + "_and_".join(factor.replace("-", "_") for factor in by)


def caption(scores: Scores) -> str:
    """One line: the paper's number of this table if it has one, what rows and columns are, and what they have in common."""
    partition = scores.partition
    title = "eave-one-out error by " + " and ".join(factor.replace("-", " ") for factor in partition.by)
    title = f"{NUMBERS[partition.by]}: l{title}" if partition.by in NUMBERS else f"L{title}"
    within = " ".join(EQUATIONS.get(word, word) for word in partition.within.split(" "))
    return f"{title}{'; ' + within if within else ''}; mean ± standard error of Eq. 1 in mm"


def text(scores: Scores, width: int) -> str:
    """The table and the Θ of its training sets, in lines of at most ``width`` characters if no column is wider."""
    rows = _rows(scores, ("*", "~", " "), lambda entry, mark: (entry if entry[0] == "[" else f" {entry} ") + mark)
    heads = ["train \\ test", *(f" {label}" for label in _labels(scores))]
    legend = "[ ] trained and tested on the same part   * best of its column   ~ within one standard error of it"
    return "\n".join([caption(scores), "", _aligned(heads, rows, width), "", legend, *notes(scores), "",
                      "What each training set chooses as a whole", "", _aligned(*_choices(scores), width)])


def markdown(scores: Scores) -> str:
    """The table as Markdown."""
    rows = _rows(scores, ("**", "_", ""), lambda entry, mark: f"{mark}{entry}{mark}")
    below = ["In brackets: trained and tested on the same part", "**bold**: best of its column",
             "_italic_: within one standard error of it", *notes(scores)]
    return "\n\n".join([f"**{caption(scores)}**", _markdown(["train / test", *_labels(scores)], rows), "; ".join(below) + ".",
                        "What each training set chooses as a whole:", _markdown(*_choices(scores))]) + "\n"


def comma_separated(tables: list[Scores]) -> str:
    """The tables of the same factors as CSV, one line per entry, numbers in full."""
    lines = [line for scores in tables for line in entries(scores)]
    return csv_text(lines[0], (line.values() for line in lines))


def entries(scores: Scores) -> list[dict]:
    """One dictionary per entry, row by row: its numbers, and the Θ chosen by its whole training set."""
    labels, lines = _labels(scores), []
    for row, train in enumerate(labels):
        theta = _theta(scores, row)
        for column, test in enumerate(labels):
            at = (row, column)
            lines.append({
                "within": scores.partition.within, "train": train, "test": test, "mean_mm": float(scores.mean[at]),
                "standard_error_mm": float(scores.standard_error[at]), "n": int(scores.count[at]),
                "left_out": int(scores.left_out[at]), "not_certified": int(scores.uncertified[at]),
                "jumped": int(scores.jumped[at]), "is_best": bool(scores.is_best[at]), "is_near": bool(scores.is_near[at]),
                **theta})
    return lines


def notes(scores: Scores) -> list[str]:
    """Lines below the table: terms that are in no part, tested terms without a score, rods that are not certified or
    jumped."""
    found, labels = [], _labels(scores)
    if scores.partition.unlabelled:
        found.append(f"{scores.partition.unlabelled} terms without an end distance are in no part")
    for what, counts, out_of in (
            ("left out: no distance, or no training terms left", scores.left_out, scores.left_out + scores.count),
            ("scored, but no certified minimum at the chosen cell", scores.uncertified, scores.count),
            ("scored, but jumped to another branch", scores.jumped, scores.count)):
        places = np.argwhere(counts)
        listed = [f"{labels[row]} -> {labels[column]} {counts[row, column]} of {out_of[row, column]}"
                  for row, column in places[:LISTED]]
        if len(places) > LISTED:
            listed.append(f"and {len(places) - LISTED} more entries")
        if listed:
            found.append(f"{what}: {', '.join(listed)}")
    if not scores.uncertified.any():
        found.append("every scored rod is a certified minimum")
    return found


def _labels(scores: Scores) -> list[str]:
    return [part.label for part in scores.partition.parts]


def _rows(scores: Scores, marks: tuple[str, str, str], marked) -> list[list[str]]:
    """A line per training set: its label, then mean ± standard error of every entry, the diagonal in brackets; ``marked``
    adds to an entry the mark of the best, of those near it, or of all others."""
    of_entry = np.select([scores.is_best, scores.is_near], marks[:2], marks[2])
    rows = []
    for row, label in enumerate(_labels(scores)):
        rows.append([label])
        for column, (mean, error) in enumerate(zip(scores.mean[row], scores.standard_error[row], strict=True)):
            entry = "–" if np.isnan(mean) else f"{mean:.3f}" if np.isnan(error) else f"{mean:.3f} ± {error:.3f}"
            rows[-1].append(marked(f"[{entry}]" if row == column else entry, of_entry[row, column]))
    return rows


def _theta(scores: Scores, row: int) -> dict[str, float]:
    """The Θ of a training set, units in the names; NaN where it chooses none."""
    grid, best = scores.partition.parts[row].landscape.grid, scores.best[row]
    first, second, twist, weight = (float(value[0]) if best >= 0 else np.nan
                                    for value in grid.cell_values(np.array([max(best, 0)])).values())
    return {"bend_1_mm3": first, "bend_2_mm3": second, "bend_12_mm3": grid.bend_12, "twist_mm3": twist, "weight": weight}


def _choices(scores: Scores) -> tuple[list[str], list[list[str]]]:
    """Heads and rows of the training sets' table: Θ, its error, and the axes at whose border it lies."""
    grid = scores.partition.parts[0].landscape.grid
    shown = {"bend_1_mm3": "bend_1 [mm³]", "bend_2_mm3": "bend_2 [mm³]", "bend_12_mm3": "bend_12 [mm³]"}
    if grid.is_isotropic:
        shown = {"bend_1_mm3": "bend [mm³]"}
    elif not grid.bend_12:
        del shown["bend_12_mm3"]
    shown |= {"twist_mm3": "twist [mm³]", "weight": "weight"}
    rows = []
    for row, (part, best) in enumerate(zip(scores.partition.parts, scores.best, strict=True)):
        used, theta = part.measurable, _theta(scores, row)
        of_all = f"{len(used.terms)} of {len(part.terms)}"
        if best < 0:
            rows.append([part.label, *("–" for _ in shown), "–", of_all, "–", ""])
            continue
        places = zip(grid.axes, np.unravel_index(best, grid.shape), strict=True)
        border = [axis.name for axis, place in places if len(axis) > 1 and place in (0, len(axis) - 1)]
        rows.append([part.label, *(f"{theta[key]:.4g}" for key in shown), f"{scores.training[row]:.3f}", of_all,
                     f"{used.certified(best).sum()} of {len(used.terms)}", ", ".join(border)])
    return ["train", *shown.values(), "error [mm]", "terms", "certified", "at the border of"], rows


def _aligned(heads: list[str], rows: list[list[str]], width: int) -> str:
    """Columns padded to their widest entry; those that do not fit into ``width`` follow below, with the first column again."""
    table = [heads, *rows]
    widths = [max(len(line[column]) for line in table) for column in range(len(heads))]
    blocks, block, used = [], [], widths[0]
    for column in range(1, len(heads)):
        if block and used + 2 + widths[column] > width:
            blocks.append(block)
            block, used = [], widths[0]
        block.append(column)
        used += 2 + widths[column]
    return "\n\n".join("\n".join("  ".join(line[column].ljust(widths[column]) for column in (0, *columns)).rstrip()
                                 for line in table) for columns in (*blocks, block))


def _markdown(heads: list[str], rows: list[list[str]]) -> str:
    lines = [heads, ["---", *("--:" for _ in heads[1:])], *rows]
    return "\n".join("| " + " | ".join(cell.replace("|", "\\|") for cell in line) + " |" for line in lines)
