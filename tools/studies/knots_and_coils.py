"""Rods that touch themselves against theory: overhand knots and a plectoneme.

    python tools/studies/knots_and_coils.py [knots | plectoneme ...] [--edges 200]

Overhand knots without friction (Audoly, Clauvelin and Neukirch 2007), in the limit of small ε = √(h/R): the tension is
F h²/B = ε⁴/2, and the sum of all contact forces P h²/B = 0.492 ε³. h is the rod's radius and R that of the loop, of a circle
fitted to its lower two thirds. Between the knots and the limit are terms of relative size ε.

Strands touch along some 15 ε R, much of it single places far apart. A knot is first relaxed with edges that are fine in the
braid, and then once more with edges that are fine wherever it touches. Without weight a knot may slide along its rod, and turn
about the line through its ends, at no cost: a weight of a fiftieth of the tension, or little more, holds it.

A plectoneme (Clauvelin, Audoly and Neukirch 2009): a rod is turned at one end; where it has coiled up, with the angle α of its
strands to the axis of the coil, F h²/B = sin³α (cos α tan 2α − ½ sin α). Its link, by twist and writhe, is the turns it was
given.
"""

import argparse
import sys
import time
from pathlib import Path

import numpy as np
from scipy.interpolate import CubicSpline

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from doo_ti import Grippers, Itself, Newton, end_clamps, overhand_knot, relax, rod_along, simulate, straight_rod
from doo_ti.contact.surroundings import smallest_self_gap
from doo_ti.dynamics.parameters import Dynamics, Stepping
from doo_ti.rod.frames import turned_about_tangent
from doo_ti.rod.types import Clamp, Clamps, Configuration, Material, Solution
from tests.contact.topology import determinant, link

BEND, RADIUS = 1e5, 1.0
KNOTS = (0.0125, 0.02, 0.05, 0.07, 0.1, 0.15, 0.2, 0.3, 0.4)  # ε to begin with
WEIGHT = 0.02  # of the tension that the limit gives at that ε: the rod's weight, 2 μ L
UP = (0.0, 1.0, 0.0)  # away from the loop
FINEST, SHORTEST, TOUCHING, GROWTH, COARSEST = 0.16, 1.0, 7.6, 0.12, 0.08
"""Edges of the second mesh have the length FINEST ε R, but at least SHORTEST radii, up to TOUCHING ε R from the middle of the
braid. Further away they grow by GROWTH times the distance from there, to COARSEST R."""


def arc_length(vertices: np.ndarray) -> np.ndarray:
    """(V,) mm along a rod (V, 3)."""
    return np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(vertices, axis=0), axis=-1))])


def fitted_radius(vertices: np.ndarray, guess: float) -> float:
    """That of the circle through the lower two thirds of the loop, in the middle of a rod (V, 3)."""
    arc = arc_length(vertices)
    for _ in range(4):
        loop = vertices[np.abs(arc - 0.5 * arc[-1]) < 0.35 * 2.0 * np.pi * guess]
        flat = (loop - loop.mean(axis=0)) @ np.linalg.svd(loop - loop.mean(axis=0))[2][:2].T
        circle = np.linalg.lstsq(np.column_stack([2.0 * flat, np.ones(len(flat))]), (flat**2).sum(axis=1), rcond=None)[0]
        guess = float(np.sqrt(circle[2] + circle[:2] @ circle[:2]))
    return guess


def tied(begin: float, edges: int, weight: float) -> tuple[Solution, Material, Clamps, float]:
    """A knot at rest without friction, its material, its clamps and the radius of its loop, mm; ``edges`` of its first mesh."""
    loop = RADIUS / begin**2
    length = 2.0 * np.pi * 1.1 * loop + 7.0 * np.sqrt(2.0) * loop
    material = Material(BEND, BEND, 0.5 * weight * 0.5 * begin**4 * BEND / (RADIUS**2 * length))
    # The first mesh only shows where the knot touches itself: it need not have come to rest.
    first, _ = relaxed(overhand_knot(length, edges, radius=RADIUS, loop=loop), material)
    found, clamps = relaxed(rod_along(*finely_divided(first, loop)), material)
    if not (found.converged[0] and found.stable[0]) or determinant(found.configuration.vertices[0]) != 3:
        raise SystemExit(f"the knot of ε {begin} has not converged to a certified minimum, or has come undone")
    return found, material, clamps, fitted_radius(found.configuration.vertices[0], loop)


def relaxed(rod: Configuration, material: Material) -> tuple[Solution, Clamps]:
    """A rod whose ends may turn about their tangents, relaxed."""
    clamps = end_clamps(rod, Clamp.TANGENT, Clamp.TANGENT)
    patient = Newton(max_iterations=3000)
    return relax(rod, material, clamps, patient, up=UP, obstacles=[Itself()], radius=RADIUS), clamps


def finely_divided(knot: Solution, loop: float) -> tuple[np.ndarray, np.ndarray]:
    """A smooth curve along a knot, and edges for it that are fine where it touches itself."""
    vertices = knot.configuration.vertices[0]
    arc = arc_length(vertices)
    touching = arc[np.linalg.norm(knot.contact.force[0], axis=-1) > 0.0]
    halves = touching[touching < 0.5 * arc[-1]], touching[touching > 0.5 * arc[-1]]
    braid = np.array([0.5 * (half.min() + half.max()) for half in halves])
    place = np.linspace(0.0, arc[-1], 200_001)
    unit = np.sqrt(RADIUS * loop)  # ε R
    beyond = np.maximum(np.abs(place[:, None] - braid).min(axis=1) - TOUCHING * unit, 0.0)
    finest = max(FINEST * unit, SHORTEST * RADIUS)
    size = np.minimum(finest + GROWTH * beyond, max(COARSEST * loop, finest))
    number = np.concatenate([[0.0], np.cumsum(place[1] * 2.0 / (size[1:] + size[:-1]))])
    ends = np.interp(np.linspace(0.0, number[-1], int(np.ceil(number[-1])) + 1), number, place)
    return CubicSpline(arc, vertices)(place[::10]), np.diff(ends)


def knots(edges: int) -> None:
    """Print the table of knots."""
    print("|  ε | edges | F h²/B over ε⁴/2 | P h²/B over 0.492 ε³ | smallest gap over the diameter | s |\n"
          "|---|---|---|---|---|---|")
    for begin in KNOTS:
        began = time.process_time()
        found, _, _, loop = tied(begin, edges, WEIGHT)
        epsilon = np.sqrt(RADIUS / loop)
        force = np.linalg.norm(found.end_force[0]) * RADIUS**2 / BEND
        pressed = 0.5 * np.linalg.norm(found.contact.force[0], axis=-1).sum() * RADIUS**2 / BEND  # each acts on two strands
        gap = 1.0 + found.contact.gap[0] / (2.0 * RADIUS)
        ratios = f"{force / (0.5 * epsilon**4):.3f} | {pressed / (0.492 * epsilon**3):.3f}"
        taken = time.process_time() - began
        print(f"| {epsilon:.4f} | {found.configuration.edges} | {ratios} | {gap:.5f} | {taken:.0f} |", flush=True)


def plectoneme(edges: int) -> None:
    """Print the table of a plectoneme that grows."""
    length, radius, turns, frames = 1.5 * edges, 1.5, 10.0 * edges / 200, 60
    rod = straight_rod(length, edges)
    material, frame = Material(BEND, 0.7 * BEND, 0.0), rod.frames[:, 0]
    near = np.array([[0.97 * length, 0.0, 0.0]])
    first = Clamps(Clamp.FRAME, Clamp.FRAME, 0.0 * near, near, frame, frame)
    rest = relax(rod, material, first, obstacles=[Itself()], radius=radius)
    share = np.linspace(0.0, 1.0, frames + 1)
    end = near[:, None] + np.minimum(4.0 * share, 1.0)[:, None] * [-0.47 * length, 0.0, 0.0]
    held = np.repeat(frame[:, None], frames + 1, axis=1)
    turned = turned_about_tangent(held, 2.0 * np.pi * turns * share[None])
    grippers = Grippers(Clamp.FRAME, Clamp.FRAME, 0.0 * end, end, held, turned)
    moved = simulate(rest.configuration, material, grippers, Dynamics(density=1.0), Stepping(10.0, quasi_static=True),
                     obstacles=[Itself()], radius=radius)
    print("\n| turns | α | F h²/B over theory | smallest gap over the diameter |\n|---|---|---|---|")
    for at in range(29, frames, 6):
        vertices = moved.positions[0, at]
        middle, tangent = 0.5 * (vertices[1:] + vertices[:-1]), np.diff(vertices, axis=0) / (length / edges)
        apart = np.linalg.norm(middle[:, None] - middle, axis=-1)
        apart[np.abs(np.subtract.outer(np.arange(edges), np.arange(edges))) <= 8] = np.inf
        beside = np.flatnonzero(apart.min(axis=1) < 2.3 * radius)
        if len(beside) < 8:
            continue
        cosine = np.abs((tangent[beside] * tangent[apart[beside].argmin(axis=1)]).sum(axis=-1))
        angle = float(np.median(0.5 * np.arccos(np.minimum(cosine, 1.0))))
        theory = np.sin(angle) ** 3 * (np.cos(angle) * np.tan(2.0 * angle) - 0.5 * np.sin(angle))
        force = np.abs(moved.end_force[0, at, 0]) * radius**2 / BEND
        gap = 1.0 + smallest_self_gap(vertices[None], np.array([radius]))[0] / (2.0 * radius)
        print(f"| {turns * share[at + 1]:.1f} | {np.degrees(angle):.1f}° | {force / theory:.3f} | {gap:.5f} |")
    own = link(moved.positions[0, -1], moved.memory.frames[0])
    print(f"\nlink after {turns:g} turns: {own:.6f}; {int(moved.iterations.sum())} iterations in {frames} steps")
    if not moved.converged[0] or abs(own - turns) > 1e-3:
        raise SystemExit("the plectoneme has not converged, or passed through itself")


TABLES = {"knots": knots, "plectoneme": plectoneme}


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("tables", nargs="*", choices=[*TABLES, []], help="default: both; each takes minutes")
    parser.add_argument("--edges", type=int, default=200)
    options = parser.parse_args()
    for name in options.tables or TABLES:
        TABLES[name](options.edges)
    return 0


if __name__ == "__main__":
    sys.exit(main())
