"""Additions of the study to the table of ``doo-ti bench``: processes, iterations, scaling."""

from doo_ti.bench import table
from doo_ti.bench.table import given, markdown, percent

BINS = (4, 5, 6, 7, 8, 10, 12, 16, 24, 48)
"""Iterations up to which each line of the histogram counts."""


def text(summary: dict) -> str:
    """Markdown of what :mod:`tools.bench.study` measured."""
    parts = [table.text(summary), "\n".join(notes(summary["process"])), histogram(summary["cases"])]
    if "scaling" in summary:
        parts += [scaling(summary["scaling"])]
    return "\n\n".join(parts)


def notes(fresh: dict) -> list[str]:
    """Start-up, memory and threads, each measured in processes of its own."""
    return [
        f"- start-up: `import doo_ti` {1e3 * fresh['import_s']:.1f} ms; a process that relaxes, from start to end, "
        f"{fresh['first_relaxation_s']:.1f} s with an empty kernel cache, {fresh['cached_relaxation_s']:.1f} s after that",
        f"- memory: {given(fresh['bytes_per_rod'], '{:,.0f} bytes')} a rod above the results, "
        f"{given(fresh['growth_kb_per_call'], '{:+.3f} kB')} a call over the later half of many calls",
        "- threads: " + ", ".join(f"{entry['rods_per_second']:,.0f} rods/s on {entry['threads']}"
                                  for entry in fresh["threads"]),
    ]


def large_batches(found: dict[str, dict]) -> dict[str, list[int]]:
    """Numbers of rods by iterations of the cases that relax all rods in one call."""
    return {name: case["histogram"] for name, case in found.items()
            if case["busy"] is not None and "batches" not in name and "one rod" not in name}


def histogram(found: dict[str, dict]) -> str:
    """Share of the rods by iterations, a column for each case of large batches."""
    shown = large_batches(found)
    heads = ["iterations", *(name.removeprefix("newton ") for name in shown)]
    lines = []
    for low, high in zip((0, *(limit + 1 for limit in BINS)), (*BINS, None)):
        of_case = [sum(counts[low:None if high is None else high + 1]) / max(sum(counts), 1) for counts in shown.values()]
        label = f"> {BINS[-1]}" if high is None else f"≤ {high}" if low == 0 else f"{low} – {high}" if low < high else f"{low}"
        lines.append([label, *map(percent, of_case)])
    most = ["most", *(f"{len(counts) - 1}" for counts in shown.values())]
    return markdown(heads, [*lines, most])


def scaling(points: dict[str, list[dict]]) -> str:
    """One line per point."""
    heads = ["rods", "edges", "precision", "seconds", "rods/s", "converged", "iterations"]
    return markdown(heads, [
        [f"{point['rods']}", f"{point['edges']}", point["precision"], f"{point['seconds']:.4g}",
         f"{point['rods_per_second']:,.0f}", percent(point["converged"]), f"{point['iterations']:.1f}"]
        for axis in points.values() for point in axis])
