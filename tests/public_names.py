"""Every public name as a program with types would use it, for type checkers: tests/rod/test_types.py. It is not run."""

from collections.abc import Sequence
from pathlib import Path
from typing import assert_type

import numpy as np

import doo_ti as d


def relaxed(observations: d.Observations) -> d.Solution:
    clamps: d.Clamps = d.observation_clamps(observations, d.Clamp.FRAME, d.Clamp.TANGENT)
    index, turns = d.turn_hypotheses(observations, clamps)
    start: d.Configuration = d.start_configuration(observations.take(index), clamps.take(index), turns)
    material = d.Material(bend=6e5, twist=[8e5], weight=1.0)
    solution = d.relax(start, material, clamps, d.Newton(tolerance=1e-9), up=(0, 0, 1), precision="mixed")
    places, frames = np.zeros((2, 3)), np.zeros((2, 3, 3))
    held = d.Clamps(d.Clamp.FRAME, np.array([2, 3]), places, places, frames, frames)
    d.relax(solution, d.Material.from_physical(1e-6, [1e-6, 2e-6], 0.01), held, d.Newton.careful(), material_index=[0, 1])
    about: list[d.Obstacle] = [
        d.Plane((0, 0, -20), (0, 0, 1), friction=0.3), d.Sphere((10, 0, -5), 2.0), d.Capsule((0, -9, -9), (0, 9, -9), 2.0),
        d.Cylinder((0, -9, -9), (0, 9, -9), 2.0), d.Box((0, 0, -40), (9, 9, 9)), d.Ring((0, 0, -9), (1, 0, 0), 9.0, 1.0)]
    about += d.load_obstacles("table.toml")
    contact: d.Contacts = d.relax(start, material, clamps, obstacles=about, radius=0.5).contact
    d.relax(start, material, clamps, obstacles=[d.Itself(friction=0.1)], radius=0.5)
    d.relax(start, material, clamps, obstacles=[d.Moving(about[1], [[0, 0, 0], [0, 0, 9]], pivot=(0, 0, 0)).at(1)], radius=0.5)
    tied = d.Group([start, start], material, [clamps, clamps], [d.Tie((0, -1), (1, 3), weight=2.0, weld=True)])
    together: d.GroupSolution = d.relax_group(tied, d.Newton(), up=(0, 0, 1), obstacles=about, radius=0.5, contact=False)
    followed = [moment.energy for moment in d.follow_group(tied, [[clamps, clamps]] * 3, radius=0.5)]
    assert_type(followed, list[np.ndarray])
    assert_type(together.tie_force, np.ndarray)
    d.SweepOptions(surroundings=d.Surroundings(about, 0.5))
    d.DistanceGrid.from_mesh("part.stl", spacing=1.0, margin=9.0, position=(0, 0, 9))
    assert_type(contact.gap, np.ndarray)
    d.relax(start, d.Material.diagonal(1e5, 2e5, 1e5), clamps, d.Descent(),
            external=d.Springs(np.zeros((1, 9, 3)), np.zeros((1, 9))))
    d.relax(start, material, clamps, external=d.PointLoads(np.zeros((1, 9, 3)), mass=2.0))
    best = d.choose_hypothesis(index, d.distance(solution.configuration, observations, index), solution.converged)
    assert_type(solution.configuration.curvature, np.ndarray)
    assert_type(solution.take(best).configuration.take(slice(1)).vertices, np.ndarray)
    assert d.Status(int(solution.status[0])) == d.Status.CONVERGED
    return solution


def derived(solution: d.Solution) -> tuple[np.ndarray, str]:
    loads: d.EndLoads = d.end_loads(solution)
    jacobian: d.Sensitivity = d.gripper_jacobian(solution)
    assert_type(jacobian.loads.end_moment, np.ndarray)
    assert_type(d.sensitivity(solution, ("bend", "twist")).columns, tuple[str, ...])
    pulled: d.Pullback = d.pullback(solution, np.ones((1, 9, 3)), ("bend", "forces"))
    assert_type(pulled["forces"], np.ndarray)
    return loads.start_force, loads.force_unit


def learned(path: Path) -> float:
    observations = d.Observations(np.zeros((1, 9, 3)), rest_length=[1.0] * 8, up=(0, 0, 1), sigma=0.1)
    d.save_observations(path, observations)
    grid = d.Grid((d.Axis("bend", [1e5, 2e5]), d.Axis("twist", [1e5], log=False)))
    try:
        d.sweep(path, d.load_observations(path, up=[0, 0, 1]), grid, options=d.SweepOptions(workers=2))
    except (d.InputError, d.InterruptedRunError) as error:
        print(error)
    landscape: d.Landscape = d.read_landscape(path)
    theta = d.Theta([[1e5, 0], [0, 1e5]], 1e5)
    fit: d.Refinement = d.refine(observations, d.observation_clamps(observations), [theta, d.Theta.of(grid.materials())],
                             d.RefinementOptions(edges=16))
    print(landscape.name)
    return fit.mean_distance


def moved(path: Path, configuration: d.Configuration, clamps: d.Clamps, material: d.Material) -> np.ndarray:
    along: d.ClampPath = d.load_path(path)
    prediction: d.Prediction = d.predict(configuration, material, clamps, along, up=[0, 0, 1])
    fast: d.Prediction = d.predict_moving(configuration, material, clamps, along, d.Dynamics(), d.Stepping(100.0), up=[0, 0, 1])
    print(fast)
    solution, jumps = d.predict_step(configuration, material, clamps, clamps, rotation=0.1)
    grippers: d.Grippers = d.Grippers.resting(clamps, 50)
    begin = d.MovingStart(configuration, np.zeros((1, 9, 3)))
    damped = d.Dynamics(drag=0.1, bend_damping=[0.02])
    trajectory: d.Trajectory = d.simulate(begin, material, grippers, damped, d.Stepping(100.0))
    assert trajectory.touch is None or (trajectory.touch == d.Touch.NONE).all()
    motion = d.RecordedMotion.of(trajectory.positions, 100.0, names=["one"])
    theta: d.MotionTheta = d.load_theta(path)
    guessed = d.identify_from_guesses(motion, d.IdentifyOptions(), up=[0, 0, 1])
    found: d.Identified = d.identify(motion, guessed.theta, d.IdentifyOptions())
    faster = d.Direction((material, d.Dynamics()), (material, d.Dynamics(drag=0.1)), 0.1)
    d.simulate(begin, material, grippers, d.Dynamics(), d.Stepping(100.0), directions=[faster])
    print(prediction.time, solution, jumps, found.theta, theta)
    return trajectory.positions


def seen(path: Path, images: Sequence[np.ndarray], material: d.Material) -> np.ndarray:
    rig: d.Rig = d.load_rig(path, d.RigReading(unit="m"))
    detections: list[d.Detection] = [d.detect(image, d.DetectionOptions(polarity="dark")) for image in images]
    detections += [d.detect_mask(images[0]), d.follow(images[0], (30.0, 40.0))]
    maps: d.DistanceMaps = d.distance_maps([detections])
    options = d.PerceptionOptions(hypotheses=9)
    found: d.Perception = d.perceive(maps, rig, [0, 0, 0], [1, 0, 0], [3.0] * 33, material, options=options, on_step=report)
    assert d.PerceptionVerdict(int(found.verdict[0])) != d.PerceptionVerdict.NOT_FOUND
    scores: d.Score = d.score(found.vertices, maps, 0, rig, 1.0, material)
    print(d.Reprojection(maps, rig, 1.0).count)
    return scores.total


def hung(material: d.Material) -> np.ndarray:
    ropes, held = d.hanging(1000.0, 40, [0, 0, 0], np.array([[300.0, 0, 0], [600, 0, 0]]), clamp=d.Clamp.TANGENT)
    rod: d.Configuration = d.straight_rod(300.0, 30, direction=(0, 0, 1))
    knot: d.Configuration = d.overhand_knot(300.0, 80, radius=1.0, loop=20.0, finer=2.0)
    assert_type(d.rod_along(knot.vertices[0], 60), d.Configuration)
    cantilever: d.Clamps = d.end_clamps(rod, d.Clamp.FRAME, d.Clamp.FREE)
    assert d.relax(rod, material, cantilever).converged.all()
    return d.relax(ropes, material, held).energy


def at_rest(stills: d.Stills, motion: d.RecordedMotion, theta: d.MotionTheta) -> np.ndarray:
    return d.identify(motion, theta, d.IdentifyOptions(), stills=[stills]).theta.rest_curvature


def followed(rig: d.Rig, frames: Sequence[list[d.Detection]], material: d.Material, motion: d.Motion) -> list[d.TrackedFrame]:
    tracker = d.Tracker(rig, [3.0] * 33, material, options=d.TrackingOptions(lost_px=2.0))
    camera: d.Camera = rig.cameras[0]
    print(camera.name)
    print(d.seen_vertices(tracker.see(frames[0], [0, 0, 0], [1, 0, 0]), rig, frames[0]).shape)
    return [frame for detected in frames if (frame := tracker.see(detected, [0, 0, 0], [1, 0, 0], motion)).how != d.How.LOST]


def shaped(rods: d.Configuration, material: d.Material, clamps: d.Clamps, goal: np.ndarray) -> d.LearnedMaterial:
    options = d.PlanOptions(seconds=3.0)
    path: d.ManipulationPath = d.plan_manipulation(rods, material, clamps, d.Targets(goal), options, up=(0, 0, 1))
    print(path.reached, path.distance)
    servo = d.Servo(rods, material, clamps, d.Targets(goal), d.ServoOptions(free=("end_shift", "end_turn")), up=(0, 0, 1))
    simulation = d.Simulation(rods, material, clamps)
    while (servo.status == d.ServoStatus.MOVING).any():
        state: d.Solution = simulation.step(servo.step(simulation.state.configuration.vertices))
        print(state)
    grip = d.Grip.where(simulation.state.configuration, 3)
    simulation.step(clamps, [grip])
    held: d.HeldSolution = d.relax_held(rods, material, clamps, [grip], precision="f64")
    print(held.grip_loads().force, held.solution.status)
    return servo.material


def report(edges: int, kept: d.Hypotheses, pruned: d.Hypotheses) -> None:
    print(edges, kept, pruned)


def pulled(external: d.External, pairs: d.Pairs) -> tuple[int, np.ndarray]:
    return external.count, pairs.weight


def twisted(observations: d.Observations, material: d.Material) -> np.ndarray:
    group = d.consecutive_groups(observations.count, 3, regrasps=[12])
    offset = d.end_offsets(observations, group)
    estimate: d.TwistEstimate = d.estimate_twist(observations, material, group, offset, d.TwistOptions())
    assert d.TwistVerdict(int(estimate.verdict[0])) == d.TwistVerdict.CLEAR
    return estimate.total_twist


def recorded(path: Path, observations: d.Observations) -> None:
    one = np.zeros((1, observations.count))
    plane = d.LandscapePlane.of([("bend", [1e5, 2e5], True, "mm³")], [0.1, 0.2], minimum=[0])
    interval = d.Interval("bend", 1e5, 1e5, 2e5, True, False)
    trajectory = d.SweepTrajectory(observations.vertices[None], one, one, one[0], one[0])
    d.record_sweep(path, run_id="1", name=d.__version__, observed=d.Observed.of(observations), trajectory=trajectory,
                 properties={"bend": 1e5}, plane=plane, intervals=(interval,))
