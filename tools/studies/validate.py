"""Every analytic and independent reference of the tests, with errors and orders, in f64 and f32: a table and a plot.

    pip install '.[test]' && python tools/studies/validate.py [--out FOLDER]

Runs tests/references and the dynamics' references as pytest does, and records what they measure: in f64 as they are, in f32
with the solver's tolerance for f32. Writes validation.md and validation.png into FOLDER (default runs/validation). Exit code 1
where a reference is missed in f64.
"""

import argparse
import sys
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT))

from doo_ti import Newton
from doo_ti.report.canvas import new_figure
from doo_ti.system.files import write_text, write_whole
from tests.references.rods import orders

STATICS, MOTION = "tests/references", "tests/dynamics/test_references.py"


@dataclass
class Recorder:
    """A plugin of pytest: what the references measure under one precision.

    series   (name of the test, numbers of joints, errors), of each order of convergence that one asks for
    results  name of each test: whether it holds
    """

    precision: str
    series: list[tuple[str, list[int], list[float]]] = field(default_factory=list)
    results: dict[str, bool] = field(default_factory=dict)

    def pytest_runtest_setup(self, item):
        if hasattr(item.module, "orders"):
            item.module.orders = partial(self.ordered, item.originalname.removeprefix("test_").replace("_", " "))
        if self.precision == "f32" and hasattr(item.module, "relax"):
            # The wrapped one of an earlier test is not wrapped again.
            item.module.relax = partial(self.coarse, getattr(item.module.relax, "args", (item.module.relax,))[0])

    def pytest_runtest_logreport(self, report):
        if report.when == "call":
            self.results[report.nodeid.partition("::")[2]] = report.passed

    def ordered(self, title, edges, errors) -> np.ndarray:
        together = sorted(zip(edges, errors, strict=True))
        self.series.append((title, [int(count) for count, _ in together], [float(error) for _, error in together]))
        return orders(edges, errors)

    @staticmethod
    def coarse(relax, x0, material, clamps=None, solver=None, **options):
        """In f32, to its own tolerance; an equilibrium at which a test stops on purpose keeps its tolerance."""
        solver = solver or Newton()
        if solver.max_escapes:
            solver = replace(solver, tolerance=Newton().tolerance)
        return relax(x0, material, clamps, solver, **{**options, "precision": "f32"})


def measured(precision: str, paths: list[str]) -> Recorder:
    recorder = Recorder(precision)
    code = pytest.main(["-q", "--no-header", "-p", "no:cacheprovider", "-m", "not slow", *(str(ROOT / path) for path in paths)],
                       plugins=[recorder])
    if code not in (pytest.ExitCode.OK, pytest.ExitCode.TESTS_FAILED):
        raise SystemExit(f"the references did not run ({code})")
    return recorder


def report(double: Recorder, single: Recorder) -> list[str]:
    lines = ["# Validation", "", "Written by `python tools/studies/validate.py`: largest relative error on the finest mesh "
             "in f64, and the order from the mesh before.", "",
             "![Errors over joints](validation.png)", "",
             "reference | cases | joints | largest error | order", "---|---|---|---|---"]
    kinds = {}
    for title, joints, errors in double.series:
        kinds.setdefault(title, []).append((joints[-1], errors[-1], orders(joints, errors)[-1]))
    for kind, rows in kinds.items():
        joints, errors, found = zip(*rows)
        lines.append(f"{kind} | {len(rows)} | {max(joints)} | {max(errors):.1e} | {min(found):.2f} to {max(found):.2f}")
    held, missed = sum(double.results.values()), [name for name, holds in double.results.items() if not holds]
    lines += ["", f"All references, with invariances: {held} of {len(double.results)} hold in f64; "
              f"{sum(single.results.values())} of {len(single.results)} static ones hold in f32 under the bounds of f64."]
    return lines + (["", f"**Missed**: {', '.join(missed)}."] if missed else [])


def picture(file, double: Recorder, single: Recorder) -> None:
    figure = new_figure((8.0, 5.5))
    axes = figure.subplots()
    for recorder, style in ((double, "-o"), (single, "--s")):
        for title, joints, errors in recorder.series:
            color = "#31688e" if style == "-o" else "#ff9f1c"
            axes.loglog(joints, errors, style, color=color, linewidth=0.8, markersize=3, alpha=0.7)
    joints = np.array([10.0, 400.0])
    axes.loglog(joints, 3.0 * joints**-2.0, color="#606060", linewidth=1)
    axes.set_xlabel("joints")
    axes.set_ylabel("error, relative")
    axes.set_title("Errors over joints: f64 blue, f32 orange; the line has order 2", fontsize=11)
    axes.grid(alpha=0.25, which="both")
    figure.canvas.print_png(file)


def main(words: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, default=ROOT / "runs" / "validation")
    options = parser.parse_args(words)
    double, single = measured("f64", [STATICS, MOTION]), measured("f32", [STATICS])
    text = "\n".join(report(double, single)) + "\n"
    print(text)
    write_text(options.out / "validation.md", text)
    write_whole(options.out / "validation.png", lambda file: picture(file, double, single))
    return int(not all(double.results.values()))


if __name__ == "__main__":
    sys.exit(main())
