"""Hostile calls: every public function and class with arguments that are wrong in one or two places, from a seed.

    python -m tests.hostile_calls [COUNT] [SEED]        # prints what neither succeeded nor raised InputError
"""

import inspect
import os
import sys
import tempfile
import traceback
import warnings
from collections import Counter
from collections.abc import Callable, Collection, Iterator
from dataclasses import fields, is_dataclass, replace
from functools import cache
from pathlib import Path

import numpy as np

import doo_ti as d
from tests.first_use import CLAMPS, MATERIAL, ROPE, STEPPING, arrays, detection, group, path, picture, seen

THREE, HELD = d.hanging([50.0, 60.0, 70.0], 6, start=(0, 0, 0), end=(30, 0, 0), clamp=d.Clamp.FRAME)
NONE = np.arange(0)
FEWER = 0.1
"""Share of calls whose arguments all have no row, or two."""
SLOW = {"refine": 60, "identify": 200, "identify_from_guesses": 200, "perceive": 20, "sweep": 60, "Tracker.see": 20,
        "estimate_twist": 10, "relax in contact": 4, "simulate in contact": 4,
        "record_sweep": 20, "simulate": 2, "follow_group": 4, "relax_group": 4, "predict_moving": 3,
        "DistanceGrid.from_mesh": 10, "Servo": 2, "Servo.step": 4, "plan_manipulation": 40, "detect": 3, "follow": 20}
"""Functions that are called so many times more rarely than the others."""


@cache
def solution() -> d.Solution:
    return d.relax(ROPE, MATERIAL, CLAMPS)


@cache
def image() -> tuple:
    return picture()


@cache
def recording() -> d.RecordedMotion:
    return d.RecordedMotion.of(np.linspace(0, 40, 5)[:, None] * [1.0, 0.1, 0] + np.zeros((1, 6, 5, 3)), 50.0)


@cache
def theta() -> d.MotionTheta:
    return d.MotionTheta(3e6, 1.0, 0.04, 0.6, 2e-4, 0.0, np.zeros((2, 1)), np.full(4, 10.0), np.array([0.0, 0.0, 1.0]))


@cache
def objects() -> dict[str, list]:
    """Sound objects of each class, some of which do not match others."""
    rig, _, maps = image()
    grippers, plane = d.Grippers.resting(CLAMPS, 4), d.Plane((0, 0, -150), (0, 0, 1))
    lost, theta_fit = replace(ROPE, quaternions=np.full_like(ROPE.quaternions, np.nan)), d.Theta(1e6 * np.eye(2), 1e6)
    axes = (d.Axis("bend", np.array([1e5, 1e6])), d.Axis("twist", np.array([1e5, 1e6])))
    found = [
        ROPE, THREE, ROPE.take(NONE), lost, CLAMPS, HELD, CLAMPS.take(NONE), MATERIAL, d.Material([1e5, 2e5], 1e5),
        d.Material(np.tile(1e5 * np.eye(2), (1, 12, 1, 1)), np.full((1, 11), 1e5), 0.0), solution(),
        solution().take([0, 0]), grippers, grippers.take(NONE), d.Grippers.resting(HELD, 3), d.Dynamics(),
        d.Dynamics(drag=[1.0, 2.0], point_mass=np.ones((2, 13))), STEPPING, replace(STEPPING, tolerance=1.0),
        d.MovingStart(ROPE), d.MovingStart(THREE), d.Springs(np.zeros((1, 13, 3)), np.ones((1, 13))),
        d.Springs(np.zeros((2, 7, 3)), np.ones((2, 7))), d.PointLoads(np.ones((1, 13, 3)), np.ones((1, 13))),
        d.Newton(max_iterations=20), d.Descent(max_iterations=20), plane,
        d.Sphere((0, 0, -200), [5.0, 6.0]), d.Itself(), d.Moving(plane, np.zeros((4, 3))), d.Surroundings([plane], 1.0),
        d.Capsule((0, 0, -200), (9, 0, -200), 1.0), d.Cylinder((0, 0, -200), (9, 0, -200), 1.0),
        d.Ring((0, 0, -200), (0, 0, 1), 5.0, 1.0), d.Box((0, 0, -200), (1, 1, 1)), d.DistanceGrid(np.ones((3, 3, 3)), 1.0),
        path(), d.ClampPath(np.arange(3.0), end_rotation=np.zeros((3, 2))), group(), d.Tie((0, 0), (0, 1)), seen(),
        d.Observations(THREE.vertices), rig, maps, rig.cameras[0], detection(), d.DetectionOptions(), d.RigReading(),
        d.PerceptionOptions(hypotheses=4, samples=20), d.TrackingOptions(), d.TwistOptions(),
        d.RefinementOptions(), d.SweepOptions(), d.Grid(axes), axes[0], theta_fit, theta(), recording(),
        d.IdentifyOptions(modes=1), d.Motion(CLAMPS, np.ones((1, 3))), d.Reprojection(maps, rig, 5e-3),
        d.Direction((MATERIAL, d.Dynamics()), (d.Material(1.1e6, 1e6), d.Dynamics()), 1e5), d.Observed.of(seen()),
        d.LandscapePlane.of([("bend", [1.0, 2.0], True, "mm³")], [0.5, 1.0], (0,)),
        d.Interval("bend", 1.0, 0.5, 2.0, True, False),
        d.SweepTrajectory(np.zeros((2, 1, 13, 3)), np.zeros((2, 1)), np.zeros((2, 1)), np.zeros(1, int), np.zeros(1)),
        d.PlanOptions(seconds=0.2), d.ManipulationPath(np.arange(2.0), np.zeros((2, 1, 3))),
        d.Grip.where(ROPE, 6), d.Targets(ROPE.vertices), d.Targets(THREE.vertices[:1]), d.ServoOptions(free=("end_shift",)),
        d.Pairs([0], [1], [1.0]), d.Stills.of(seen(), np.array([0.0, 1.0, 0.0]), 500.0)]
    kinds: dict[str, list] = {}
    for one in found:
        kinds.setdefault(type(one).__name__, []).append(one)
    return kinds


def constructors() -> dict[str, tuple[Callable, dict]]:
    """Every public dataclass, as one of its objects is made."""
    return {name: (type(many[0]), {entry.name: getattr(many[0], entry.name) for entry in fields(many[0]) if entry.init})
            for name, many in objects().items() if is_dataclass(many[0])}


def functions() -> dict[str, tuple[Callable, dict]]:
    """Every public function, and methods that make objects, with sound arguments: those named here, the others by default."""
    o = {name: many[0] for name, many in objects().items()}
    rig, rods, maps = image()
    rod, relaxed = {"rod": ROPE}, {"material": MATERIAL, "clamps": CLAMPS}
    moved, touching = {"configuration": ROPE, **relaxed}, {"obstacles": [o["Plane"], d.Itself()], "radius": 1.0}
    moving = {"start": ROPE, "material": MATERIAL, "grippers": o["Grippers"], "dynamics": o["Dynamics"], "stepping": STEPPING}
    folder, walk = Path(tempfile.gettempdir()), {"point": rods[:, 0], "direction": rods[:, 1] - rods[:, 0]}
    derived = {"solution": solution(), "parameters": ("bend", "modes"), "modes": np.zeros((1, 11, 2))}
    grey = np.tile(np.arange(32.0), (32, 1))
    frame = d.TrackedFrame(rods[0], np.ones(7), 0.0, np.zeros(3), d.Status.CONVERGED, True, d.How.TRACKED)
    few = d.IdentifyOptions(modes=0, iterations=1)
    absent = {load.__name__: (load, {"path": folder / name}) for load, name in (
        (d.load_observations, "absent.npz"), (d.load_obstacles, "absent.toml"), (d.load_path, "absent.csv"),
        (d.load_rig, "absent.json"), (d.load_theta, "absent.json"))}
    named = {function.__qualname__: (function, given) for function, given in (
        of(d.relax, x0=ROPE, **relaxed, solver=o["Newton"], configuration_index=[0], material_index=[0]),
        of(d.simulate, **moving), of(d.predict, **moved, path=path()), of(d.Simulation, rods=ROPE, **relaxed),
        of(d.predict_step, **moved, goal=CLAMPS, rotation=[0.1]),
        of(d.predict_moving, **moved, path=path(), dynamics=o["Dynamics"], stepping=STEPPING),
        of(d.Servo, **rod, **relaxed, targets=o["Targets"], options=o["ServoOptions"]),
        of(d.plan_manipulation, **rod, **relaxed, targets=o["Targets"], options=o["PlanOptions"]),
        of(d.relax_held, rods=ROPE, **relaxed, grips=[o["Grip"]], solver=o["Newton"]), of(d.relax_group, group=o["Group"]),
        of(d.distance, configuration=ROPE, observations=seen(), index=[0]),
        of(d.distance_maps, detections=[[detection()]], margin_px=10),
        of(d.score, vertices=rods, maps=maps, set_index=0, rig=rig, nu=5e-3, material=MATERIAL, material_index=[0]),
        of(d.perceive, maps=maps, rig=rig, **walk, rest_length=np.full(6, 3.0), material=MATERIAL,
           options=o["PerceptionOptions"]),
        of(d.Tracker, rig=rig, rest_length=np.full(6, 3.0), material=MATERIAL, search=o["PerceptionOptions"]),
        of(d.seen_vertices, frame=frame, rig=rig, detected=[detection()] * 3), of(d.sensitivity, **derived, first=0, last=1),
        of(d.pullback, **derived, cotangent=np.ones((1, 13, 3)), frames=np.ones((1, 12, 3, 3))),
        of(d.gripper_jacobian, solution=solution()), of(d.end_loads, solution=solution()),
        of(d.refine, observations=seen(), clamps=CLAMPS, theta=o["Theta"],
           options=d.RefinementOptions(iterations=2, intervals="covariance")),
        of(d.estimate_twist, observations=seen(), material=MATERIAL, group=[0], offset=[0.0]),
        of(d.identify, motion=recording(), begin=theta(), options=few),
        of(d.identify_from_guesses, motion=recording(), options=few, bend=1e6),
        of(d.sweep, run=folder / "doo_ti_hostile_sweep", observations=seen(), grid=o["Grid"]),
        of(d.hanging, length=500.0, edges=12, start=(0, 0, 0), end=(300, 0, 0)), of(d.straight_rod, length=500.0, edges=12),
        of(d.end_clamps, configuration=ROPE, end=d.Clamp.FREE), of(d.rod_along, points=rods[0], edges=12),
        of(d.overhand_knot, length=300.0, edges=150, radius=1.0, loop=12.0),
        of(d.start_configuration, observations=seen(), clamps=CLAMPS, turns=np.zeros(1)),
        of(d.observation_clamps, observations=seen(), start=d.Clamp.FRAME, end=d.Clamp.FRAME),
        of(d.turn_hypotheses, observations=seen(), clamps=CLAMPS),
        of(d.choose_hypothesis, observation_index=np.array([0, 0]), score=np.array([1.0, 2.0]), sound=np.array([True, True])),
        of(d.consecutive_groups, count=4, together=2, regrasps=[1]), of(d.end_offsets, observations=seen(), group=[0]),
        of(d.detect, image=grey), of(d.detect_mask, mask=grey), of(d.follow, image=grey, pixel=(9.0, 9.0)),
        of(d.read_landscape, run=folder / "absent"),
        of(d.save_observations, path=folder / "doo_ti_hostile.npz", observations=seen()),
        of(d.record_sweep, path=folder / "doo_ti_hostile.rrd", run_id="a", name="b", observed=o["Observed"],
           trajectory=o["SweepTrajectory"], properties={"one": 1}, plane=o["LandscapePlane"], intervals=(o["Interval"],)),
        of(d.Material.from_physical, EI=1e-3, GJ=1e-3, weight_per_length=0.5), of(d.Theta.of, material=MATERIAL),
        of(d.Material.diagonal, bend_1=1e5, bend_2=2e5, twist=1e5), of(d.Grippers.resting, clamps=CLAMPS, instants=4),
        of(d.Configuration.straight, start=np.zeros(3), direction=np.array([1.0, 0, 0]), length=10.0, edges=3),
        of(d.RecordedMotion.of, positions=recording().positions, rate=50.0, names=["a"]),
        of(d.RecordedMotion.load, path=folder / "absent.npz"),
        of(d.DistanceGrid.from_mesh, mesh=([[0, 0, 0], [9, 0, 0], [0, 9, 0], [0, 0, 9]],
                                           [[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]]), spacing=1.0, position=(0, 0, 0)))}
    found = absent | named | {
        "relax again": of(d.relax, x0=solution(), material=MATERIAL, material_index=[0]),
        "relax in contact": of(d.relax, x0=ROPE, **relaxed, **touching),
        "simulate in contact": of(d.simulate, **moving, **touching),
        "Servo.step": of(lambda **given: d.Servo(ROPE, MATERIAL, CLAMPS, o["Targets"]).step(**given), seen=ROPE.vertices),
        "Simulation.step": of(lambda **given: d.Simulation(ROPE, MATERIAL, CLAMPS).step(**given), grippers=CLAMPS,
                              grips=[o["Grip"]]),
        "follow_group": of(lambda **given: list(d.follow_group(**given)), group=o["Group"], clamps=[o["Group"].clamps],
                           **defaults(d.follow_group)),
        "Tracker.see": of(lambda **given: d.Tracker(rig, np.full(6, 3.0), MATERIAL).see(**given), detected=[detection()] * 3,
                          point=rods[0, 0], direction=rods[0, 1] - rods[0, 0], far=None),
        "end_force_in_newton": of(solution().end_force_in_newton, weight_per_length=0.5)}
    return {name: (function, defaults(function) | given) for name, (function, given) in found.items()}


def of(function: Callable, /, **given: object) -> tuple[Callable, dict]:
    """A call: a function and its arguments."""
    return function, given


def defaults(function: Callable) -> dict[str, object]:
    """The arguments of a function that have a default."""
    parameters = inspect.signature(function).parameters.values()
    return {entry.name: entry.default for entry in parameters if entry.default is not entry.empty}


def print_nothing(_: int) -> None:
    pass


def plain() -> list:
    """What no argument should be, or only some."""
    return [None, "", "x", b"x", True, False, -1, 0, 1, 7, 1.5, np.nan, np.inf, -np.inf, 1e300, -1e300, 1e-300, 1e20,
            2**31, 2**63, -(2**63), 10**400, 1j, np.float32(2.0), np.int64(3), [], {}, (), [[]], [[1.0], [1.0, 2.0]],
            [1, [2, 3]], ["a", "b"], [None], np.zeros(0), np.zeros((0, 3)), np.zeros((1, 0)), np.zeros((2, 3, 4, 5)),
            np.array(["a"]), np.array([None]), np.full(3, np.nan), np.full((1, 3), 1e300), np.array([1 + 1j]), np.array(3.0),
            np.ones(2, bool), object(), print_nothing, print, range(3), {1, 2}, {"a": 1}, slice(None), Ellipsis,
            (value for value in (1, 2)), np, d.Configuration, int, np.datetime64("2020-01-01"), 3.0 + 0j, Path("absent"),
            "\0", "x" * 5000, np.arange(12.0).reshape(3, 4)]


def twisted(value: object, rng: np.random.Generator) -> object:
    """``value``, a sound argument, made wrong, or only unusual."""
    if isinstance(value, np.ndarray) and value.dtype != object:
        return twisted_array(value, rng)
    if isinstance(value, list | tuple) and value:
        ways = [value[:-1], [*value, value[-1]], list(value)[::-1], [value], [*value[:-1], None], np.array(value, dtype=object)]
        return ways[rng.integers(len(ways))]
    if isinstance(value, int | float | np.number) and not isinstance(value, bool):
        return [-value, 0 * value, 1e300, value + 0.5, np.array(value), np.array([value]), str(value), [value] * 3,
                2**31][rng.integers(9)]
    if type(value).__name__ in d.__all__ and is_dataclass(value):
        entry = fields(value)[rng.integers(len(fields(value)))]
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            return replace(value, **{entry.name: twisted(getattr(value, entry.name), rng)}) if entry.init else value
    return plain()[rng.integers(len(plain()))]


def twisted_array(value: np.ndarray, rng: np.random.Generator) -> object:
    spoilt = value.astype(float)
    if spoilt.size:
        spoilt.flat[rng.integers(spoilt.size)] = [np.nan, np.inf, 1e300, -1.0][rng.integers(4)]
    ways = [spoilt, -value if value.dtype != bool else ~value, value[:0], value[None], value[..., :1], value.T, value.ravel(),
            np.concatenate([value, value]) if value.ndim else value, value.astype(complex), value.astype(str),
            value.astype(object), value.astype(np.float32), value.astype(int), value.tolist(), np.asfortranarray(value),
            value[::-1] if value.ndim else value, 0 * value.astype(float), value[..., None], np.zeros((0,) * value.ndim)]
    return ways[rng.integers(len(ways))]


def of_rows(value: object, rows: np.ndarray) -> object:
    """``value`` with other rows, where it has any and may have so many."""
    try:
        return value if isinstance(value, np.ndarray | d.Surroundings) else value.take(rows)
    except (AttributeError, d.InputError):
        return value


def calls(count: int, seed: int, without: Collection[str] = ()) -> Iterator[tuple[str, Callable, dict, str]]:
    """(name, function, arguments, what was done to them), the same for the same seed; of all but some."""
    rng, every = np.random.default_rng(seed), constructors() | functions()
    names = sorted(set(every).difference(without))
    weights = np.array([1.0 / SLOW.get(name, 1) for name in names])
    several = [one for many in objects().values() for one in many]
    while count:
        name = names[rng.choice(len(names), p=weights / weights.sum())]
        function, arguments = every[name]
        given, said = dict(arguments), []
        if rng.random() < FEWER:
            rows = [NONE, np.zeros(2, int)][rng.integers(2)]
            given = {key: of_rows(value, rows) for key, value in given.items()}
            said.append(f"rows {rows.tolist()}")
        for key in rng.choice(list(given), size=min(len(given), int(not said or rng.random() < 0.5) + (rng.random() < 0.3)),
                              replace=False):
            way = rng.integers(4)
            try:
                if way == 0:
                    given[key] = plain()[rng.integers(len(plain()))]
                elif way == 1:
                    same = objects().get(type(given[key]).__name__, several)
                    given[key] = same[rng.integers(len(same))] if rng.random() < 0.5 else several[rng.integers(len(several))]
                elif way == 2:
                    given[key] = twisted(given[key], rng)
                else:
                    other = list(given)[rng.integers(len(given))]
                    given[key], given[other] = given[other], given[key]
            except (d.InputError, ValueError, TypeError, OverflowError, IndexError):  # no such thing can be made
                continue
            said.append(f"{key} = {shown(given[key])}")
        yield name, function, given, "; ".join(said)
        count -= 1


def shown(value: object) -> str:
    try:
        return f"{value!r:.80}"
    except Exception:  # of an object that is wrong inside
        return f"a {type(value).__name__}"


def outcome(function: Callable, given: dict) -> str:
    """"refused", "done", or what went wrong. The work of a solution that was relaxed before is not its input."""
    inputs = [(array, array.copy()) for _, array in arrays({key: value for key, value in given.items()
                                                         if not isinstance(value, d.Solution)}) if array.dtype != object]
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            made = function(**given)
            if isinstance(made, d.Solution) and made.contact is not None:
                made.contact.gap  # noqa: B018
            repr(made)
        said = "done"
    except (d.InputError, d.InterruptedRunError) as error:
        said = "refused" if "\n" not in str(error) else "more than one line"
    except Exception as error:
        frames = traceback.extract_tb(error.__traceback__)
        said = f"{type(error).__name__}: {error}"[:150].replace("\n", " ") + f" at {Path(frames[-1].filename).name}:" + (
            " < ".join(f"{frame.name}:{frame.lineno}" for frame in frames[:0:-1] if "doo_ti" in frame.filename)[:120])
    for array, before in inputs:
        if array.tobytes() != before.tobytes():
            return f"an input was altered, {said}"
    return said


TRACE = os.environ.get("HOSTILE_TRACE")
"""A file that says what is called, for a call that does not come back."""


def main(count: int, seed: int, without: Collection[str] = ()) -> list[str]:
    """What went wrong."""
    wrong, seen_so_far = [], Counter()
    for name, function, given, said in calls(count, seed, without):
        if TRACE:
            Path(TRACE).write_text(f"{name}({said})")
        found = outcome(function, given)
        seen_so_far[found if found in ("done", "refused") else "wrong"] += 1
        if found not in ("done", "refused"):
            wrong.append(f"{name}({said}): {found}")
    print(dict(seen_so_far), file=sys.stderr)
    return wrong


if __name__ == "__main__":
    print("\n".join(main(*(int(value) for value in (*sys.argv[1:], "1000", "2011")[:2]))))
