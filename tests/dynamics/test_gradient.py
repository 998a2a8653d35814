"""Derivatives of motions by what rods are made of, against central differences of whole motions."""

import numpy as np
import pytest

from doo_ti import Clamp, Configuration, Material, Newton, Status, simulate
from doo_ti.dynamics import simulate as simulation
from doo_ti.dynamics.parameters import Direction, Dynamics, MovingStart, Stepping
from tests.conftest import check_refused
from tests.dynamics.test_energies import INSTANTS, RATE, shaken
from tests.references.rods import bows

EDGES = 7
LENGTHS = np.linspace(38.0, 46.0, EDGES)
NAMES = ("bend", "twist", "rest", "weight", "bend_damping", "twist_damping", "drag", "quadratic_drag", "point_mass")
POINT = np.array([3e6, 2e6, 1.0, 1.1, 0.03, 0.02, 0.4, 3e-4, 4.0])
SMALL = np.array([3e2, 2e2, 1e-4, 1e-4, 1e-5, 1e-5, 1e-4, 1e-7, 1e-3])


@pytest.fixture(autouse=True)
def tight(monkeypatch):
    """Steps converged as far as f64 goes: differences between motions are small."""
    monkeypatch.setattr(simulation, "_newton", lambda *_: Newton(tolerance=1e-11, first_shift=0.0, max_escapes=0))


def rod(numbers):
    """(material, dynamics) of the numbers that NAMES name."""
    (bend, twist, rest, weight), losses = numbers[:4], dict(zip(NAMES[4:], numbers[4:], strict=True))
    along = np.linspace(-1.0, 1.0, EDGES - 1)
    rest = rest * 1e-3 * np.stack([1.0 + along, 2.0 * along**2 - 0.5], axis=-1)
    losses["point_mass"] = losses["point_mass"] * np.linspace(1.0, 2.0, EDGES + 1)[None]
    return Material(np.array([bend]), np.array([twist]), np.array([weight]), rest[None]), Dynamics(**losses)


def arches(count: int) -> Configuration:
    """Of different heights."""
    return bows(*(0.7 + 0.2 * np.arange(count)), edges=EDGES, rest_length=LENGTHS)


def motion(start: Clamp, end: Clamp, numbers, rods: int = 2, directions=(), smooth=True, **stepping):
    """The trajectory of rods with such ends and numbers, whose grippers move and turn."""
    material, dynamics = rod(numbers)
    return simulate(MovingStart(arches(rods), smooth=smooth), material, shaken(arches(rods), start, end), dynamics,
                    Stepping(RATE, **stepping), directions=directions)


def all_directions(at=POINT, share: float = 1.0):
    """Along each number, by that share of SMALL to both sides, above zero."""
    pairs = [(np.maximum(at - way, 0.0), at + way) for way in np.diag(share * SMALL)]
    return [Direction(rod(before), rod(after), (after - before).max()) for before, after in pairs]


def slopes_and_differences(start: Clamp, end: Clamp, **options):
    """(derivatives of the positions by each number, their central differences), both (P, R, F, V, 3)."""
    def positions(numbers):
        found = motion(start, end, numbers, **options)
        assert found.converged.all()
        return found.positions

    slopes = np.moveaxis(motion(start, end, POINT, directions=all_directions(), **options).slopes, 2, 0)
    differences = np.stack([(positions(POINT + 3 * way) - positions(POINT - 3 * way)) / (6.0 * way.max())
                            for way in np.diag(SMALL)])
    return slopes, differences


def worst(slopes, differences):
    """(P,) the largest error of a parameter's derivatives, over the largest of them."""
    return np.abs(slopes - differences).max(axis=(1, 2, 3, 4)) / np.abs(differences).max(axis=(1, 2, 3, 4))


@pytest.mark.sampled(2)
@pytest.mark.parametrize("start, end, options", [
    (Clamp.FRAME, Clamp.TANGENT, {"smooth": False}), (Clamp.FRAME, Clamp.FRAME, {"smooth": False, "scheme": "euler"}),
    (Clamp.FRAME, Clamp.FRAME, {"substeps": 2}), (Clamp.TANGENT, Clamp.POSITION, {}),
    (Clamp.FRAME, Clamp.FREE, {"smooth": False}), (Clamp.FREE, Clamp.FRAME, {}), (Clamp.FREE, Clamp.FREE, {"smooth": False})])
def test_derivatives_are_those_of_the_motion(start, end, options):
    errors = worst(*slopes_and_differences(start, end, **options))
    assert errors.max() < 1e-5, errors


def test_rods_of_a_pack_do_not_depend_on_each_other(monkeypatch):
    options = {"smooth": False, "directions": all_directions()}
    together = motion(Clamp.FRAME, Clamp.TANGENT, POINT, rods=11, **options)
    few = motion(Clamp.FRAME, Clamp.TANGENT, POINT, rods=2, **options)
    plain = motion(Clamp.FRAME, Clamp.TANGENT, POINT, rods=11, smooth=False)
    assert together.slopes.shape == (11, INSTANTS - 1, len(NAMES), EDGES + 1, 3)
    np.testing.assert_array_equal(together.slopes[:2], few.slopes)
    for name in ("positions", "iterations"):
        np.testing.assert_array_equal(getattr(together, name), getattr(plain, name))
    monkeypatch.setattr(simulation, "NUMBERS_AT_ONCE", 20_000)
    in_parts = motion(Clamp.FRAME, Clamp.TANGENT, POINT, rods=11, **options)
    assert worst(np.moveaxis(in_parts.slopes, 2, 0), np.moveaxis(together.slopes, 2, 0)).max() < 1e-9


def test_rods_without_losses():
    """Round rods, straight at rest and undamped, which have a kernel of their own where nothing is differentiated: derivatives
    by losses, which are zero or more, are one-sided."""
    numbers = POINT * [1, 1, 0, 1, 0, 0, 0, 0, 1]

    def moved(values, **options):
        return motion(Clamp.FRAME, Clamp.FRAME, values, smooth=False, **options)

    slopes, middle = moved(numbers, directions=all_directions(numbers, 1e-3)).slopes, moved(numbers).positions
    for k, way in enumerate(np.diag(SMALL)):
        once, twice = (moved(numbers + share * way).positions for share in (0.3, 0.6))
        difference = (4.0 * once - 3.0 * middle - twice) / (0.6 * way.max())
        assert np.abs(slopes[:, :, k] - difference).max() < 1e-4 * np.abs(difference).max(), NAMES[k]


def test_a_rod_that_fails_has_no_derivatives_from_there_on():
    grippers = shaken(arches(3), Clamp.FRAME, Clamp.FRAME)
    grippers.end_position[1, 12:] += 1e4  # beyond the rod's reach
    material, dynamics = rod(POINT)
    found = simulate(MovingStart(arches(3), smooth=False), material, grippers, dynamics, Stepping(RATE),
                     directions=all_directions())
    np.testing.assert_array_equal(found.converged, [True, False, True])
    np.testing.assert_array_equal(np.isfinite(found.slopes).all(axis=(2, 3, 4)), found.status == Status.CONVERGED)


def test_directions_fit_the_rods():
    material, dynamics = rod(POINT)
    two = Material(np.full(2, 3e6), np.full(2, 2e6), np.ones(2)), dynamics
    check_refused("directions", motion, Clamp.FRAME, Clamp.FRAME, POINT, directions=[Direction(two, two, 1.0)])
    check_refused("precision", motion, Clamp.FRAME, Clamp.FRAME, POINT, directions=all_directions(), precision="f32")
