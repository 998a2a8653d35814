"""Random groups of three rods: how many converge, how near their rods come to each other, and how long they take.

    python tools/studies/group_study.py [--groups 400] [--seed 0]

The rods hang between random points, in a box of 80 mm, and are longer by 5 to 50 % than their ties need. Before they are
relaxed, points to be tied are where the rods hang alone, some 70 mm apart. With contact a tie may lie behind another rod that
is held on both sides: such a group can have no solution, and counts as one that has not converged. Gaps are measured in
NumPy, apart from the engine.
"""

import argparse
import sys
import time
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from doo_ti import Clamp, Group, Material, Status, Tie, hanging, relax_group

EDGES, RADIUS = 20, 1.0
TIES = [Tie((0, 10), (1, 6)), Tie((1, 14), (2, 8))]


def drawn(rng, count: int, clamp: Clamp, tied: bool) -> Group:
    """``count`` random groups."""
    first, second = rng.uniform(-20, 20, (2, count, 3))
    start, end = rng.uniform(-40, 40, (2, 3, count, 3))

    def reach(a, b, edges):
        return EDGES / edges * np.linalg.norm(a - b, axis=1)

    needed = [
        np.maximum(reach(start[0], first, 10), reach(first, end[0], 10)),
        np.maximum(reach(start[1], first, 6), np.maximum(reach(first, second, 8), reach(second, end[1], 6))),
        np.maximum(reach(start[2], second, 8), reach(second, end[2], 12))]
    length = np.array(needed) * rng.uniform(1.05, 1.5, (3, count)) + 3.0
    rods, clamps = zip(*(hanging(length[rod], EDGES, start[rod], end[rod], clamp=clamp) for rod in range(3)), strict=True)
    material = Material(10 ** rng.uniform(4.0, 6.0, count), 10 ** rng.uniform(4.0, 6.0, count))
    return Group(rods, material, clamps, TIES if tied else [])


def main(arguments: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--groups", type=int, default=400)
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args(arguments)
    rng = np.random.default_rng(options.seed)
    entered = 0
    for name, tied, radius in (("tied", True, None), ("in contact", False, RADIUS), ("tied and in contact", True, RADIUS)):
        for clamp in (Clamp.POSITION, Clamp.FRAME):
            group = drawn(rng, options.groups, clamp, tied)
            relax_group(group.take(np.arange(min(16, group.count))), radius=radius)  # compiles, or loads, the kernel
            began = time.perf_counter()
            solution = relax_group(group, radius=radius)
            spent = 1e3 * (time.perf_counter() - began) / options.groups
            sound = solution.status != Status.INFEASIBLE
            good = solution.converged
            gap = np.min(solution.gap[good], initial=np.inf)
            entered += int((solution.gap[good] < -1e-3 * RADIUS).sum())
            print(f"{name}, {clamp.name.lower()} clamps: {100 * good[sound].mean():.1f} % of {sound.sum()} converge, "
                  f"{100 * solution.stable[sound].mean():.1f} % certified; median {np.median(solution.iterations[sound]):.0f} "
                  f"iterations, {spent:.1f} ms each; smallest gap {gap / RADIUS:.1e} radii")
    return int(entered > 0)


if __name__ == "__main__":
    sys.exit(main())
