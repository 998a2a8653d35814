"""Benchmark of relaxations: ``python tools/bench/relaxation.py [CASE ...] [--rounds N] [--check | --write]``.

Prints one table: rods/s, the ratio to a NumPy workload timed in the same round, and that ratio over the baseline's.
``--check`` exits with 1 where a ratio is below half the baseline or fewer rods converge; ``--write`` makes a new
baseline, on an idle machine.
"""

import sys
from pathlib import Path

if not __package__:
    sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from doo_ti.bench.cases import Specimens  # noqa: E402
from tools.bench.against_baseline import Benchmark, run  # noqa: E402
from tools.bench.cases import cases  # noqa: E402

BASELINE = Path(__file__).with_name("baseline.json")


def main(arguments: list[str]) -> int:
    benchmark = Benchmark("relaxation.py", __doc__.splitlines()[0], BASELINE, "rods", 65_536, 1,
                          lambda rods: cases(Specimens(rods)))
    return run(benchmark, arguments)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
