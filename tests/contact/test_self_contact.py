"""Rods that touch themselves keep their distance, are in equilibrium, and never pass through themselves."""

from dataclasses import replace
from itertools import accumulate

import numpy as np
import pytest
import taichi as ti

from doo_ti import Clamp, Clamps, Configuration, Material, Newton, Status, relax
from doo_ti.contact.surroundings import Itself, edge_distance, smallest_self_gap
from doo_ti.physics.tuples import record
from doo_ti.relaxation.pair_distance import pair_block, pair_distance, pair_slopes, pair_weights
from doo_ti.relaxation.self_approach import approach_in_motion, approach_in_relaxation, stays_in_order
from doo_ti.relaxation.tables import whole_start
from doo_ti.rod.frames import matrix_from_quaternion, quaternion_of_turn, quaternion_product
from doo_ti.rod.shapes import end_clamps, overhand_knot, rod_along, straight_rod
from doo_ti.system import runtime
from tests.conftest import check_refused
from tests.contact.topology import determinant, link
from tests.oracle.external import where_found
from tests.references.rods import certified
from tools.studies.knots_and_coils import WEIGHT, tied

RADIUS, STIFFNESS = 1.0, 1e5


def test_distances_of_edges_and_gaps_of_rods_without_places_and_of_short_ones(rng):
    """Against the least of the distances between many places on both edges."""
    w, p, q = rng.normal(size=(3, 60, 3))
    p[:20] = q[:20] * rng.uniform(-2.0, 2.0, (20, 1))
    share = np.linspace(0.0, 1.0, 201)
    s, t = share[:, None, None, None], share[None, :, None, None]
    places = np.sqrt((((w + t * q) - s * p) ** 2).sum(axis=-1)).min(axis=(0, 1))
    found = edge_distance(w, p, q)
    assert (found <= places + 1e-12).all() and np.abs(found - places).max() < 0.02
    assert np.isnan(smallest_self_gap(np.full((1, 8, 3), np.nan), np.array([1.0]))).all()
    assert np.isinf(smallest_self_gap(straight_rod(10.0, 2).vertices, np.array([1.0]))).all()


@ti.kernel
def evaluate(ends: ti.types.ndarray(dtype=ti.f64, ndim=3), even: ti.f64, distance: ti.types.ndarray(dtype=ti.f64, ndim=1),
             gradient: ti.types.ndarray(dtype=ti.f64, ndim=2), hessian: ti.types.ndarray(dtype=ti.f64, ndim=3)):
    for n in range(ends.shape[0]):
        w = (ends[n, 2, 0] - ends[n, 0, 0], ends[n, 2, 1] - ends[n, 0, 1], ends[n, 2, 2] - ends[n, 0, 2])
        p = (ends[n, 1, 0] - ends[n, 0, 0], ends[n, 1, 1] - ends[n, 0, 1], ends[n, 1, 2] - ends[n, 0, 2])
        q = (ends[n, 3, 0] - ends[n, 2, 0], ends[n, 3, 1] - ends[n, 2, 1], ends[n, 3, 2] - ends[n, 2, 2])
        seen = pair_distance(w, p, q, even)
        distance[n] = seen.value
        push, stiffness = 2.0 - seen.value, ti.cast(1.0, ti.f64)
        weights = pair_weights(seen.s, seen.t)
        slopes = pair_slopes(weights, seen, p, q)
        for k in ti.static(range(4)):
            for a in ti.static(range(3)):
                gradient[n, 3 * k + a] = 0.0 - push * weights[k] * seen.normal[a]
            for m in ti.static(range(4)):
                own = record(weight=weights[k], by_s=slopes[3 * k : 3 * k + 3], by_t=slopes[12 + 3 * k : 15 + 3 * k])
                other = record(weight=weights[m], by_s=slopes[3 * m : 3 * m + 3], by_t=slopes[12 + 3 * m : 15 + 3 * m])
                block = pair_block(own, other, seen, push, stiffness)
                for a in ti.static(range(3)):
                    for b in ti.static(range(3)):
                        hessian[n, 3 * k + a, 3 * m + b] = block[3 * a + b]


def derivatives(ends: np.ndarray, even: float = 2e-3) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Of pairs of edges, by their four ends (N, 4, 3): distances d, and the first and second derivatives of ½ (2 − d)²."""
    runtime.start()
    found = np.zeros(len(ends)), np.zeros((len(ends), 12)), np.zeros((len(ends), 12, 12))
    evaluate(np.ascontiguousarray(ends), even, *found)
    return found


@pytest.mark.thorough
def test_the_distance_of_parallel_edges_in_kernels(rng):
    """Without the term that tells places of parallel edges apart, rounding decides whether both places are within."""
    count = 20_000
    w, direction = rng.normal(size=(2, count, 3))
    p, q = (direction * rng.uniform(0.3, 3.0, (count, 1)) for _ in range(2))
    p[: count // 4] = rng.normal(size=(count // 4, 3))
    found, *_ = derivatives(np.stack([0.0 * w, p, w, w + q], axis=1), even=0.0)
    assert np.abs(found - edge_distance(w, p, q)).max() < 1e-7


def test_derivatives_of_the_distance_of_edges(rng):
    """The gradient of an energy of the distance, 1e-7, and its second derivatives, against differences; parallel edges too."""
    count, h = 60, 1e-6
    ends = rng.normal(size=(count, 4, 3))
    ends[:, 2:] += [0.0, 0.0, 1.5]
    ends[:15, 3] = ends[:15, 2] + (ends[:15, 1] - ends[:15, 0]) * rng.uniform(0.5, 2.0, (15, 1))
    _, gradient, hessian = derivatives(ends)
    moved = [[derivatives(ends + sign * h * direction.reshape(4, 3)) for sign in (1.0, -1.0)] for direction in np.eye(12)]
    slope = np.stack([((2.0 - ahead[0]) ** 2 - (2.0 - behind[0]) ** 2) / (4 * h) for ahead, behind in moved], axis=-1)
    bend = np.stack([(ahead[1] - behind[1]) / (2 * h) for ahead, behind in moved], axis=-1)
    assert np.abs(gradient - slope).max() < 1e-7
    # The nearest places reach an end of an edge suddenly: there second derivatives jump.
    assert np.quantile(np.abs(hessian - bend).max(axis=(1, 2)), 0.9) < 1e-5
    assert np.allclose(hessian, hessian.swapaxes(1, 2), atol=1e-12)


@pytest.mark.thorough
def test_rods_keep_their_distance_and_their_link():
    """Their ends are turned against each other and then brought together by 30 mm. Where the plain minimum would be reached by
    passing through itself, the rod coils up; its link is that of its start."""
    rods = straight_rod(100.0, 30).take([0] * 5)
    angle = np.outer([0.3, 1.5, 3.1, 3.5, 4.1], np.linspace(0.0, 2.0 * np.pi, rods.edges))
    frames = quaternion_product(quaternion_of_turn(angle[..., None] * [1.0, 0.0, 0.0]), rods.quaternions)
    rods = replace(rods, quaternions=frames)
    clamps = end_clamps(rods, Clamp.FRAME, Clamp.FRAME)
    clamps.end_position[:] = [70.0, 0.0, 0.0]
    solution = relax(rods, Material(STIFFNESS, STIFFNESS), clamps, Newton(max_iterations=1500), obstacles=[Itself()],
                     radius=RADIUS)
    gap, shapes = certified(solution).contact.gap, solution.configuration
    assert (gap > -1e-3 * RADIUS).all() and (np.abs(gap[2:]) < 1e-3 * RADIUS).all()
    plain = relax(rods, Material(STIFFNESS, STIFFNESS), clamps).configuration
    before, after, through = (np.array([link(x, q) for x, q in zip(each.vertices, each.quaternions, strict=True)])
                              for each in (rods, shapes, plain))
    assert np.abs(after - before).max() < 1e-3
    assert np.abs(through - before).max() > 1.9, "without contact they pass through themselves"
    assert (plain.quaternions[0] == shapes.quaternions[0]).all(), "a rod far from itself is computed as without contact"


def test_a_knot_stays_and_its_forces_balance():
    rod, material = overhand_knot(160.0, 60, radius=RADIUS, loop=12.0), Material(STIFFNESS, STIFFNESS, 0.0)
    clamps = end_clamps(rod, Clamp.TANGENT, Clamp.TANGENT)
    # The moment about the held spin of a round rod is the sum of what is left at all other edges.
    exact = Newton(tolerance=1e-9)
    solution = certified(relax(rod, material, clamps, exact, obstacles=[Itself()], radius=RADIUS))
    shape = solution.configuration
    assert abs(solution.contact.gap[0]) < 1e-3 * RADIUS and determinant(shape.vertices[0]) == 3
    force = solution.contact.force[0]
    assert np.abs(force.sum(axis=0)).max() < 1e-9 * np.abs(force).max(), "it exerts no force on itself as a whole"
    here = where_found(shape, material, clamps, 0, force=force)
    assert here.residual * 160.0 < 1e-7
    assert solution.energy[0] == pytest.approx(here.energy + (force * shape.vertices[0]).sum(), rel=1e-9)
    assert np.allclose(-here.force, solution.end_force[0], rtol=1e-6, atol=1e-6 * np.abs(here.force).max())


@pytest.mark.thorough
def test_the_force_of_a_wide_knot():
    """F h²/B = ε⁴/2 of Audoly, Clauvelin and Neukirch (2007), in the limit of small ε = √(h/R)."""
    wide = 100.0
    rod = overhand_knot(2.0 * np.pi * wide * 1.1 + 7.0 * np.sqrt(2.0) * wide, 110, radius=RADIUS, loop=wide, finer=10.0)
    # A weight of some hundredths of the tension keeps the knot from sliding along the rod at no energy.
    weight = 0.03 * 0.5 * STIFFNESS / wide**2 / rod.rest_length.sum()
    solution = relax(rod, Material(STIFFNESS, STIFFNESS, weight), end_clamps(rod, Clamp.TANGENT, Clamp.TANGENT),
                     obstacles=[Itself()], radius=RADIUS)
    assert solution.converged[0] and determinant(solution.configuration.vertices[0]) == 3
    force = np.linalg.norm(solution.end_force[0]) * RADIUS**2 / STIFFNESS
    loop = 1.0 / solution.configuration.curvature[0, rod.edges // 2]
    assert 1.0 < force / (0.5 * (RADIUS / loop) ** 2) < 1.3


@pytest.mark.thorough
def test_a_rod_whose_ends_are_too_near_is_infeasible():
    """Both ends are held where the rod has no room."""
    angle = np.linspace(0.0, 2.0 * np.pi, 200)
    ring = rod_along(np.stack([20.0 * np.cos(angle), 20.0 * np.sin(angle), 1.5 * angle / (2.0 * np.pi)], axis=-1), 40)
    held = end_clamps(ring, Clamp.FRAME, Clamp.FRAME)
    solution = relax(ring, Material(STIFFNESS, STIFFNESS, 0.0), held, obstacles=[Itself()], radius=RADIUS)
    assert solution.status[0] == Status.INFEASIBLE


def test_wrong_knots_are_one_line():
    check_refused("length.*mm.*give more than", overhand_knot, 20.0, 40, radius=1.0, loop=12.0)
    check_refused("edges.*too long.*give at least 1[0-9][0-9], or another `finer`", overhand_knot, 6000.0, 100, radius=1.0,
                  loop=400.0, finer=3.0)
    check_refused("edges.*too long.*give at least", overhand_knot, 6000.0, 12, radius=1.0, loop=400.0)
    check_refused("edges", rod_along, np.eye(3), [1.0, -1.0, 2.0])
    check_refused("friction", Itself, friction=-0.1)


@pytest.mark.parametrize("loop, tail, edges", [
    (400.0, 7.0, 100), (400.0, 3.0, 100), (100.0, 7.0, 100), (400.0, 7.0, 200), (12.0, 7.0, 40)])
def test_a_knot_is_one_however_few_its_edges(loop, tail, edges):
    rod = overhand_knot(2.2 * np.pi * loop + tail * np.sqrt(2.0) * loop, edges, radius=RADIUS, loop=loop)
    assert determinant(rod.vertices[0]) == 3
    assert smallest_self_gap(rod.vertices, np.array([RADIUS]))[0] > -1.5 * RADIUS


@pytest.mark.thorough
@pytest.mark.filterwarnings("ignore:overhand_knot")
def test_strands_of_a_very_loose_knot_stay_out_of_each_other():
    """The forces that they meet with are many times those to expect of a rod of that length: a soft contact lets them come to
    each other's middle, from where they would not come out."""
    found, _, _, loop = tied(0.02, 200, WEIGHT)
    assert found.contact.gap[0] > -1e-3 and loop == pytest.approx(2500.0, rel=0.1)


COUNT, INSTANTS = 64, 80


def bent(rng, edges: int) -> np.ndarray:
    """(COUNT, edges, 4) frames of random smooth curves, of which the last turn furthest."""
    share = np.linspace(0.0, 1.0, edges - 1)
    waves = np.stack([np.ones_like(share), np.cos(np.pi * share), np.sin(2.0 * np.pi * share)])
    turn = np.linspace(0.2, 3.0, COUNT)[:, None, None] * rng.normal(size=(COUNT, 3, 3)).transpose(0, 2, 1) @ waves * 3.0 / edges
    steps = quaternion_of_turn(turn.transpose(0, 2, 1))
    first = quaternion_of_turn(rng.normal(size=(COUNT, 3)) * 0.3)
    return np.stack([*accumulate(np.moveaxis(steps, 1, 0), quaternion_product, initial=first)], axis=1)


@pytest.mark.sampled(1)
@pytest.mark.parametrize("edges, radius", [(7, 2.0), (33, 0.5), (40, 4.0)])
def test_rods_that_touch_on_their_way_are_found_and_no_others(rng, edges, radius):
    lengths = np.full((1, edges), 100.0 / edges) * rng.uniform(0.8, 1.2, edges)
    start, frames = bent(rng, edges), bent(rng, edges)
    before, after = (Configuration(np.zeros((COUNT, 3)), each, lengths[0]).vertices for each in (start, frames))
    own, rows = np.array([radius]), np.arange(COUNT)
    gap = np.min([smallest_self_gap(before + share * (after - before), own)
                  for share in np.linspace(0.0, 1.0, INSTANTS)], axis=0)
    touching, turned = approach_in_relaxation(start, frames, lengths, own, rows)
    near = approach_in_motion(before, after, rows, lengths, own)
    np.testing.assert_array_equal(approach_in_motion(before + 1e8, after + 1e8, rows, lengths, own), near)
    still = approach_in_motion(after, after, rows, lengths, own)
    found = np.isin(rows, touching)
    # Between two instants the distance may be less.
    certain = (gap < 0.0) | (gap > 1.5)
    np.testing.assert_array_equal(found[certain], gap[certain] < 0.0)
    assert 0.1 < found.mean() < 0.9 and near[gap < 0.0].all() and not np.isin(turned, touching).any()
    last = smallest_self_gap(after, own)
    certain = np.abs(last) > 3e-3 * radius + 1e-3
    np.testing.assert_array_equal(still[certain], last[certain] < 0.0)


def test_rods_that_are_not_finite_are_found_after_relaxations_and_not_in_motions():
    lengths, radius, rows = np.full((1, 10), 3.0), np.array([1.0]), np.arange(2)
    frames = np.tile([1.0, 0.0, 0.0, 0.0], (2, 10, 1))
    lost = frames.copy()
    lost[1, 4] = np.nan
    np.testing.assert_array_equal(approach_in_relaxation(frames, lost, lengths, radius, rows)[0], [1])
    places = Configuration(np.zeros((2, 3)), frames, lengths[0]).vertices
    gone = np.where(rows[:, None, None] == 1, np.nan, places)
    assert not approach_in_motion(places, gone, rows, lengths, radius).any()


@pytest.mark.thorough
@pytest.mark.parametrize("edges, radius", [(20, 3.0), (40, 1.0)])
@pytest.mark.parametrize("precision", ["f32", "f64", "mixed"])
def test_rods_that_stay_in_order_are_apart_and_have_not_turned(rng, edges, radius, precision, monkeypatch):
    """Those are not looked at: that they would not be found is what makes it allowed."""
    lengths = 100.0 / edges * rng.uniform(0.8, 1.2, edges)
    frames = bent(rng, edges)
    frames[::2] = [1.0, 0.0, 0.0, 0.0]
    start = Configuration(np.zeros((COUNT, 3)), frames, lengths)
    reach = rng.uniform(0.6, 0.98, (COUNT, 1)) * lengths.sum() * [1.0, 0.0, 0.0]
    ends = [matrix_from_quaternion(quaternion_of_turn(0.3 * rng.normal(size=(COUNT, 3)))) for _ in range(2)]
    clamps = Clamps(Clamp.FRAME, Clamp.FRAME, np.zeros((COUNT, 3)), reach, *ends)
    material = Material(1e5 * np.ones(COUNT), 1e5, rng.uniform(0.0, 10.0, COUNT))
    seen = []

    def remember(table, results):
        seen.append((table, stays_in_order(table, results)))
        return seen[-1][1]

    monkeypatch.setattr("doo_ti.relaxation.relax.stays_in_order", remember)
    solution = relax(start, material, clamps, obstacles=[Itself()], radius=radius, precision=precision)
    table, in_order = seen[0]
    assert 0.1 < in_order.mean() < 0.9, in_order.mean()
    every, whole = np.arange(COUNT), whole_start(table.start, table.clamp)
    touching, turned = approach_in_relaxation(
        whole, solution.configuration.quaternions, table.rest_length, table.contact.radius, every)
    assert not in_order[touching].any() and not in_order[turned].any()
    assert (solution.contact.gap[in_order] > 0.0).all()


@pytest.mark.thorough
def test_starts_of_any_length_are_held_by_their_clamps_where_rods_touch_on_their_way(rng):
    """Quaternions need not be normalised, nor have the frames at the ends that the clamps hold."""
    edges, radius = 20, 3.0
    lengths = np.full(edges, 100.0 / edges)
    start = Configuration(np.zeros((COUNT, 3)), bent(rng, edges), lengths)
    clamps = end_clamps(start.take(rng.permutation(COUNT)), Clamp.FRAME, Clamp.FREE)
    scaled = start.quaternions * rng.uniform(0.5, 2.0, (COUNT, edges, 1))
    scaled[:, 0] = [1.0, 0.0, 0.0, 0.0]
    few = Newton(max_iterations=40)
    found, other = (relax(rods, Material(1e5, 1e5, 1.0), clamps, few, obstacles=[Itself()], radius=radius)
                    for rods in (start, replace(start, quaternions=scaled)))
    np.testing.assert_array_equal(found.iterations, other.iterations)
    np.testing.assert_allclose(found.configuration.vertices, other.configuration.vertices, atol=1e-6)
