"""Parameters of ropes that lie on a table: ``python tools/studies/table_study.py [--specimens N] [--seed S]``.

Draws ropes with random bend and twist stiffness, held at both ends above a table on which they lie, in eight
configurations each, with noise on the marks; they are relaxed with edges of 2 mm, the fit's have about 5 mm. Each is
fitted by ``refine`` with the table and without it. Prints a Markdown table: how many 95 % intervals contain the
truth, the median of the estimate over the truth, and the median width of the intervals. Exit code 1 where fewer than
nine tenths of those with the table do.
"""

import argparse
import sys
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from doo_ti import Observations, Plane, RefinementOptions, Surroundings, Theta, hanging, observation_clamps, refine, relax
from doo_ti.rod.frames import rotation_matrix
from doo_ti.rod.types import Clamp, Material

SEED = 2011
LENGTH, EDGES, RADIUS, NOISE = 240.0, 120, 2.0, 0.1  # mm
CONFIGURATIONS, MARKS = 8, 25
TABLE = Surroundings([Plane((0, 0, 0), (0, 0, 1))], RADIUS)
GUESS = Theta(3e5 * np.eye(2), 3e5)
OPEN = 1e3  # a median interval that is wider is called open


def specimen(seed: int) -> tuple[Observations, dict[str, float]]:
    """Observations of a rope on the table, and its true parameters."""
    random = np.random.default_rng(seed)
    bend = 10 ** random.uniform(4.7, 5.7)
    truth = {"bend": bend, "twist": bend * random.uniform(0.5, 1.2)}
    count = CONFIGURATIONS
    start, end = np.zeros((count, 3)), np.zeros((count, 3))
    start[:, 2], end[:, 2] = 25.0, random.uniform(15, 35, count)
    end[:, 0], end[:, 1] = random.uniform(150, 215, count), random.uniform(-25, 25, count)
    rods, clamps = hanging(LENGTH, EDGES, start, end, clamp=Clamp.FRAME)
    clamps.start_frame[:] = np.eye(3)
    turn = np.stack([random.uniform(-1, 1, count), np.zeros(count), random.uniform(-0.4, 0.4, count)], axis=-1)
    clamps.end_frame[:] = rotation_matrix(turn)
    material = Material(truth["bend"], truth["twist"])
    # They first bow sideways, as a rope that is laid down does.
    bowed = relax(rods, material, clamps, up=(0.0, -1.0, -0.3)).configuration
    rest = relax(bowed, material, clamps, **TABLE.arguments)
    kept = np.flatnonzero(rest.stable)
    marks, frames = rest.configuration.vertices[kept, :: EDGES // (MARKS - 1)], rest.configuration.frames[kept]
    marks[:, 1:-1] += NOISE * random.normal(size=marks[:, 1:-1].shape)
    return Observations(marks, rest_length=np.full(MARKS - 1, LENGTH / (MARKS - 1)), start_frame=frames[:, 0],
                        end_frame=frames[:, -1], name=f"rope {seed}"), truth


def main(words: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--specimens", type=int, default=40)
    parser.add_argument("--seed", type=int, default=SEED)
    options = parser.parse_args(words)
    around = {"with the table": TABLE, "without it": Surroundings()}
    found, truths = {name: [] for name in around}, []
    for seed in range(options.seed, options.seed + options.specimens):
        observations, truth = specimen(seed)
        truths.append(truth)
        for name, surroundings in around.items():
            found[name].append(refine(observations, observation_clamps(observations), GUESS,
                                      RefinementOptions(surroundings=surroundings)))
        print(observations.name, file=sys.stderr, flush=True)
    print(f"seeds {options.seed} to {options.seed + options.specimens - 1}\n")
    print("| fitted | parameter | intervals that contain the truth | median of estimate over truth | median of high over low |")
    print("|---|---|---|---|---|")
    contained = {}
    for name, own in found.items():
        for parameter in ("bend", "twist"):
            fits, true = [one.estimate.parameter(parameter) for one in own], np.array([truth[parameter] for truth in truths])
            low = np.array([0.0 if one.low is None else one.low for one in fits])
            high = np.array([np.inf if one.high is None else one.high for one in fits])
            contained[name, parameter] = ((low < true) & (true < high)).sum()
            ratio, width = np.median([one.value for one in fits] / true), np.median(high / np.maximum(low, 1e-300))
            print(f"| {name} | {parameter} | {contained[name, parameter]} of {len(true)} | {ratio:.4g} | "
                  f"{f'×{width:.3f}' if width < OPEN else 'open'} |")
    distances = [np.median([one.mean_distance for one in own]) for own in found.values()]
    print(f"\nmedian distance of model and marks: {distances[0]:.2f} mm with the table, {distances[1]:.1f} mm without it")
    return int(min(contained["with the table", parameter] for parameter in truths[0]) < 0.9 * options.specimens)


if __name__ == "__main__":
    sys.exit(main())
