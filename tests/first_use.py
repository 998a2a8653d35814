"""Calls of the public functions that launch kernels, prepared so that the call itself is the first launch of a process.

    python -m tests.first_use NAME THREADS      # the call from that many threads at once: "alike" where all find the same
"""

import sys
import tempfile
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from threading import Barrier

import numpy as np

import doo_ti as d
from tests.vision.scenes import curves, drawn_maps, three_cameras

ROPE, CLAMPS = d.hanging(500.0, 12, start=(0, 0, 0), end=(300, 0, 0), clamp=d.Clamp.FRAME)
MATERIAL = d.Material(1e6, 1e6)
STEPPING = d.Stepping(100.0)


def seen() -> d.Observations:
    return d.Observations(ROPE.vertices, rest_length=ROPE.rest_length, start_frame=CLAMPS.start_frame,
                          end_frame=CLAMPS.end_frame, total_twist=np.zeros(1))


def path() -> d.ClampPath:
    return d.ClampPath(np.array([0.0, 1.0]), end_position=CLAMPS.end_position + np.array([0.0, -5.0])[:, None, None])


def group() -> d.Group:
    rod = d.straight_rod(100.0, 6)
    return d.Group([rod], MATERIAL, [d.end_clamps(rod)])


def detection() -> d.Detection:
    points = np.stack([np.linspace(30.0, 70.0, 41), np.full(41, 50.0)], axis=-1)
    return d.Detection(points, np.tile([1.0, 0.0], (41, 1)), np.ones(41), 3.0, "dark", (100, 100), "ridge")


def picture() -> tuple:
    rods = curves(np.random.default_rng(8), 1, 6)
    return three_cameras(), rods, drawn_maps(three_cameras(), rods)


def perceived() -> Callable:
    rig, rods, maps = picture()
    options = d.PerceptionOptions(hypotheses=4, samples=20)
    return lambda: d.perceive(maps, rig, rods[:, 0], rods[:, 1] - rods[:, 0], np.full(6, 3.0), MATERIAL, options=options)


def scored() -> Callable:
    rig, rods, maps = picture()
    return lambda: d.score(rods, maps, 0, rig, 5e-3, MATERIAL)


def tracked() -> Callable:
    rig, rods, _ = picture()
    images = [detection()] * len(rig.cameras)
    return lambda: d.Tracker(rig, np.full(6, 3.0), MATERIAL).see(images, rods[0, 0], rods[0, 1] - rods[0, 0])


def identified() -> Callable:
    from tests.dynamics.recordings import RATE, recorded
    from tests.dynamics.test_identify import OPTIONS, TRUE

    motion = d.RecordedMotion.of(recorded(np.random.default_rng(1), TRUE, 1, 20, 0.0), RATE)
    return lambda: d.identify(motion, TRUE, OPTIONS)


def swept() -> dict:
    grid = d.Grid((d.Axis("bend", np.array([1e5, 1e6])), d.Axis("twist", np.array([1e5, 1e6]))))
    with tempfile.TemporaryDirectory() as folder:
        return d.sweep(folder, seen(), grid)["best"]


def refined() -> d.Refinement:
    rod = seen()
    return d.refine(rod, d.observation_clamps(rod), d.Theta(1e6 * np.eye(2), 1e6))


CALLS: dict[str, Callable] = {
    "relax": lambda: d.relax(ROPE, MATERIAL, CLAMPS),
    "relax in f32": lambda: d.relax(ROPE, MATERIAL, CLAMPS, precision="mixed"),
    "relax by descent": lambda: d.relax(ROPE, MATERIAL, CLAMPS, d.Descent(max_iterations=50)),
    "relax on a plane": lambda: d.relax(
        ROPE, MATERIAL, CLAMPS, obstacles=[d.Plane((0, 0, -150), (0, 0, 1)), d.Itself()], radius=1.0),
    "simulate": lambda: d.simulate(ROPE, MATERIAL, d.Grippers.resting(CLAMPS, 4), d.Dynamics(), STEPPING),
    "predict": lambda: d.predict(ROPE, MATERIAL, CLAMPS, path()),
    "predict_step": lambda: d.predict_step(ROPE, MATERIAL, CLAMPS, path().at(1, CLAMPS)),
    "predict_moving": lambda: d.predict_moving(ROPE, MATERIAL, CLAMPS, path(), d.Dynamics(), STEPPING),
    "relax_group": lambda: d.relax_group(group(), radius=1.0),
    "follow_group": lambda: next(d.follow_group(group(), [group().clamps], radius=1.0)),
    "distance": lambda: d.distance(ROPE, seen()), "distance_maps": lambda: d.distance_maps([[detection()]]),
    "sensitivity": lambda: d.sensitivity(d.relax(ROPE, MATERIAL, CLAMPS)),
    "pullback": lambda: d.pullback(d.relax(ROPE, MATERIAL, CLAMPS), np.ones((1, 13, 3))),
    "gripper_jacobian": lambda: d.gripper_jacobian(d.relax(ROPE, MATERIAL, CLAMPS)),
    "end_loads": lambda: d.end_loads(d.relax(ROPE, MATERIAL, CLAMPS)), "sweep": swept, "refine": refined,
    "estimate_twist": lambda: d.estimate_twist(seen(), MATERIAL)}
PREPARED = {"score": scored, "perceive": perceived, "Tracker": tracked, "identify": identified}
"""Functions that prepare what is given, and return the call."""


def arrays(value: object, name: str = "", met: set | None = None) -> Iterator[tuple[str, np.ndarray]]:
    """Every array in ``value``, by where it is."""
    met = set() if met is None else met
    if id(value) in met or isinstance(value, str | bytes | type):
        return
    met.add(id(value))
    if isinstance(value, np.ndarray):
        yield name, value
    elif isinstance(value, dict | list | tuple):
        for key, part in value.items() if isinstance(value, dict) else enumerate(value):
            yield from arrays(part, f"{name}[{key!r}]", met)
    elif type(value).__module__.startswith("doo_ti"):
        yield from arrays(vars(value) if hasattr(value, "__dict__") else (), name, met)


def main(name: str, count: int) -> str:
    call, together = PREPARED[name]() if name in PREPARED else CALLS[name], Barrier(count)

    def work(_: int) -> list[np.ndarray] | str:
        together.wait()
        try:
            return [array for name, array in arrays(call()) if "tables" not in name]
        except BaseException as error:
            return f"{type(error).__name__}: {error}"
    with ThreadPoolExecutor(count) as threads:
        found = list(threads.map(work, range(count)))
    wrong = [one for one in found if isinstance(one, str)]
    if wrong:
        return f"{len(wrong)} of {count}: {wrong[0]}"
    for one in found:
        for own, first in zip(one, found[0], strict=True):
            np.testing.assert_array_equal(own, first)
    return "alike"


if __name__ == "__main__":
    print(main(sys.argv[1], int(sys.argv[2])))
