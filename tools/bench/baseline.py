"""Measurements beside a committed baseline: ratios to the NumPy workload of the same run, and the share that converged."""

from doo_ti.bench import clock
from doo_ti.bench.cases import Case, Measurement, measure

SLOWEST = 0.5
"""A ratio below this share of the baseline's is a regression."""
FEWER = 0.002
"""Allowed decrease of the share of converged rods."""


def as_baseline(measured: dict[str, Measurement], rods: int, rounds: int, threads: int) -> dict:
    """What ``baseline.json`` holds."""
    versions = clock.versions()
    return {
        "machine": {**clock.machine(), "threads": threads},
        "versions": {name: versions[name] for name in ("taichi", "numpy")},
        "rods": rods,
        "rounds": rounds,
        "cases": {
            name: {"unit": m.unit, "per_second": float(f"{m.per_second:.4g}"), "ratio": float(f"{m.ratio:.4g}"),
                   "converged": round(m.converged, 5), "iterations": round(m.iterations, 2)}
            for name, m in measured.items()
        },
    }


def regressions(measured: dict[str, Measurement], baseline: dict) -> list[str]:
    """One sentence per case that is much slower than the baseline, or converges less often."""
    found = []
    for name, m in measured.items():
        old = baseline.get("cases", {}).get(name)
        if old and m.ratio < SLOWEST * old["ratio"]:
            found.append(f"{name}: {m.ratio / old['ratio']:.2f} of the baseline's ratio")
        if old and m.converged < old["converged"] - FEWER:
            found.append(f"{name}: {100 * m.converged:.2f} % converged, {100 * old['converged']:.2f} % in the baseline")
    return found


def measured_again(case: Case, first: Measurement, reference: clock.Reference, rounds: int) -> Measurement:
    """The better of two measurements, the second over twice the rounds: another process may have disturbed the
    first."""
    second = measure(case, reference, 2 * rounds)
    return second if second.ratio > first.ratio else first


def table(measured: dict[str, Measurement], baseline: dict) -> str:
    """Markdown, one line per case; the ratio per 10⁶ multiply-adds of the reference."""
    lines = ["| case | per second | converged | iterations | ratio ·10⁶ | of baseline |", "|---|---|---|---|---|---|"]
    for name, m in measured.items():
        old = baseline.get("cases", {}).get(name)
        share = f"{m.ratio / old['ratio']:.2f}" if old else "new"
        lines.append(f"| {name} | {m.per_second:,.0f} {m.unit} | {100 * m.converged:.2f} % | {m.iterations:.1f} | "
                     f"{1e6 * m.ratio:.4g} | {share} |")
    return "\n".join(lines)
