"""Random motions of rods through clutter: how many converge, whether any enters an obstacle, whether any passes through a peg.

    python tools/contact_motions.py [--motions 10000] [--seed 0] [--precision f64] [--itself]

Both ends of every rod are held by grippers that move and turn smoothly at random above a table with pegs, without inertia and
with friction. Motions whose grippers would carry an end into a peg or the table, or whose rod begins inside one, cannot be
made: they are counted apart, and others are drawn. Checked apart from the engine: gaps at 16 places along every edge, and for
every peg how often, by sense, its axis pierces the surface that the rod sweeps from one frame to the next.

``--itself``: rods are their own obstacles, and the grippers bring their ends together and turn them by up to one and a half
turns, so that many coil up. Checked besides: the gap of all pairs of edges, and the writhe of the rod's own edges, which jumps
by two from one frame to the next where a rod passes through itself. It changes by nearly as much where a loop slips over an end
of the rod, past the gripper, which has no body: these are counted apart, by where along the rod edges would have crossed.
"""

import argparse
import sys
import time
from collections import Counter
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from doo_ti import Capsule, Dynamics, Grippers, Itself, Plane, Stepping, relax, simulate
from doo_ti.contact.surroundings import smallest_self_gap
from doo_ti.rod.frames import matrix_from_quaternion, quaternion_about, quaternion_product
from doo_ti.rod.types import Clamp, Clamps, Configuration, Material, Status
from tests.contact.topology import solid_angles

LENGTH, EDGES, RADIUS, FRAMES = 100.0, 33, 0.5, 40
TABLE = Plane((0, 0, 0), (0, 0, 1), friction=0.2)
PEGS = (((30, -18), 2.0), ((50, -25), 3.0), ((70, -18), 2.0))  # places of upright pegs, mm, and their radii
HEIGHT = 120.0
"""Of the pegs, mm: no rod gets over them. One that snaps over the top of a peg from one frame to the next could not be told
from one that has passed through it."""
AT_ONCE = 1000
SLIP = 9  # edges from an end: how far a loop may slide along the rod within a frame


def obstacles() -> list:
    return [TABLE, *(Capsule((x, y, -5.0), (x, y, HEIGHT), radius, friction=0.2) for (x, y), radius in PEGS)]


def drawn(rng, count: int, coiling: bool):
    """(rods at rest beside the pegs, materials, grippers that carry them towards and past the pegs), with their ends brought
    together and turned if they are ``coiling``."""
    one = Configuration.straight(np.array([0.0, 20.0, 15.0]), np.array([1.0, 0.0, 0.0]), LENGTH, EDGES)
    frames = np.repeat(one.frames[:, 0], count, 0)
    start = np.repeat(one.start, count, 0)
    end = start + np.stack([rng.uniform(40, 70, count), rng.uniform(-5, 5, count), rng.uniform(-5, 5, count)], -1)
    clamps = Clamps(Clamp.FRAME, Clamp.FRAME, start, end, frames, frames)
    material = Material(10 ** rng.uniform(4.0, 6.0, count), 10 ** rng.uniform(4.5, 6.0, count))
    rods = Configuration(start, np.repeat(one.quaternions, count, 0), one.rest_length)
    rest = relax(rods, material, clamps, up=(0.0, -1.0, -0.2)).configuration
    rest = relax(rest, material, clamps, obstacles=obstacles(), radius=RADIUS)
    share = np.linspace(0.0, 1.0, FRAMES + 1)[:, None]
    smooth = share**2 * (3.0 - 2.0 * share)
    grippers = []
    for place in (start, end):
        move = np.stack([rng.uniform(-10, 10, count), rng.uniform(-40, -10, count), rng.uniform(-8, 15, count)], -1)
        axis = rng.normal(size=(count, 3))
        axis /= np.linalg.norm(axis, axis=1, keepdims=True)
        turn = quaternion_about(axis[:, None], rng.uniform(0, 0.8, (count, 1)) * smooth[None, :, 0])
        if coiling:
            along = np.broadcast_to([1.0, 0.0, 0.0], (count, 1, 3))
            turns = quaternion_about(along, rng.uniform(-3 * np.pi, 3 * np.pi, (count, 1)) * smooth[None, :, 0])
            turn = quaternion_product(turn, turns)
            move[:, 0] = rng.uniform(-5, 5, count) + 0.35 * (0.5 * (start + end) - place)[:, 0]
        first = np.broadcast_to(one.quaternions[:, :1], turn.shape)
        grippers.append((place[:, None] + move[:, None] * smooth, matrix_from_quaternion(quaternion_product(turn, first))))
    return rest, material, Grippers(Clamp.FRAME, Clamp.FRAME, grippers[0][0], grippers[1][0], grippers[0][1], grippers[1][1])


def smallest_gap(x: np.ndarray, places_an_edge: int = 17) -> np.ndarray:
    """(R,) mm: of rods (R, V, 3) and the obstacles."""
    s = np.linspace(0.0, 1.0, places_an_edge)[:, None]
    places = (x[..., :-1, None, :] * (1.0 - s) + x[..., 1:, None, :] * s).reshape(len(x), -1, 3)
    return np.min([obstacle.distance(places)[0].min(axis=1) for obstacle in obstacles()], axis=0) - RADIUS


def held_gap(grippers: Grippers) -> np.ndarray:
    """(R,) mm, the smallest of the edges that the grippers hold, in any frame."""
    edge = LENGTH / EDGES
    start, end = grippers.start_position, grippers.end_position
    first, last = (np.stack([place, place + along * frames[..., 0]], axis=2) for place, along, frames in (
        (start, edge, grippers.start_frame), (end, -edge, grippers.end_frame)))
    return smallest_gap(np.concatenate([first, last], axis=1), 9)


def pierced(before: np.ndarray, after: np.ndarray) -> np.ndarray:
    """(R,) whether a peg is on another side of the rod after two frames (R, V, 3) than before: its axis pierces the triangles
    that the edges sweep more often in one sense than in the other. A rod that snaps may sweep over it and back."""
    found = np.zeros(len(before), dtype=bool)
    for (x, y), _ in PEGS:
        foot, along, count = np.array([x, y, 0.0]), np.array([0.0, 0.0, HEIGHT]), 0
        for a, b, c in ((before[:, :-1], before[:, 1:], after[:, :-1]), (before[:, 1:], after[:, 1:], after[:, :-1])):
            side1, side2 = b - a, c - a
            normal = np.cross(along, side2)
            volume = np.einsum("rea,rea->re", side1, normal)
            safe = np.where(np.abs(volume) < 1e-12, np.inf, volume)
            away = foot - a
            u = np.einsum("rea,rea->re", away, normal) / safe
            q = np.cross(away, side1)
            v = np.einsum("a,rea->re", along, q) / safe
            t = np.einsum("rea,rea->re", side2, q) / safe
            hit = (u >= 0) & (v >= 0) & (u + v <= 1) & (t >= 0) & (t <= 1)
            count = count + (np.sign(volume) * hit).sum(axis=1)
        found |= count != 0
    return found


def crossings(x: np.ndarray) -> np.ndarray:
    """(R, P) of rods (R, V, 3), whose ends are not joined, the part in the writhe of all pairs of edges."""
    i, j = np.triu_indices(x.shape[1] - 1, 2)
    return solid_angles(x[:, i], x[:, i + 1], x[:, j], x[:, j + 1]) / (2.0 * np.pi)


def passed(before: np.ndarray, after: np.ndarray) -> tuple[int, int]:
    """Of rods (R, V, 3) at two frames, how many have passed through themselves, and how many have slipped over one of their
    ends: on the straight way edges within :data:`SLIP` of it cross."""
    change = np.abs((crossings(after) - crossings(before)).sum(axis=1))
    through = slipped = 0
    edges = before.shape[1] - 1
    i, j = np.triu_indices(edges, 2)
    from_end = np.minimum(i, edges - 1 - j)
    for rod in np.flatnonzero(change > 1.5):
        share = np.linspace(0.0, 1.0, 401)[:, None, None]
        way = crossings(before[rod] * (1.0 - share) + after[rod] * share)
        crossed = (np.abs(np.diff(way, axis=0)) > 0.5).any(axis=0)
        over_end = (from_end[crossed] < SLIP).all()
        through, slipped = through + int(not over_end), slipped + int(over_end)
    return through, slipped


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--motions", type=int, default=10_000)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--precision", choices=("f64", "f32", "mixed"), default="f64")
    parser.add_argument("--itself", action="store_true", help="rods are their own obstacles and coil up")
    options = parser.parse_args()
    bodies = [*obstacles(), Itself(friction=0.2)] if options.itself else obstacles()
    rng = np.random.default_rng(options.seed)
    total = Counter(motions=0, converged=0, touching=0, coiled=0, slipped=0, inside=0, through=0, steps=0, impossible=0)
    least, trips, began = np.inf, 0, time.process_time()
    stepping = Stepping(rate=10.0, quasi_static=True, precision=options.precision)
    while total["motions"] < options.motions:
        rest, material, grippers = drawn(rng, AT_ONCE, options.itself)
        possible = (rest.status != Status.INFEASIBLE) & (held_gap(grippers) > 0)
        chosen = np.flatnonzero(possible)[: options.motions - total["motions"]]
        rows = chosen[rest.converged[chosen]]
        start = rest.configuration.take(rows)
        moved = simulate(start, material.take(rows), grippers.take(rows), Dynamics(), stepping, obstacles=bodies, radius=RADIUS)
        x = np.concatenate([start.vertices[:, None], moved.positions], axis=1)
        standing, coiled = moved.status == Status.CONVERGED, np.zeros(len(rows), dtype=bool)
        touching = (np.abs(moved.contact_force) > 0).any(axis=(1, 2, 3))
        total.update(motions=len(chosen), converged=int(moved.converged.sum()), touching=int(touching.sum()),
                     steps=int(standing.sum()), impossible=int((~possible).sum()))
        trips += int(moved.iterations.sum())
        for frame in range(1, FRAMES + 1):
            now = standing[:, frame - 1]
            before, after = x[now, frame - 1], x[now, frame]
            gap = smallest_gap(after)
            if options.itself:
                own = smallest_self_gap(after, np.full(now.sum(), RADIUS))
                coiled[now] |= own < 1e-2 * RADIUS
                gap = np.minimum(gap, own)
                through, slipped = passed(before, after)
                total.update(through=through, slipped=slipped)
            least = min(least, gap.min(initial=np.inf))
            total.update(inside=int((gap < -1e-3 * RADIUS).sum()), through=int(pierced(before, after).sum()))
        total["coiled"] += int(coiled.sum())
        print(f"{total['motions']:6d} motions: {dict(total)}, smallest gap {least / RADIUS:.2e} radii, "
              f"{trips / max(total['steps'], 1):.1f} iterations a step, {time.process_time() - began:.0f} s of processor time",
              flush=True)
    print(f"seed {options.seed}; converged {total['converged'] / total['motions']:.2%}")
    return int(total["inside"] + total["through"] > 0)


if __name__ == "__main__":
    sys.exit(main())
