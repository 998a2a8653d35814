"""MuJoCo beside `simulate`: the same rod, clamped at one end and released from the horizontal, at equal error of its tip.

Each is compared with itself at its smallest step, so that what counts is how well a step of that length follows the motion,
not how the two discretise the rod. MuJoCo's rod is a 1-D flex whose edges are held by equality constraints as stiff as its step
allows. Times are processor seconds per simulated second and rod: of one rod in MuJoCo, of a batch here.
"""

import time
from collections.abc import Callable

import numpy as np

from doo_ti import Clamp, Clamps, Configuration, Dynamics, Grippers, Material, Stepping, simulate
from tools.studies.peers import flex

LENGTH, EDGES, BEND = 1000.0, 33, 1e8  # mm, -, mm³
RADIUS = 0.005  # m: only EI over weight matters
FRAMES = 50  # in the simulated second
BATCH = 4096
STEPS_HERE, STEPS_THERE = (1, 2, 4, 8, 64), (10, 20, 40, 80, 160, 1000)  # steps between frames; the last are the references


def there(steps: int) -> np.ndarray:
    """(FRAMES, 3) mm: the tip of MuJoCo's rod."""
    import mujoco

    text = flex.model(1.0 / (FRAMES * steps), LENGTH, EDGES, BEND, RADIUS, "0.99 0.9999 0.0001", 0, pinned='<pin id="0 1"/>')
    model = mujoco.MjModel.from_xml_string(text)
    data = mujoco.MjData(model)
    tip = []
    for _ in range(FRAMES):
        for _ in range(steps):
            mujoco.mj_step(model, data)
        tip.append(1e3 * data.flexvert_xpos.reshape(-1, 3)[-1])
    return np.array(tip)


def here(steps: int, count: int = 1, precision: str = "f64") -> np.ndarray:
    """(FRAMES, 3) mm: the tip of the first of ``count`` rods here."""
    start = Configuration(np.zeros((count, 3)), np.tile([1.0, 0, 0, 0], (count, EDGES, 1)), np.full(EDGES, LENGTH / EDGES))
    frames = np.broadcast_to(np.eye(3), (count, 3, 3))
    grippers = Grippers.resting(Clamps(Clamp.FRAME, Clamp.FREE, start.start, start.start, frames, frames), FRAMES + 1)
    found = simulate(start, Material(BEND, BEND), grippers, Dynamics(), Stepping(float(FRAMES), steps, precision=precision))
    return found.positions[0, :, -1]


def seconds(run: Callable[[], np.ndarray], rounds: int = 3) -> float:
    """Processor seconds of a call, the least of some."""
    taken = []
    for _ in range(rounds):
        began = time.process_time()
        run()
        taken.append(time.process_time() - began)
    return min(taken)


def table() -> list[str]:
    """Error of the tip over processor time for several steps, and the ratio at equal error. Raises ImportError where MuJoCo is
    absent."""
    equal = None
    lines = ["| simulator | step ms | tip, root mean square error mm | µs of processor a rod | MuJoCo's at that error |",
             "|---" * 5 + "|"]
    for name, steps, tip, timed in (
            ("MuJoCo flex, one rod", STEPS_THERE, there, lambda n: seconds(lambda: there(n))),
            (f"this package, f64, {BATCH} rods", STEPS_HERE, here, lambda n: seconds(lambda: here(n, BATCH)) / BATCH),
            (f"this package, f32, {BATCH} rods", STEPS_HERE, lambda n: here(n, 1, "f32"),
             lambda n: seconds(lambda: here(n, BATCH, "f32")) / BATCH)):
        finest = tip(steps[-1]) if "f32" not in name else here(steps[-1])
        rows = [(1.0 / (FRAMES * n), np.sqrt(((tip(n) - finest) ** 2).sum(axis=1).mean()), timed(n)) for n in steps[:-1]]
        for step, error, cost in rows:
            times = ""
            if equal is not None and equal[0, 1] <= error <= equal[-1, 1]:
                there_too = np.exp(np.interp(np.log(error), np.log(equal[:, 1]), np.log(equal[:, 2])))
                times = f"× {there_too / cost:.0f}"
            lines.append(f"| {name} | {1e3 * step:.2f} | {error:.3f} | {1e6 * cost:,.1f} | {times} |")
        if equal is None:  # MuJoCo's, which come first
            equal = np.array(sorted(rows, key=lambda row: row[1]))
    return lines
