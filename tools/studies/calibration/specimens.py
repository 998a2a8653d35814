"""Random specimens: a rod of the virtual lab with all parameters drawn from one seed.

The rods have edges of 0.5 mm, smooth rest curvature and clips of any length, none of which are inputs of the fit.
"""

from dataclasses import dataclass

import numpy as np

from doo_ti.io.scene import Synthesis
from doo_ti.lab.synthesis import synthesise
from doo_ti.rod.observations import Observations
from doo_ti.system.errors import InterruptedRunError

BEND, TWIST_RATIO = (1e5, 2e6), (0.3, 1.5)  # mm³ and 1, log-uniform
REST_CURVATURE_RMS, REST_CURVATURE_RANGE = (1 / 2000, 1 / 600), (4.0, 25.0)  # 1/mm and mm, log-uniform
LABEL_NOISE = (0.05, 0.2)  # mm
CLIP_STEP, CLIP_STEPS = 0.5, (2, 8)  # mm, and how many of them a clip has: 1 to 4 mm
PITCH, YAW = (0.3, 0.5), (0.2, 0.4)  # rad: the start points up, the end down and to the side
LARGEST_TILT_DEG = 1.5  # standard deviation of each component, so that few clips are tilted by more than 3°
FINE_EDGE = 0.5  # mm
MOST_DRAWS = 50


@dataclass(frozen=True)
class Specimen:
    """One rod with its observations; ``redrawn`` counts draws before it that found no stable equilibrium somewhere."""

    recipe: Synthesis
    observations: Observations
    redrawn: int


def drawn(seed: int, attempt: int = 0) -> Synthesis:
    """The recipe of a seed; ``attempt`` gives others of the same seed."""
    random = np.random.default_rng([seed, attempt])
    bend, ratio = log_uniform(random, BEND), log_uniform(random, TWIST_RATIO)
    start_pitch, end_pitch, yaw = random.uniform(*PITCH), -random.uniform(*PITCH), random.uniform(*YAW)
    start_clip, end_clip = CLIP_STEP * random.integers(CLIP_STEPS[0], CLIP_STEPS[1] + 1, size=2)
    return Synthesis(
        bend=bend, twist=bend * ratio, name=f"specimen_{seed}", source=f"specimen {seed}", fine_edge_mm=FINE_EDGE,
        clip_mm=(float(start_clip), float(end_clip)),
        start_direction=direction(start_pitch, 0.0), end_direction=direction(end_pitch, yaw),
        rest_curvature_rms_per_mm=log_uniform(random, REST_CURVATURE_RMS),
        rest_curvature_range_mm=log_uniform(random, REST_CURVATURE_RANGE),
        label_noise_mm=float(random.uniform(*LABEL_NOISE)), end_mark_noise=bool(random.random() < 0.5),
        clip_tilt_deg=float(random.uniform(0.0, LARGEST_TILT_DEG) * (random.random() < 0.5)),
        seed=int(random.integers(2**31)),
    )


def log_uniform(random: np.random.Generator, bounds: tuple[float, float]) -> float:
    return float(np.exp(random.uniform(*np.log(bounds))))


def direction(pitch: float, yaw: float) -> tuple[float, float, float]:
    """The unit vector at angles (rad) above the x-y plane and from x towards y."""
    x, y, z = np.cos(pitch) * np.cos(yaw), np.cos(pitch) * np.sin(yaw), np.sin(pitch)
    return float(x), float(y), float(z)


def specimen(seed: int) -> Specimen:
    """The first draw of ``seed`` that can be synthesised. Raises InterruptedRunError where none of ``MOST_DRAWS`` can."""
    for attempt in range(MOST_DRAWS):
        recipe = drawn(seed, attempt)
        try:
            return Specimen(recipe, synthesise(recipe), attempt)
        except InterruptedRunError:
            continue
    raise InterruptedRunError(f"specimen {seed}: none of {MOST_DRAWS} draws found stable equilibria")
