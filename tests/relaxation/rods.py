"""Random rods to relax, bit-for-bit comparison of solutions, and rods of the virtual lab."""

import json
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from doo_ti import Newton, Observations, load_observations, observation_clamps, relax, start_configuration
from doo_ti.rod.frames import rotation_matrix, tilt_axes
from doo_ti.rod.types import Clamp, Clamps, Configuration, Material, Solution
from tests.references.rods import chain, clamps_at, stacked

PAIRS = [(start, end) for start in Clamp for end in Clamp if (start, end) != (Clamp.FREE, Clamp.FREE)]
LOADS = ("start_force", "start_moment", "end_force", "end_moment")
RESULTS = ("energy", "residual", "closure", "iterations", "status", "stable", "end_force", "precision")


def wandering(rng, count: int, edges: int, rest_length=3.0, wander: float = 0.15, twist: float = 0.1) -> Configuration:
    """Rods whose direction wanders by ``wander`` rad a joint and whose frames twist by ``twist``, anywhere in space."""
    rods = []
    for _ in range(count):
        tangents = rng.normal(size=3) + wander * rng.normal(size=(edges, 3)).cumsum(axis=0)
        tangents /= np.linalg.norm(tangents, axis=1, keepdims=True)
        spin = twist * rng.normal(size=edges).cumsum()
        m1, place = np.cross(tangents[0], rng.normal(size=3)), 20 * rng.normal(size=3)
        rods.append(chain(tangents, m1, rest_length, place, spin))
    return stacked(rods)


def one_of_three_at_rest(rng) -> Solution:
    """Three rods: one at a minimum, one whose clamps are out of its reach, and one that is not certified."""
    rods = wandering(rng, 1, 12).take([0, 0, 0])
    clamps = clamps_at(rods)
    clamps.end_position[1] += 1000.0
    solution = relax(rods, Material(1e5, 1e5), clamps)
    return replace(solution, stable=solution.stable & [True, True, False])


def definite(rng, *shape: int, scale: float = 2e5) -> np.ndarray:
    """(*shape, 2, 2) symmetric positive definite B of about ``scale``, with an off-diagonal."""
    root = rng.normal(size=(*shape, 2, 2))
    return scale * (root @ np.swapaxes(root, -1, -2) / 2 + 0.5 * np.eye(2))


def with_kinds(clamps: Clamps, kinds: list[tuple[Clamp, Clamp]]) -> Clamps:
    """The same clamps with a pair of kinds for each rod."""
    start, end = np.array(kinds).T
    return Clamps(start, end, clamps.start_position, clamps.end_position, clamps.start_frame, clamps.end_frame)


def assert_same(first: Solution, rows, second: Solution, other_rows) -> None:
    """Those rods of both solutions agree in every bit; NaN equals NaN."""
    for name in RESULTS:
        np.testing.assert_array_equal(getattr(first, name)[rows], getattr(second, name)[other_rows], err_msg=name)
    a, b = first.configuration, second.configuration
    for name in ("quaternions", "start"):
        np.testing.assert_array_equal(getattr(a, name)[rows], getattr(b, name)[other_rows])


BENDS = {"bend": np.eye(2), "bend_1": np.diag([1.0, 0.0]), "bend_2": np.diag([0.0, 1.0]), "bend_12": np.eye(2)[::-1]}


def relaxed_again(solution: Solution, material: Material, clamps: Clamps, solver: Newton, column: str, amount: float, *, up,
                  **around) -> Solution:
    """The rods, relaxed from a solution on, after a change by ``amount`` along a ``column`` of their sensitivity."""
    name, _, axis = column.rstrip("]").partition("[")
    rods, change = solution.configuration, amount * np.eye(3)[int(axis or 0)]
    if name in BENDS:
        material = replace(material, bend=material.bend + amount * BENDS[name])
    elif name == "rest_curvature":
        material = replace(material, rest_curvature=change[:2] + (0.0 if material.rest_curvature is None else
                                                                  material.rest_curvature))
    elif name in ("twist", "weight"):
        material = replace(material, **{name: getattr(material, name) + amount})
    elif name == "up":
        up = rotation_matrix(amount * tilt_axes(up)[int(axis)]) @ up
    elif name == "length":
        rods = replace(rods, rest_length=rods.rest_length * np.exp(amount))
    else:
        end, kind = name.split("_")
        field = f"{end}_position" if kind == "shift" else f"{end}_frame"
        held = getattr(clamps, field)
        clamps = replace(clamps, **{field: held + change if kind == "shift" else rotation_matrix(change) @ held})
    return relax(rods, material, clamps, replace(solver, first_shift=0.0), up=up, **around)


SUTURES = ("nylon", "vicryl", "silk")
RIBBON_WIDTH = 6.7  # mm, w_m of Eq. 1


@dataclass(frozen=True)
class Lab:
    """One rod of the virtual lab: observations, clamps and starts share their rows."""

    observations: Observations
    clamps: Clamps
    start: Configuration
    material: Material


def lab(folder: Path, name: str) -> Lab:
    """``name`` of ``lab_a`` below the folder of development data."""
    observations = load_observations(folder / "lab_a" / f"{name}.npz")
    truth = json.loads((folder / "lab_a" / "truth.json").read_text())[name]
    clamps = observation_clamps(observations)
    material = Material(np.array(truth["bend"]), truth["twist"], truth["weight"])
    return Lab(observations, clamps, start_configuration(observations, clamps), material)


def vertex_distance(first: Configuration, second: Configuration) -> np.ndarray:
    """(R,) mean distance of corresponding vertices, mm: two minima are the same below 0.02."""
    return np.linalg.norm(first.vertices - second.vertices, axis=2).mean(axis=1)
