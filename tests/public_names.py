"""Every public name as a program with types would use it, for type checkers: tests/rod/test_types.py. It is not run."""

from collections.abc import Sequence
from pathlib import Path
from typing import assert_type

import numpy as np

import doo_ti
from doo_ti import (
    Axis,
    Box,
    Camera,
    Capsule,
    Clamp,
    ClampPath,
    Clamps,
    Configuration,
    Contacts,
    Cylinder,
    Descent,
    Detection,
    DetectionOptions,
    Direction,
    DistanceGrid,
    DistanceMaps,
    Dynamics,
    EndLoads,
    External,
    Grid,
    Grippers,
    Group,
    GroupSolution,
    How,
    Hypotheses,
    Identified,
    IdentifyOptions,
    InputError,
    InterruptedRunError,
    Interval,
    Itself,
    Landscape,
    LandscapePlane,
    LearnedMaterial,
    ManipulationPath,
    Material,
    Motion,
    MotionTheta,
    Moving,
    MovingStart,
    Newton,
    Observations,
    Observed,
    Obstacle,
    Pairs,
    Perception,
    PerceptionOptions,
    PerceptionVerdict,
    Plane,
    PlanOptions,
    PointLoads,
    Prediction,
    Pullback,
    RecordedMotion,
    Refinement,
    RefinementOptions,
    Reprojection,
    Rig,
    RigReading,
    Ring,
    Score,
    Sensitivity,
    Servo,
    ServoOptions,
    ServoStatus,
    Simulation,
    Solution,
    Sphere,
    Springs,
    Status,
    Stepping,
    Stills,
    Surroundings,
    SweepOptions,
    SweepTrajectory,
    Targets,
    Theta,
    Tie,
    Touch,
    TrackedFrame,
    Tracker,
    TrackingOptions,
    Trajectory,
    TwistEstimate,
    TwistOptions,
    TwistVerdict,
    choose_hypothesis,
    consecutive_groups,
    detect,
    detect_mask,
    distance,
    distance_maps,
    end_clamps,
    end_loads,
    end_offsets,
    estimate_twist,
    follow,
    follow_group,
    gripper_jacobian,
    hanging,
    identify,
    identify_from_guesses,
    load_observations,
    load_obstacles,
    load_path,
    load_rig,
    load_theta,
    observation_clamps,
    overhand_knot,
    perceive,
    plan_manipulation,
    predict,
    predict_moving,
    predict_step,
    pullback,
    read_landscape,
    record_sweep,
    refine,
    relax,
    relax_group,
    rod_along,
    save_observations,
    score,
    seen_vertices,
    sensitivity,
    simulate,
    start_configuration,
    straight_rod,
    sweep,
    turn_hypotheses,
)


def relaxed(observations: Observations) -> Solution:
    clamps: Clamps = observation_clamps(observations, Clamp.FRAME, Clamp.TANGENT)
    index, turns = turn_hypotheses(observations, clamps)
    start: Configuration = start_configuration(observations.take(index), clamps.take(index), turns)
    material = Material(bend=6e5, twist=[8e5], weight=1.0)
    solution = relax(start, material, clamps, Newton(tolerance=1e-9), up=(0, 0, 1), precision="mixed")
    places, frames = np.zeros((2, 3)), np.zeros((2, 3, 3))
    held = Clamps(Clamp.FRAME, np.array([2, 3]), places, places, frames, frames)
    relax(solution, Material.from_physical(1e-6, [1e-6, 2e-6], 0.01), held, Newton.careful(), material_index=[0, 1])
    about: list[Obstacle] = [
        Plane((0, 0, -20), (0, 0, 1), friction=0.3), Sphere((10, 0, -5), 2.0), Capsule((0, -9, -9), (0, 9, -9), 2.0),
        Cylinder((0, -9, -9), (0, 9, -9), 2.0), Box((0, 0, -40), (9, 9, 9)), Ring((0, 0, -9), (1, 0, 0), 9.0, 1.0)]
    contact: Contacts = relax(start, material, clamps, obstacles=[*about, *load_obstacles("table.toml")], radius=0.5).contact
    relax(start, material, clamps, obstacles=[Itself(friction=0.1)], radius=0.5)
    relax(start, material, clamps, obstacles=[Moving(about[1], [[0, 0, 0], [0, 0, 9]], pivot=(0, 0, 0)).at(1)], radius=0.5)
    tied = Group([start, start], material, [clamps, clamps], [Tie((0, -1), (1, 3), weight=2.0, weld=True)])
    together: GroupSolution = relax_group(tied, Newton(), up=(0, 0, 1), obstacles=about, radius=0.5, contact=False)
    followed = [moment.energy for moment in follow_group(tied, [[clamps, clamps]] * 3, radius=0.5)]
    assert_type(followed, list[np.ndarray])
    assert_type(together.tie_force, np.ndarray)
    SweepOptions(surroundings=Surroundings(about, 0.5))
    DistanceGrid.from_mesh("part.stl", spacing=1.0, margin=9.0, position=(0, 0, 9))
    assert_type(contact.gap, np.ndarray)
    relax(start, Material.diagonal(1e5, 2e5, 1e5), clamps, Descent(), external=Springs(np.zeros((1, 9, 3)), np.zeros((1, 9))))
    relax(start, material, clamps, external=PointLoads(np.zeros((1, 9, 3)), mass=2.0))
    best = choose_hypothesis(index, distance(solution.configuration, observations, index), solution.converged)
    assert_type(solution.configuration.curvature, np.ndarray)
    assert_type(solution.take(best).configuration.take(slice(1)).vertices, np.ndarray)
    assert Status(int(solution.status[0])) == Status.CONVERGED
    return solution


def derived(solution: Solution) -> tuple[np.ndarray, str]:
    loads: EndLoads = end_loads(solution)
    jacobian: Sensitivity = gripper_jacobian(solution)
    assert_type(jacobian.loads.end_moment, np.ndarray)
    assert_type(sensitivity(solution, ("bend", "twist")).columns, tuple[str, ...])
    pulled: Pullback = pullback(solution, np.ones((1, 9, 3)), ("bend", "forces"))
    assert_type(pulled["forces"], np.ndarray)
    return loads.start_force, loads.force_unit


def learned(path: Path) -> float:
    observations = Observations(np.zeros((1, 9, 3)), rest_length=[1.0] * 8, up=(0, 0, 1), sigma=0.1)
    save_observations(path, observations)
    grid = Grid((Axis("bend", [1e5, 2e5]), Axis("twist", [1e5], log=False)))
    try:
        sweep(path, load_observations(path, up=[0, 0, 1]), grid, options=SweepOptions(workers=2))
    except (InputError, InterruptedRunError) as error:
        print(error)
    landscape: Landscape = read_landscape(path)
    theta = Theta([[1e5, 0], [0, 1e5]], 1e5)
    fit: Refinement = refine(observations, observation_clamps(observations), [theta, Theta.of(grid.materials())],
                             RefinementOptions(edges=16))
    print(landscape.name)
    return fit.mean_distance


def moved(path: Path, configuration: Configuration, clamps: Clamps, material: Material) -> np.ndarray:
    along: ClampPath = load_path(path)
    prediction: Prediction = predict(configuration, material, clamps, along, up=[0, 0, 1])
    fast: Prediction = predict_moving(configuration, material, clamps, along, Dynamics(), Stepping(100.0), up=[0, 0, 1])
    print(fast)
    solution, jumps = predict_step(configuration, material, clamps, clamps, rotation=0.1)
    grippers: Grippers = Grippers.resting(clamps, 50)
    begin = MovingStart(configuration, np.zeros((1, 9, 3)))
    trajectory: Trajectory = simulate(begin, material, grippers, Dynamics(drag=0.1, bend_damping=[0.02]), Stepping(100.0))
    assert trajectory.touch is None or (trajectory.touch == Touch.NONE).all()
    motion = RecordedMotion.of(trajectory.positions, 100.0, names=["one"])
    theta: MotionTheta = load_theta(path)
    guessed = identify_from_guesses(motion, IdentifyOptions(), up=[0, 0, 1])
    found: Identified = identify(motion, guessed.theta, IdentifyOptions())
    faster = Direction((material, Dynamics()), (material, Dynamics(drag=0.1)), 0.1)
    simulate(begin, material, grippers, Dynamics(), Stepping(100.0), directions=[faster])
    print(prediction.time, solution, jumps, found.theta, theta)
    return trajectory.positions


def seen(path: Path, images: Sequence[np.ndarray], material: Material) -> np.ndarray:
    rig: Rig = load_rig(path, RigReading(unit="m"))
    detections: list[Detection] = [detect(image, DetectionOptions(polarity="dark")) for image in images]
    detections += [detect_mask(images[0]), follow(images[0], (30.0, 40.0))]
    maps: DistanceMaps = distance_maps([detections])
    found: Perception = perceive(maps, rig, [0, 0, 0], [1, 0, 0], [3.0] * 33, material, options=PerceptionOptions(hypotheses=9),
                                 on_step=report)
    assert PerceptionVerdict(int(found.verdict[0])) != PerceptionVerdict.NOT_FOUND
    scores: Score = score(found.vertices, maps, 0, rig, 1.0, material)
    print(Reprojection(maps, rig, 1.0).count)
    return scores.total


def hung(material: Material) -> np.ndarray:
    ropes, held = hanging(1000.0, 40, [0, 0, 0], np.array([[300.0, 0, 0], [600, 0, 0]]), clamp=Clamp.TANGENT)
    rod: Configuration = straight_rod(300.0, 30, direction=(0, 0, 1))
    knot: Configuration = overhand_knot(300.0, 80, radius=1.0, loop=20.0, finer=2.0)
    assert_type(rod_along(knot.vertices[0], 60), Configuration)
    cantilever: Clamps = end_clamps(rod, Clamp.FRAME, Clamp.FREE)
    assert relax(rod, material, cantilever).converged.all()
    return relax(ropes, material, held).energy


def at_rest(stills: Stills, motion: RecordedMotion, theta: MotionTheta) -> np.ndarray:
    return identify(motion, theta, IdentifyOptions(), stills=[stills]).theta.rest_curvature


def followed(rig: Rig, frames: Sequence[list[Detection]], material: Material, motion: Motion) -> list[TrackedFrame]:
    tracker = Tracker(rig, [3.0] * 33, material, options=TrackingOptions(lost_px=2.0))
    camera: Camera = rig.cameras[0]
    print(camera.name)
    print(seen_vertices(tracker.see(frames[0], [0, 0, 0], [1, 0, 0]), rig, frames[0]).shape)
    return [frame for detected in frames if (frame := tracker.see(detected, [0, 0, 0], [1, 0, 0], motion)).how != How.LOST]


def shaped(rods: Configuration, material: Material, clamps: Clamps, goal: np.ndarray) -> LearnedMaterial:
    path: ManipulationPath = plan_manipulation(rods, material, clamps, Targets(goal), PlanOptions(seconds=3.0), up=(0, 0, 1))
    print(path.reached, path.distance)
    servo = Servo(rods, material, clamps, Targets(goal), ServoOptions(free=("end_shift", "end_turn")), up=(0, 0, 1))
    simulation = Simulation(rods, material, clamps)
    while (servo.status == ServoStatus.MOVING).any():
        state: Solution = simulation.step(servo.step(simulation.state.configuration.vertices))
        print(state)
    return servo.material


def report(edges: int, kept: Hypotheses, pruned: Hypotheses) -> None:
    print(edges, kept, pruned)


def pulled(external: External, pairs: Pairs) -> tuple[int, np.ndarray]:
    return external.count, pairs.weight


def twisted(observations: Observations, material: Material) -> np.ndarray:
    group = consecutive_groups(observations.count, 3, regrasps=[12])
    estimate: TwistEstimate = estimate_twist(observations, material, group, end_offsets(observations, group), TwistOptions())
    assert TwistVerdict(int(estimate.verdict[0])) == TwistVerdict.CLEAR
    return estimate.total_twist


def recorded(path: Path, observations: Observations) -> None:
    one = np.zeros((1, observations.count))
    plane = LandscapePlane.of([("bend", [1e5, 2e5], True, "mm³")], [0.1, 0.2], minimum=[0])
    interval = Interval("bend", 1e5, 1e5, 2e5, True, False)
    trajectory = SweepTrajectory(observations.vertices[None], one, one, one[0], one[0])
    record_sweep(path, run_id="1", name=doo_ti.__version__, observed=Observed.of(observations), trajectory=trajectory,
                 properties={"bend": 1e5}, plane=plane, intervals=(interval,))
