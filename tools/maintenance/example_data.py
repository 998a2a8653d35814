"""The data of docs/examples: marks on a simulated cable, as someone else's program might have written them.

    python tools/maintenance/example_data.py docs/examples/data

``cable.csv``: positions in metres, y up, ten poses of a 1 m cable with 26 marks and their noise. Grippers hold its outer
40 mm straight, from the first mark to the second and from the last but one to the last, and let it roll. The true EI is
1e-3 N m², the cable weighs 50 g/m.
"""

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np

from doo_ti import Clamp, Material, hanging, relax
from doo_ti.rod.frames import across, bishop_frames
from doo_ti.rod.material import weight_per_length
from doo_ti.system.files import write_text

EI, GRAMS_PER_METRE = 1e-3, 50.0
POSES, NOISE_MM, SEED = 10, 0.3, 18
EDGE_MM, SPACING_MM, MARKS = 5.0, 40.0, 26
WOBBLE = 0.3  # of the grippers' directions, about those of the arc


def main(folder: Path) -> None:
    random = np.random.default_rng(SEED)
    held = SPACING_MM - EDGE_MM  # by each gripper, beyond the outer edge of the mesh
    length = SPACING_MM * (MARKS - 1) - 2 * held
    away = np.linspace(350.0, 850.0, POSES)
    ends = np.stack([away, random.uniform(-50, 50, POSES), random.uniform(-100, 100, POSES)], axis=-1)
    rope, clamps = hanging(length, round(length / EDGE_MM), np.zeros(3), ends, clamp=Clamp.TANGENT)
    frames = []
    for frame in (clamps.start_frame, clamps.end_frame):
        tangent = frame[:, :, 0] + WOBBLE * random.normal(size=(POSES, 3))
        tangent /= np.linalg.norm(tangent, axis=-1, keepdims=True)
        frames.append(bishop_frames(tangent[:, None], across(tangent))[:, 0])
    clamps = replace(clamps, start_frame=frames[0], end_frame=frames[1])
    solution = relax(rope, Material.from_physical(EI, EI, weight_per_length(GRAMS_PER_METRE)), clamps)
    assert solution.converged.all() and solution.stable.all()
    vertices = solution.configuration.vertices
    first = vertices[:, :1] - held * frames[0][:, None, :, 0]
    last = vertices[:, -1:] + held * frames[1][:, None, :, 0]
    marks = np.concatenate([first, vertices[:, 1 : -1 : round(SPACING_MM / EDGE_MM)], last], axis=1)
    assert marks.shape[1] == MARKS
    metres = (marks + NOISE_MM * random.normal(size=marks.shape)) / 1000
    rows = [f"{pose},{mark},{x:.5f},{z:.5f},{-y:.5f}" for pose, rod in enumerate(metres) for mark, (x, y, z) in enumerate(rod)]
    write_text(folder / "cable.csv", "\n".join(["pose,mark,x,y,z", *rows]) + "\n")


if __name__ == "__main__":
    main(Path(sys.argv[1]))
