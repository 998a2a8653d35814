"""Ten deliberate faults in a copy of the package, one after the other: the default tests have to catch each.

    python tools/maintenance/mutations.py [NAME ...] [--whole]

For each fault prints the tests that fail. Its own rooms' tests run first, in the default tier; all default tests run with
``--whole``, and where none of these fails. The copy is thrown away. Exit code 1 where a fault is caught by no test, or no
longer applies.
"""

import argparse
import os
import re
import shutil
import subprocess
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
FAILED = re.compile(r"^(?:FAILED|ERROR) (.+?)(?: - .*)?$", re.MULTILINE)
LISTED = 4
IGNORED = shutil.ignore_patterns(".git", ".venv", "runs", "__pycache__", ".pytest_cache", ".ruff_cache", "build", "*.egg-info")


@dataclass(frozen=True)
class Fault:
    """``old`` becomes ``new`` in ``file``, where it occurs once; ``tests`` are those of its rooms."""

    what: str
    file: str
    old: str
    new: str
    tests: tuple[str, ...]


PHYSICS = ("tests/physics", "tests/references/test_twisted_ring.py", "tests/references/test_straight_and_twisted.py",
           "tests/references/test_heavy_cantilever.py")
FAULTS = {
    "sign": Fault("a sign in the gradient of bending", "doo_ti/physics/pair.py",
                  "left = (0.0 - t, 0.0 - n * x[0] - t * x[1], t * x[0] - n * x[1])",
                  "left = (0.0 - t, 0.0 - n * x[0] + t * x[1], t * x[0] - n * x[1])", PHYSICS),
    "half": Fault("half the twist energy", "doo_ti/physics/pair.py",
                  "return 4.0 * stiffness[0] * (x[0] * x[0] + x[1] * x[1]) + stiffness[1] * m * m",
                  "return 4.0 * stiffness[0] * (x[0] * x[0] + x[1] * x[1]) + 0.5 * stiffness[1] * m * m", PHYSICS),
    "axes": Fault("B₁₁ and B₂₂ swapped", "doo_ti/physics/pair.py",
                  "return (b[0] * u[0] + b[2] * u[1], b[2] * u[0] + b[1] * u[1])",
                  "return (b[1] * u[0] + b[2] * u[1], b[2] * u[0] + b[0] * u[1])", PHYSICS),
    "weight": Fault("gravity of an edge without its own half of the mass", "doo_ti/relaxation/chain.py",
                    "return length + 2.0 * remaining - 2.0 * rod.total * rod.released",
                    "return 2.0 * remaining - 2.0 * rod.total * rod.released", PHYSICS),
    "hessian": Fault("a term of the Hessian dropped", "doo_ti/physics/pair.py",
                     "return 0.0 - length * dot(c, t)", "return 0.0 * length", PHYSICS),
    "pairs": Fault("Eq. 3 compares with the observation that the rod starts from", "doo_ti/learning/experiment.py",
                   "        observation = pairs.to_index[term]", "        observation = pairs.from_index[term]",
                   ("tests/learning",)),
    "left out": Fault("leave-one-out leaves nothing out", "doo_ti/learning/cross_validation.py",
                      "ends = np.sort(np.where(np.isin(tested, training.ends), tested, -1), axis=1)",
                      "ends = np.sort(np.where(np.isin(tested, training.ends), -1, -1), axis=1)", ("tests/learning",)),
    "lens": Fault("the tangential coefficients of the lens swapped", "doo_ti/vision/cameras.py",
                  "u = x * radial + 2.0 * p1 * x * y + p2 * (square + 2.0 * x * x)",
                  "u = x * radial + 2.0 * p2 * x * y + p1 * (square + 2.0 * x * x)", ("tests/vision",)),
    "turns": Fault("the offsets of Eq. 4 without whole turns", "doo_ti/perception/twist_curves.py",
                   "return angle + 2 * np.pi * np.round((observations.total_twist - angle) / (2 * np.pi))", "return angle",
                   ("tests/perception/test_twist.py", "tests/tools/test_studies.py")),
    "joints": Fault("the total twist of one joint too few", "doo_ti/rod/frames.py",
                    "before, after = quaternions[..., :-1, :], quaternions[..., 1:, :]",
                    "before, after = quaternions[..., :-2, :], quaternions[..., 1:-1, :]",
                    ("tests/oracle", "tests/rod/test_start.py", "tests/lab", "tests/perception/test_twist.py")),
}


def failing(copy: Path, tests: tuple[str, ...], first: bool) -> list[str]:
    """The default tests that fail, of these files and folders; none: of all. ``first``: stops after LISTED of them."""
    words = [sys.executable, "-m", "pytest", "-q", "--tb=no", "-p", "no:cacheprovider", *tests,
             *([f"--maxfail={LISTED}"] if first else [])]
    done = subprocess.run(words, cwd=copy, capture_output=True, text=True, env={**os.environ, "PYTHONPATH": str(copy)})
    if done.returncode not in (0, 1):
        raise SystemExit(f"the tests did not run: {done.stdout[-500:]}{done.stderr[-500:]}")
    return FAILED.findall(done.stdout)


def caught(fault: Fault, whole: bool) -> list[str]:
    with tempfile.TemporaryDirectory() as folder:
        copy = Path(folder) / "copy"
        shutil.copytree(ROOT, copy, ignore=IGNORED)
        file = copy / fault.file
        text = file.read_text(encoding="utf-8")
        if text.count(fault.old) != 1:
            raise SystemExit(f"{fault.file}: the fault ({fault.what}) no longer applies: name the line as it is now")
        file.write_text(text.replace(fault.old, fault.new), encoding="utf-8")
        found = [] if whole else failing(copy, fault.tests, first=True)
        return found or failing(copy, (), first=not whole)


def main(words: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("names", nargs="*", choices=[*FAULTS, []], help="default: all")
    parser.add_argument("--whole", action="store_true", help="all default tests for each fault, to list all that fail")
    options = parser.parse_args(words)
    missed = 0
    print("| fault | caught by |\n|---|---|")
    for name in options.names or FAULTS:
        found = caught(FAULTS[name], options.whole)
        missed += not found
        names = ", ".join(f"`{test}`" for test in (found if options.whole else found[:LISTED]))
        print(f"| {FAULTS[name].what} (`{FAULTS[name].file}`) | {names or '**nothing**'} |", flush=True)
    return int(missed > 0)


if __name__ == "__main__":
    sys.exit(main())
