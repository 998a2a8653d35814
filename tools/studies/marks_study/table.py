"""Coverage of the intervals of the study, by set, family and nuisance."""

import math

import numpy as np

from tools.studies.marks_study.specimens import SOMETIMES

HEADER = ("| set | family | parameter | truth inside | not determined | open on a side | no answer | not converged "
          "| median factor | median high/low | median s |\n|" + "---|" * 11)


def deviation(found: list | None, truth: float) -> float | None:
    """ln(estimate / truth) over the half of the interval towards the truth, times 1.96; None where there is no interval."""
    if not found or found[0] is None:
        return None
    value, low, high = found
    side = low if truth < value else high
    return 0.0 if side is None else 1.96 * math.log(value / truth) / abs(math.log(value / side))


def outside(row: dict) -> dict[str, float]:
    """Parameter: how far, of those whose interval does not contain the truth."""
    z = {name: deviation(row.get(name), row["truth"][name]) for name in ("EI", "GJ")} if "truth" in row else {}
    return {name: value for name, value in z.items() if value is not None and abs(value) > 1.96}


def line(rows: list[dict], label: str, family: str, name: str) -> str | None:
    rows = [row for row in rows if row["truth"]["family"] == family and (name == "EI" or row["truth"]["frames_given"])]
    if not rows:
        return None
    answered = [row for row in rows if row["code"] == 0]
    z = [(row, deviation(row[name], row["truth"][name])) for row in answered]
    some = [(row, one) for row, one in z if one is not None]
    closed = [row for row, _ in some if None not in row[name]]
    factor = [abs(math.log(row[name][0] / row["truth"][name])) for row in closed]
    width = [row[name][2] / row[name][1] for row in closed]
    inside = sum(abs(one) <= 1.96 for _, one in some)

    def median(values):
        return f"{np.median(values):.3f}" if values else "–"

    cells = [label, family, name, f"{inside} of {len(some)}", len(z) - len(some), len(some) - len(closed),
             len(rows) - len(answered), sum(not row["converged"] for row in answered),
             median([math.exp(one) for one in factor]), median(width), median([row["seconds"] for row in answered])]
    return f"| {' | '.join(map(str, cells))} |"


def table(rows: list[dict]) -> str:
    """Markdown: each set, and in ``all`` each nuisance on and off; below it what was outside, and what leaving out moved."""
    rows = [row for row in rows if "truth" in row]
    parts = {group: [row for row in rows if row["group"] == group] for group in sorted({row["group"] for row in rows})}
    whole = parts.get("all", ())
    for name in (*SOMETIMES, "frames_given", "spacings_stated"):
        for on in (True, False):
            parts[f"all, {name} {'on' if on else 'off'}"] = [
                row for row in whole if on == row["truth"].get(name, name in row["truth"]["nuisances"])]
    for words, on in (("only noise is left", True), ("more than noise is left", False)):
        parts[f"all, {words}"] = [row for row in whole if on == ("only noise is left" in row["text"])]
    lines = [line(part, label, family, name) for label, part in parts.items() for family in ("cable", "suture")
             for name in ("EI", "GJ")]
    below = [f"{row['key']}: {', '.join(f'{name} z {z:+.2f}' for name, z in outside(row).items())}; "
             f"{', '.join(row['truth']['nuisances'])}" + ("; said: " + said(row) if said(row) else "")
             for row in rows if outside(row)]
    below += [text for row in rows for text in moved(row)]
    return "\n".join([HEADER, *filter(None, lines), "", *below])


def said(row: dict) -> str:
    """The warnings of the printout that bear on the estimate."""
    words = ("sensitive", "NOT converged", "misfits", "left out", "try", "residuals")
    found = [part.strip() for part in row["text"].splitlines() if part.strip().startswith(words) or "NOT converged" in part]
    return "; ".join(" ".join(part.split()) for part in found if "only noise is left" not in part)


def moved(row: dict) -> list[str]:
    """Poses without which an estimate leaves its interval."""
    lines = []
    for part in row.get("left_out", ()):
        for name in ("EI", "GJ"):
            z = deviation(row.get(name), part[name][0]) if part.get(name) else None
            if z is not None and abs(z) > 1.96:
                mentioned = f"observation {part['pose']} " in row["text"]
                lines.append(f"{row['key']} without pose {part['pose']}: {name} × {part[name][0] / row[name][0]:.3f}, "
                             f"{abs(z) / 1.96:.2f} of the interval; {'' if mentioned else 'NOT '}mentioned")
    return lines
