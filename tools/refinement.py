"""Results of refinement, compared with their required values (bars): ``python tools/refinement.py [ROW ...] [--data DIR]``.

Prints a Markdown table, ``| check | bar | measured | holds |``. The data of the sutures ships with
the tests; ``specimens`` and ``cable`` need --data and run where they are named. Exit code 1 where a bar is missed or a row has
no data. The coverage of the intervals is measured by ``tools/calibration_study.py``.

    specimens  random rods of an independent mesh solver, ``doo-ti sweep`` and ``doo-ti refine RUN --json`` as commands
    lab        the paper's sutures, likewise
    extra      the same optimum under parameters that add nothing: intervals of the others
    exact      rods of the model's own mesh, without noise, straight, clips known
    cable      a real cable in five folds by recording: errors of what the fit did not see
    speed      60 observations, the whole process, kernels compiled before
"""

import argparse
import json
import subprocess
import sys
import tempfile
import time
from dataclasses import replace
from pathlib import Path

import numpy as np

ROOT = Path(__file__).resolve().parents[1]
if not __package__:
    sys.path.insert(0, str(ROOT))

from doo_ti import load_observations, observation_clamps, relax, start_configuration  # noqa: E402
from doo_ti.refinement.folds import folds_of, refine_held_out  # noqa: E402
from doo_ti.refinement.refine import RefinementOptions, refine  # noqa: E402
from doo_ti.refinement.theta import Theta  # noqa: E402
from tools.bench.lab import TRUTH  # noqa: E402
from tools.checks import Check, table  # noqa: E402

SUTURES = ("nylon", "vicryl", "silk")
GRID = ("--bend", "5e4:1e7:25", "--twist-ratio", "0.1:6:25")


def command(*words: str) -> str:
    """What ``doo-ti`` prints, in a process of its own. Raises CalledProcessError where it fails."""
    return subprocess.run([sys.executable, "-m", "doo_ti", *words], check=True, capture_output=True, text=True).stdout


def fitted(observations: Path, folder: Path) -> dict[str, dict]:
    """The parameters that the default pipeline prints, by name."""
    run = folder / observations.stem
    command("sweep", str(observations), *GRID, "--out", str(run), "--json")
    return {one["name"]: one for one in json.loads(command("refine", str(run), "--json"))[0]["parameters"]}


def holds(parameter: dict, truth: float) -> bool:
    low, high = parameter["low"], parameter["high"]
    return (low is None or low <= truth) and (high is None or truth <= high)


def over(parameter: dict, truth: float) -> str:
    """A parameter and its interval over the truth."""
    ends = ["open" if parameter[end] is None else f"{parameter[end] / truth:.3g}" for end in ("low", "high")]
    return f"{parameter['value'] / truth:.3g} ({ends[0]} … {ends[1]})"


def specimens(data: Path) -> list[Check]:
    truth = json.loads((data / "specimens" / "truth.json").read_text())
    checks, inside, factors = [], {"bend": 0, "twist": 0}, []
    with tempfile.TemporaryDirectory() as folder:
        for name, true in truth.items():
            found = fitted(data / "specimens" / f"{name}.npz", Path(folder))
            for key in inside:
                inside[key] += holds(found[key], true[key])
            factors.append(abs(np.log(found["bend"]["value"] / true["bend"])))
            checks.append(Check(f"specimen {name}: bend, twist over the truth", "", f"{over(found['bend'], true['bend'])}, "
                                f"{over(found['twist'], true['twist'])}", None))
    least = len(truth) - 1
    checks += [Check(f"specimens: {key} in its interval", f"≥ {least} of {len(truth)}", f"{count} of {len(truth)}",
                     count >= least) for key, count in inside.items()]
    middle = float(np.exp(np.median(factors)))
    return [*checks, Check("specimens: median factor off, bend", "≤ 1.2", f"{middle:.3f}", middle <= 1.2)]


def lab(data: Path) -> list[Check]:
    checks = []
    with tempfile.TemporaryDirectory() as folder:
        for name in SUTURES:
            found = fitted(data / "lab_a" / f"{name}.npz", Path(folder))
            bend, _, twist = TRUTH[name]
            checks.append(Check(f"lab: {name}, bend and twist over the truth", "both in", f"{over(found['bend'], bend)}, "
                                f"{over(found['twist'], twist)}", holds(found["bend"], bend) and holds(found["twist"], twist)))
    return checks


def extra(data: Path) -> list[Check]:
    """The undetermined twist stiffness of a cable with free rolls, learned in addition to bend. And, for comparison, gravity's
    direction, which does affect the interval of bend, because gravity relates stiffness to weight."""
    cable = load_observations(data / "cables/dlo1.npz")
    suture, (bend, _, twist) = load_observations(data / "lab_a/vicryl.npz"), TRUTH["vicryl"]
    cases = (("twist of a cable that may spin", cable, Theta(3.2e6 * np.eye(2), 3.2e6), ("bend",), "twist", 0.1),
             ("up of vicryl", suture, Theta(bend * np.eye(2), twist), ("bend", "twist"), "up", np.inf))
    checks = []
    for label, observations, begin, names, more, bar in cases:
        widths = []
        for parameters in (names, (*names, more)):
            found = refine(observations, observation_clamps(observations), begin, RefinementOptions(parameters))
            one = found.estimate.parameter("bend")
            widths.append(np.log(one.high / one.low))
        change = widths[1] / widths[0] - 1
        checks.append(Check(f"extra: {label}, width of bend's interval", "—" if np.isinf(bar) else f"within {bar:.0%}",
                            f"{change:+.1%}", abs(change) <= bar))
    return checks


def exact(data: Path) -> list[Check]:
    checks = []
    for name in SUTURES:
        observations, (bend, _, twist) = load_observations(data / f"lab_a/{name}.npz"), TRUTH[name]
        true, clamps = Theta(bend * np.eye(2), twist), observation_clamps(observations)
        clean = relax(start_configuration(observations, clamps), true.material, clamps).configuration.vertices
        options = RefinementOptions(clip=1.5, curvature="none", clamps="exact", edges=33, intervals="covariance")
        found = refine(replace(observations, vertices=clean), clamps, Theta(1.4 * true.bend, 0.8 * twist), options)
        off = max(abs(found.theta.bend[0, 0] / bend - 1), abs(found.theta.twist / twist - 1))
        checks.append(Check(f"exact: {name}", "≤ 0.1 %", f"{off:.2e}", off <= 1e-3))
    return checks


def cable(data: Path) -> list[Check]:
    path = data / "cables/dlo1.npz"
    observations = load_observations(path)
    with np.load(path, allow_pickle=False) as keys:
        fold = folds_of(keys["source_trajectory"], 5)
    clamps, begin = observation_clamps(observations), Theta(3.2e6 * np.eye(2), 3.2e6)
    checks = []
    for label, options, bar in (("straight", RefinementOptions(("bend",), curvature="none"), np.inf),
                                ("default", RefinementOptions(("bend",)), 10.9)):
        held = refine_held_out(observations, clamps, begin, fold, options)
        checks.append(Check(f"cable: dlo1, five folds, {label}", "—" if np.isinf(bar) else f"≤ {bar:g} mm",
                            f"{held.mean_distance:.2f} ± {held.standard_error:.2f} mm held out", held.mean_distance <= bar))
    return checks


def speed(data: Path) -> list[Check]:
    with tempfile.TemporaryDirectory() as folder:
        run = str(Path(folder) / "run")
        command("sweep", str(data / "lab_a/vicryl.npz"), *GRID, "--out", run, "--json")
        seconds = []
        for _ in range(4):
            began = time.perf_counter()
            command("refine", run, "--json")
            seconds.append(time.perf_counter() - began)
    middle = float(np.median(seconds[1:]))
    return [Check("speed: 60 observations, doo-ti refine RUN, whole process", "≤ 20 s", f"{middle:.1f} s", middle <= 20)]


SHIPPED = ("lab", "exact", "speed")
"""Rows whose data ships with the tests."""
ROWS = {"specimens": specimens, "lab": lab, "extra": extra, "exact": exact, "cable": cable, "speed": speed}


def main(words: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("rows", nargs="*", metavar="ROW", help=f"of {', '.join(ROWS)} (default: all)")
    parser.add_argument("--data", type=Path, default=ROOT / "tests" / "data")
    options = parser.parse_args(words)
    for row in options.rows:
        if row not in ROWS:
            parser.error(f"no row {row!r}; choose from {', '.join(ROWS)}")
    checks = []
    for row in options.rows or SHIPPED:
        print(f"measuring {row}", file=sys.stderr)
        try:
            checks += ROWS[row](options.data)
        except (ValueError, OSError, subprocess.CalledProcessError) as error:
            checks.append(Check(row, "", f"skipped: {error}", None))
    print(table(checks))
    return int(any(check.holds is False or check.measured.startswith("skipped") for check in checks))


if __name__ == "__main__":
    raise SystemExit(main())
