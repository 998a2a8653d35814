"""Closed-form derivatives of bending and twist, on packs of lanes as the kernels run them, against hyper-dual numbers.

Hard places: twist next to ±π, joints of 1.5 to 3 rad, off-diagonals of B that differ on the two edges, rest curvature.

The larger of two numbers, the largest lane of a pack, literals, and M = L D Lᵀ of symmetric 3×3 matrices; what of tuples may
be assigned again, on every kind of number; scratch memory by name and by place.
"""

from functools import cache

import numpy as np
import pytest
import taichi as ti
from scipy.spatial.transform import Rotation

from doo_ti.physics import algebra, pair, tuples
from doo_ti.physics.algebra import factor, factor_in_turn, larger
from doo_ti.physics.number import Layout, Number, Scratch, in_f64
from doo_ti.physics.quaternion import twist_angle_function
from doo_ti.physics.tuples import add, choose
from doo_ti.system import runtime
from tests.oracle.algebra import spun_and_tilted
from tests.oracle.pair import pair_energy, pair_gradient_hessian
from tests.physics.columns import ROWS, columns_kernel, every_number
from tests.relaxation.rods import definite

SYMMETRIC = np.array([[0, 1, 2], [1, 3, 4], [2, 4, 5]])


@cache
def pair_kernel(number: Number, isotropic: bool):
    """Rows of (p, q, stiffness) to rows of (energy, 6 gradient entries, 6 + 6 + 9 Hessian entries)."""
    twist_angle = twist_angle_function(number)

    @ti.func
    def function(v: ti.template()):
        x, y, inverse, turn, relative = pair.curvature((v[0], v[1], v[2], v[3]), (v[4], v[5], v[6], v[7]))
        m = twist_angle(relative)
        if ti.static(isotropic):
            s = (v[8], v[9])
            left, right = pair.isotropic_gradient(x, y, inverse, m, s)
            h_left, h_right, h_across = pair.isotropic_hessian(x, y, inverse, turn, m, s)
            return (pair.isotropic_energy(x, m, s),) + left + right + h_left + h_right + h_across
        else:
            s = ((v[8], v[9], v[10]), (v[11], v[12], v[13]), v[14], v[15], (v[16], v[17]), (v[16], v[17]), 0.0)
            left, right = pair.general_gradient(x, y, inverse, turn, m, s)
            h_left, h_right, h_across = pair.general_hessian(x, y, inverse, turn, m, s)
            return (pair.general_energy(x, y, m, s),) + left + right + h_left + h_right + h_across

    return columns_kernel(number, 10 if isotropic else 18, 28, function)


def joints(rng, where: str) -> tuple[np.ndarray, np.ndarray]:
    """(ROWS, 4) frames on both sides of joints; quaternions of either sign."""
    half_turn = rng.choice([-1, 1], ROWS) * (np.pi - 10 ** -rng.uniform(1, 6, ROWS))
    bend, twist = {
        "lab": (rng.uniform(0, 0.3, ROWS), rng.uniform(-0.3, 0.3, ROWS)),
        "1.5 to 3 rad": (rng.uniform(1.5, 3.0, ROWS), rng.uniform(-2, 2, ROWS)),
        "twist next to ±π": (rng.uniform(0, 1, ROWS), half_turn)}[where]
    azimuth = rng.uniform(-np.pi, np.pi, ROWS)
    across = np.stack([0 * azimuth, np.cos(azimuth), np.sin(azimuth)], axis=1)
    first = Rotation.random(ROWS, random_state=rng)
    spin = Rotation.from_rotvec(twist[:, None] * [1.0, 0.0, 0.0])
    second = first * Rotation.from_rotvec(bend[:, None] * across) * spin
    signs = rng.choice([-1.0, 1.0], (2, ROWS, 1))
    return signs[0] * first.as_quat(scalar_first=True), signs[1] * second.as_quat(scalar_first=True)


def unpacked(rows: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Energy (n,), gradient (n, 6) and Hessian (n, 6, 6)."""
    hessian = np.empty((len(rows), 6, 6))
    hessian[:, :3, :3], hessian[:, 3:, 3:] = rows[:, 7:13][:, SYMMETRIC], rows[:, 13:19][:, SYMMETRIC]
    hessian[:, :3, 3:] = rows[:, 19:].reshape(-1, 3, 3)
    hessian[:, 3:, :3] = np.swapaxes(hessian[:, :3, 3:], 1, 2)
    return rows[:, 0], rows[:, 1:7], hessian


def relative_error(value: np.ndarray, expected: np.ndarray) -> float:
    axes = tuple(range(1, expected.ndim))
    return float((np.abs(value - expected).max(axis=axes) / np.abs(expected).max(axis=axes)).max())


@pytest.mark.parametrize("kind", ["isotropic", "general"])
@every_number
def test_pair_on_packs_is_the_oracles(rng, kind, number):
    """To 1e-13 of the largest entry in f64; in f32 to its rounding, the frames being rounded too."""
    fill = pair_kernel(number, kind == "isotropic")
    for where in ("lab", "1.5 to 3 rad", "twist next to ±π"):
        q0, q1 = joints(rng, where)
        lengths, twist = rng.uniform(1, 5, (2, ROWS)), rng.uniform(1e4, 1e6, ROWS)
        total, alpha = lengths.sum(axis=0), rng.uniform(1e4, 1e6, ROWS)
        if kind == "isotropic":
            bend, rest = np.broadcast_to(alpha[:, None, None] * np.eye(2), (2, ROWS, 2, 2)), np.zeros((ROWS, 2))
            stiffness = np.column_stack([alpha / total, twist / total])
        else:
            bend, rest = definite(rng, 2, ROWS), 0.05 * rng.normal(size=(ROWS, 2))
            entries = [bend[side][:, a, b] for side in (0, 1) for a, b in ((0, 0), (1, 1), (0, 1))]
            stiffness = np.column_stack([*entries, 1 / total, twist / total, 0.5 * total[:, None] * rest])
        energy, gradient, hessian = unpacked(fill(np.hstack([q0, q1, stiffness])))
        arguments = (q0, q1, *lengths, *bend, twist, rest)
        expected = pair_gradient_hessian(*arguments, turned=spun_and_tilted)
        errors = [np.abs(energy / pair_energy(*arguments) - 1).max(),
                  relative_error(gradient, expected[0]), relative_error(hessian, expected[1])]
        assert max(errors) < (1e-13 if number.bits == 64 else 1e-5)


LITERALS = (0.1, 1 / 3, 1e-30, 2.0 / 7.0, 1e-13, -0.3)


@every_number
def test_the_largest_lane_is_that_of_numbers_and_literals_are_exact(rng, number):
    """The default precision of Taichi is f32: a literal in f64 must not pass through it."""
    width, scalar = number.width, number.scalar

    @ti.func
    def spread(v: ti.template()):
        one = number.constant(1.0)
        return (number.constant(number.largest(v[0])), one * scalar(LITERALS[0]), one * scalar(LITERALS[1]),
                one * scalar(LITERALS[2]), one * scalar(LITERALS[3]), one * scalar(LITERALS[4]), one * scalar(LITERALS[5]))

    values = rng.normal(size=(ROWS, 1)).astype(np.float32).astype(float)
    # In every pack one lane stays a number, each in turn.
    nan = rng.random(ROWS) < 0.5
    nan[np.arange(ROWS // width) * width + np.arange(ROWS // width) % width] = False
    values[nan] = np.nan
    found = columns_kernel(number, 1, 7, spread)(values)
    np.testing.assert_array_equal(found[:, 0], np.repeat(np.nanmax(values.reshape(-1, width), axis=1), width))
    exact = np.array(LITERALS, dtype=np.float32 if number.bits == 32 else np.float64)
    assert (np.abs(found[:, 1:] - exact) <= np.spacing(np.abs(exact))).all()


@every_number
def test_the_larger_number_is_nan_where_either_is(number):
    @ti.func
    def function(v: ti.template()):
        return (larger(v[0], v[1]),)

    values = np.tile([[1.0, np.nan], [np.nan, 1.0], [2.0, 1.0], [1.0, 2.0]], (ROWS // 4, 1))
    found = columns_kernel(number, 2, 1, function)(values)[:, 0]
    np.testing.assert_array_equal(found, np.tile([np.nan, np.nan, 2.0, 2.0], ROWS // 4))


UPPER = np.triu_indices(3)


def product(f: np.ndarray) -> np.ndarray:
    """(N, 6) entries of L D Lᵀ for factors (N, 7)."""
    lower = np.tile(np.eye(3), (len(f), 1, 1))
    lower[:, 1, 0], lower[:, 2, 0], lower[:, 2, 1] = f[:, 3:6].T
    return np.einsum("nij,nj,nkj->nik", lower, 1.0 / f[:, :3], lower)[:, *UPPER]


@pytest.mark.parametrize("number", [Number(1, 64), Number(8, 64)], ids=lambda number: f"{number.width} x f{number.bits}")
def test_both_factor_and_only_the_second_keeps_small_pivots(rng, number):
    @ti.func
    def both(v: ti.template()):
        m = (v[0], v[1], v[2], v[3], v[4], v[5])
        return factor(m, 1e-30) + factor_in_turn(m)

    kernel = columns_kernel(number, 6, 14, both)
    matrices = rng.normal(size=(ROWS, 6))
    found = kernel(matrices)
    for own in (found[:, :7], found[:, 7:]):
        np.testing.assert_allclose(product(own), matrices, atol=1e-12)
        full = np.zeros((ROWS, 3, 3))
        full[:, *UPPER] = full.swapaxes(1, 2)[:, *UPPER] = matrices
        np.testing.assert_array_equal(own[:, 6], (np.linalg.eigvalsh(full) < 0).sum(axis=1))
    # A vertex that nothing but a plane holds.
    slippery = np.tile([1e-16, 0.0, 0.0, 1e-16, 0.0, 0.3], (ROWS, 1))
    by_products, in_turn = np.split(kernel(slippery), 2, axis=1)
    np.testing.assert_allclose(in_turn[:, :3], [[1e16, 1e16, 1 / 0.3]] * ROWS, rtol=1e-12)
    assert by_products[0, 2] < 1e-3


@every_number
def test_a_variable_takes_its_own_items_in_another_order(rng, number):
    """All are read before the first is changed, written out or by a function of the algebra, and in loops."""
    @ti.func
    def function(v: ti.template()):
        a = tuples.variable((v[0], v[1], v[2]))
        b = tuples.variable((v[0], v[1], v[2]))
        m = tuples.variable((v[0], v[1], v[2], v[3], v[4], v[5], v[6], v[7], v[8]))
        for _ in range(2):
            a = (a[1], a[2], a[0])
            b = tuples.plus((b[1], b[2], b[0]), b)
        m = algebra.transposed(m)
        c = tuples.variable((v[0], v[1], v[2]))
        c = tuples.itemwise(c[0] + c[0], c[1], 3.0 * c[2])
        return a + b + m + c

    x = rng.uniform(-1, 1, (ROWS, 9)).astype(np.float32).astype(np.float64)
    turned = x[:, :3] + x[:, [1, 2, 0]]
    expected = np.hstack([x[:, [2, 0, 1]], turned + turned[:, [1, 2, 0]], x[:, [0, 3, 6, 1, 4, 7, 2, 5, 8]],
                          x[:, :3] * [2, 1, 3]])
    rounding = np.finfo(np.float32 if number.bits == 32 else np.float64).eps
    np.testing.assert_allclose(columns_kernel(number, 9, 18, function)(x), expected, rtol=0, atol=4 * rounding)


PAIR = Layout(first=2, second=2)
ROD = Layout(length=1, place=3, pair=PAIR, both=("length", 4))
EDGES = 3


@pytest.mark.parametrize("stride", [1, 4])
@pytest.mark.parametrize("number", [Number(1, 64), Number(8, 64), Number(16, 32)], ids=str)
def test_numbers_are_read_and_written_by_name(number, stride):
    runtime.start()
    memory, width = Scratch(number, stride), number.width

    @ti.kernel
    def work(array: ti.types.ndarray(dtype=number.type, ndim=1), seen: ti.types.ndarray(dtype=ti.f64, ndim=1)):
        for thread in range(1):
            head = memory.of_thread(array, thread, ROD, EDGES * ROD.size)
            for e in range(EDGES):
                edge = head.part(ROD, e * ROD.size)
                for slot in range(width):
                    lane = edge.lane(slot)
                    lane.length, lane.place = 1.0 + e, (2.0, 3.0 + e, 4.0)
                    lane[4], lane.pair.first[1], lane.pair.second = 5.0, 6.0, (7.0, 8.0)
                edge.pair.first = edge.pair.second  # what is on the right is read first
                add(edge, length=0.0 * edge.length + 10.0, place=edge.place)
                choose(edge.pair, edge.length > 11.5, second=edge.pair.first)
                before = edge.place
                edge.place = (before[2], before[0], before[1])
            last = head.part(ROD, (EDGES - 1) * ROD.size).lane(width - 1)
            for k in range(ROD.size):
                seen[k] = last[k]
            place = in_f64(last.place)
            for k in ti.static(range(3)):
                seen[ROD.size + k] = place[k]

    array = ti.ndarray(number.type, EDGES * len(ROD) * stride)
    seen = np.zeros(len(ROD) + 3)
    work(array, seen)
    assert seen.tolist() == [13.0, 8.0, 4.0, 10.0, 7.0, 8.0, 7.0, 8.0, 8.0, 4.0, 10.0]
