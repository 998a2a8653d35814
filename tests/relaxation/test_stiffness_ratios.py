"""Rods whose stiffness differs by up to 1e9 along them, across them or between bending and twisting, against a dense Newton's
method in the rotations of joints; and rods of a tenth of a millimetre and of a kilometre."""

from dataclasses import replace

import numpy as np
import pytest

from doo_ti import Clamp, Clamps, Configuration, Group, Material, end_clamps, relax, straight_rod
from tests.groups.reference import nearest_equilibrium
from tests.references.rods import clamps_at, jiggled
from tests.relaxation.rods import wandering

EDGES, LENGTH, SOFT = 24, 240.0, 2e6
RATIOS = (1e0, 1e1, 1e2, 1e3, 1e4, 1e5, 1e6, 1e7, 1e8, 1e9)
SHAPE = 1e-4  # of the length: what a converged rod may be off


def poses() -> tuple[Configuration, list[Clamps]]:
    rod = straight_rod(LENGTH, EDGES)
    both = end_clamps(rod, Clamp.FRAME, Clamp.FRAME)
    turned, aside = np.array([[[0.0, -1, 0], [1, 0, 0], [0, 0, 1]]]), np.array([[[1.0, 0, 0], [0, 0, -1], [0, 1, 0]]])
    held = []
    for start, end, place, frame in (
            (Clamp.FRAME, Clamp.FREE, (LENGTH, 0, 0), None), (Clamp.POSITION, Clamp.POSITION, (150, 0, 40), None),
            (Clamp.FRAME, Clamp.POSITION, (150, 60, -30), None), (Clamp.TANGENT, Clamp.TANGENT, (170, 20, 0), None),
            (Clamp.FRAME, Clamp.FRAME, (140, 80, 0), turned), (Clamp.FRAME, Clamp.FRAME, (200, 0, 30), aside)):
        held.append(replace(both, start=start, end=end, end_position=np.array([place], dtype=float),
                            end_frame=both.end_frame if frame is None else frame @ both.end_frame))
    return rod, held


def material(kind: str, ratio: float) -> Material:
    """Along: a stiff beginning, middle or end, a taper; across: a strip with axes as its frames, or at 30 degrees to them."""
    if kind in ("strip", "turned strip"):
        cosine, sine = (np.cos(0.5), np.sin(0.5)) if kind == "turned strip" else (1.0, 0.0)
        axes = np.array([[cosine, -sine], [sine, cosine]])
        return Material(SOFT * axes @ np.diag([ratio, 1.0]) @ axes.T, SOFT * np.sqrt(ratio))
    if kind in ("twist stiff", "twist soft"):
        return Material(SOFT, SOFT * ratio if kind == "twist stiff" else SOFT / ratio)
    along, third = np.geomspace(ratio, 1.0, EDGES) if kind == "taper" else np.ones(EDGES), EDGES // 3
    if kind != "taper":
        first = ("beginning", "middle", "end").index(kind) * third
        along[first : first + third] = ratio
    return Material(SOFT * along[None, :, None, None] * np.eye(2), SOFT * np.minimum(along[1:], along[:-1])[None])


KINDS = ("beginning", "middle", "end", "taper", "strip", "turned strip", "twist stiff", "twist soft")


def resolved(shape: Configuration, kind: Material, clamps: Clamps) -> np.ndarray:
    """(V, 3) where the dense Newton's method comes to rest that begins at a shape."""
    return nearest_equilibrium(Group([shape], kind, [clamps])).vertices[0]


def off(kind: str, ratio: float, precision: str) -> list[tuple[bool, float]]:
    """Of each pose whether it has converged, and how far it is from the resolved shape, over the length."""
    rod, held = poses()
    found = []
    for clamps in held:
        solution = relax(rod, material(kind, ratio), clamps, precision=precision)
        shape, good = solution.configuration, bool(solution.converged[0])
        apart = resolved(shape, material(kind, ratio), clamps) - shape.vertices[0] if good else np.zeros(3)
        found.append((good, np.linalg.norm(apart, axis=-1).max() / LENGTH))
    return found


@pytest.mark.thorough
@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("precision", ["f64", "mixed", "f32"])
def test_the_soft_part_is_resolved_whatever_the_ratio(kind, precision):
    found = {ratio: off(kind, ratio, precision) for ratio in (RATIOS if precision == "f64" else RATIOS[::4])}
    for ratio, poses_found in found.items():
        print(f"{kind} {precision} {ratio:.0e}:", ", ".join(f"{error:.1e}" if good else "-" for good, error in poses_found))
    assert max(error for row in found.values() for _, error in row) < SHAPE
    assert np.mean([good for row in found.values() for good, _ in row]) > 0.9


SIZED_EDGES, COUNT = 20, 24
SIZES = (1e-3, 0.1, 3.0, 1e3, 1e4)
SAME = 2e-4  # of the length


def sized(rods: Configuration, clamps: Clamps, size: float) -> tuple[Configuration, Clamps]:
    """The same rods and clamps with all lengths times ``size``."""
    grown = Configuration(rods.start * size, rods.quaternions, rods.rest_length * size)
    ends = {name: getattr(clamps, name) * size for name in ("start_position", "end_position")}
    return grown, replace(clamps, **ends)


def problem(rng):
    """Rods of 60 mm, clamps and materials."""
    rods = wandering(rng, COUNT, SIZED_EDGES, 3.0, wander=0.2, twist=0.1)
    return jiggled(rods, rng, 0.05), clamps_at(rods), np.exp(rng.uniform(np.log(1e4), np.log(1e6), (2, COUNT)))


@pytest.mark.parametrize("precision", ["f32", "mixed", "f64"])
def test_shapes_do_not_depend_on_size(rng, precision):
    rods, clamps, (bend, twist) = problem(rng)
    exact = relax(rods, Material(bend, twist), clamps)
    for size in SIZES:
        start, held = sized(rods, clamps, size)
        solution = relax(start, Material(bend * size**3, twist * size**3), held, precision=precision)
        assert (solution.converged == exact.converged).all() and (solution.stable == exact.stable).all()
        assert ((solution.precision == 32) == (precision == "f32")).mean() > 0.9
        off = np.abs(solution.configuration.vertices / size - exact.configuration.vertices).max()
        assert off < SAME * rods.rest_length[0].sum(), size
        np.testing.assert_allclose(solution.energy / size**2, exact.energy, rtol=1e-4)
        scale = np.abs(exact.end_force).max()
        np.testing.assert_allclose(solution.end_force / size, exact.end_force, atol=3e-3 * scale)


@pytest.mark.parametrize("size", [10.0, 100.0])
def test_long_limp_rods_are_right_in_f32_or_left_to_f64(rng, size):
    """The same stiffness over longer rods: rounding limits the residual moments, and f64 finishes the rods."""
    rods, clamps, (bend, twist) = problem(rng)
    start, held = sized(rods, clamps, size)
    exact, single = (relax(start, Material(bend, twist), held, precision=precision) for precision in ("f64", "f32"))
    both = exact.converged & exact.stable & single.converged & single.stable
    apart = np.abs(single.configuration.vertices - exact.configuration.vertices).max(axis=(1, 2)) / start.rest_length.sum()
    same = np.isclose(single.energy, exact.energy, rtol=1e-5)
    assert both.all() and (apart[same] < SAME).all() and same.mean() > 0.8
