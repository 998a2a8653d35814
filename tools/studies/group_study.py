"""Random groups of three rods: how many converge, how near their rods come to each other, and how long they take; at rest, and
while clamps move and the rods rub on each other.

    python tools/studies/group_study.py [--groups 400] [--seed 0]

The rods hang between random points, in a box of 80 mm, and are longer by 5 to 50 % than their ties need. Before they are
relaxed, points to be tied are where the rods hang alone, some 70 mm apart. With contact a tie may lie behind another rod that
is held on both sides: such a group can have no solution, and counts as one that has not converged. Gaps are measured in
NumPy, apart from the engine. Where clamps move, those of each rod move by some 15 mm in a random direction.
"""

import argparse
import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from doo_ti.contact.itself import Itself  # noqa: E402
from doo_ti.contact.touch import Touch  # noqa: E402
from doo_ti.groups.follow import follow_group  # noqa: E402
from doo_ti.groups.group import Group, Tie  # noqa: E402
from doo_ti.groups.relax_group import relax_group  # noqa: E402
from doo_ti.rod.material import Material  # noqa: E402
from doo_ti.rod.straight import hanging  # noqa: E402
from doo_ti.rod.types import Clamp, Status  # noqa: E402

EDGES, RADIUS = 20, 1.0
TIES = [Tie((0, 10), (1, 6)), Tie((1, 14), (2, 8))]
MOMENTS, MOVED = 12, 10.0
"""Of a motion; and mm, the deviation of each coordinate of its displacement."""


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


def one(group: Group) -> str:
    """How long a single group takes, and in how many iterations."""
    single = group.take([0])
    relax_group(single, radius=RADIUS)
    began = time.perf_counter()
    solution = relax_group(single, radius=RADIUS)
    spent = 1e3 * (time.perf_counter() - began)
    return f"alone {spent:.0f} ms in {solution.iterations[0]} iterations"


def dragged(rng, count: int, coefficient: float) -> str:
    """How many of ``count`` groups converge at how many moments of a motion with that friction."""
    group = drawn(rng, count, Clamp.POSITION, False)
    ways = MOVED * rng.normal(size=(len(group.clamps), count, 3))
    moments = []
    for share in np.linspace(0.0, 1.0, MOMENTS + 1):
        moments.append([replace(clamps, start_position=clamps.start_position + share * way,
                                end_position=clamps.end_position + share * way)
                        for clamps, way in zip(group.clamps, ways, strict=True)])
    began = time.perf_counter()
    found = list(follow_group(group, moments, obstacles=[Itself(friction=coefficient)], radius=RADIUS))
    spent = 1e3 * (time.perf_counter() - began) / (count * len(found))
    sound = np.all([solution.status != Status.INFEASIBLE for solution in found], axis=0)
    good = np.array([solution.converged for solution in found])[:, sound]
    touch = np.array([np.concatenate(solution.touch, axis=1) for solution in found])[:, sound]
    slipping, sticking = ((touch == kind).any(axis=2)[good].mean() for kind in (Touch.SLIPS, Touch.STICKS))
    gap = min(np.min(solution.gap[solution.converged], initial=np.inf) for solution in found)
    return (f"of {sound.sum()} groups {100 * good.mean():.1f} % of moments converge; a rod sticks in "
            f"{100 * sticking:.0f} %, slips in {100 * slipping:.0f} %; {spent:.1f} ms each; "
            f"smallest gap {gap / RADIUS:.1e} radii")


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
                  f"iterations, {spent:.1f} ms each; smallest gap {gap / RADIUS:.1e} radii; {one(group)}")
    for coefficient in (0.0, 0.2, 0.5):
        print(f"clamps move, friction {coefficient:g}: {dragged(rng, options.groups // 4, coefficient)}")
    return int(entered > 0)


if __name__ == "__main__":
    sys.exit(main())
