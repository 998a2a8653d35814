"""What a person reads of a benchmark: one table of the cases, and below it what the figures are made of."""

JAX_NAMES = {"explicit": "JAX, derivatives written out", "automatic": "JAX, derivatives by autodiff"}
BINS = (4, 5, 6, 7, 8, 10, 12, 16, 24, 48)
"""Iterations up to which each line of the histogram counts."""


def text(summary: dict) -> str:
    """Markdown of what :mod:`doo_ti.bench.study` measured."""
    parts = [machine(summary), cases(summary["cases"]), "\n".join(notes(summary)), histogram(summary["cases"])]
    if "jax" in summary:
        parts += [jax(summary["jax"])]
    if "scaling" in summary:
        parts += [scaling(summary["scaling"])]
    return "\n\n".join(parts)


def machine(summary: dict) -> str:
    """One line: what the figures were taken on and with."""
    found = summary["machine"]
    made_of = ", ".join(f"{name} {number}" for name, number in summary["versions"].items())
    return (f"{found['processor']}, {_counted(found['cores'], 'core')}, {_counted(found['threads'], 'thread')}"
            f"{'' if found['architecture'] == 'cpu' else ', ' + found['architecture']}; {made_of}; "
            f"batches of {summary['rods']}, rods of 33 edges, medians of {summary['rounds']}")


def cases(found: dict[str, dict]) -> str:
    """One line per case; a dash where a figure does not apply."""
    heads = ["case", "per second", "converged", "stable", "iterations", "residual", "lanes busy", "of peak"]
    lines = []
    for name, case in found.items():
        lines.append([
            name, f"{case['per_second']:,.0f} {case['unit']}", percent(case["converged"]), percent(case["stable"]),
            f"{case['iterations']:.1f}" if case["iterations"] else "–", _given(case["residual"], "{:.0e} /mm"),
            percent(case["busy"]), percent(case["share_of_peak"])])
    return _markdown(heads, lines)


def notes(summary: dict) -> list[str]:
    """Accuracy, the machine's peak, start-up, memory and threads."""
    accuracy, fresh, peak = summary["f32_against_f64"], summary["process"], summary["peak_gflops"]
    lines = [
        f"- f32 against f64: {percent(accuracy['same_minimum'])} of {accuracy['rods']} rods in the same minimum, there "
        f"{accuracy['median_mm']:.1e} mm apart (median), {accuracy['percentile_99_mm']:.1e} mm (99th percentile)",
        "- peak, multiply-adds on packs: " + (", ".join(f"{rate:,.0f} GFlop/s {name}" for name, rate in peak.items()) or "–"),
        f"- start-up: `import doo_ti` {1e3 * fresh['import_s']:.1f} ms; a process that relaxes, from start to end, "
        f"{fresh['first_relaxation_s']:.1f} s with an empty kernel cache, {fresh['cached_relaxation_s']:.1f} s after that",
        f"- memory: {_given(fresh['bytes_per_rod'], '{:,.0f} bytes')} a rod above the results, "
        f"{_given(fresh['growth_kb_per_call'], '{:+.3f} kB')} a call over the later half of many calls",
        "- threads: " + ", ".join(f"{entry['rods_per_second']:,.0f} rods/s on {entry['threads']}"
                                  for entry in fresh["threads"]),
    ]
    return lines


def histogram(found: dict[str, dict]) -> str:
    """Share of the rods by iterations, a column for each case of one launch or ladder."""
    shown = {name: case["histogram"] for name, case in found.items() if case["busy"] is not None}
    heads = ["iterations", *(name.removeprefix("newton ") for name in shown)]
    lines = []
    for low, high in zip((0, *(limit + 1 for limit in BINS)), (*BINS, None)):
        of_case = [sum(counts[low:None if high is None else high + 1]) / max(sum(counts), 1) for counts in shown.values()]
        label = f"> {BINS[-1]}" if high is None else f"≤ {high}" if low == 0 else f"{low} – {high}" if low < high else f"{low}"
        lines.append([label, *map(percent, of_case)])
    most = ["most", *(f"{len(counts) - 1}" for counts in shown.values())]
    return _markdown(heads, [*lines, most])


def jax(found: list[dict]) -> str:
    """The same solver in JAX, one line per way to the derivatives and precision, with how many times as fast the case is that
    it stands beside, measured in the same run."""
    heads = ["the same solver", "beside", "rods", "rods/s", "that case is", "converged", "iterations", "compiled in"]
    return _markdown(heads, [
        [JAX_NAMES[rate["derivatives"]], rate["beside"], f"{rate['rods']}", f"{rate['rods_per_second']:,.0f}",
         f"{rate['times']:,.1f} × as fast", percent(rate["converged"]), f"{rate['iterations']:.1f}",
         f"{rate['compile_seconds']:.1f} s"] for rate in found])


def scaling(points: dict[str, list[dict]]) -> str:
    """One line per point."""
    heads = ["rods", "edges", "precision", "seconds", "rods/s", "converged", "iterations"]
    return _markdown(heads, [
        [f"{point['rods']}", f"{point['edges']}", point["precision"], f"{point['seconds']:.4g}",
         f"{point['rods_per_second']:,.0f}", percent(point["converged"]), f"{point['iterations']:.1f}"]
        for axis in points.values() for point in axis])


def percent(share: float | None) -> str:
    """A share; never rounded up to all."""
    return "–" if share is None else "100 %" if share == 1 else f"{min(100 * share, 99.99):.2f} %"


def _given(value: float | None, form: str) -> str:
    return "–" if value is None else form.format(value)


def _counted(count: int, what: str) -> str:
    return f"{count} {what}{'s' * (count != 1)}"


def _markdown(heads: list[str], lines: list[list[str]]) -> str:
    widths = [max(map(len, column)) for column in zip(heads, *lines, strict=True)]
    rows = [heads, ["-" * width for width in widths], *lines]
    return "\n".join("| " + " | ".join(map(str.ljust, row, widths)) + " |" for row in rows)
