"""A video for 08_follow_a_video.sh: a thread whose far end is led along a way, seen by three cameras.

    python make_video.py FOLDER RIG.yaml

writes images, frames.csv and truth.npz.
"""

import sys
from pathlib import Path

import cv2
import numpy as np

from doo_ti import Clamp, Material, end_clamps, load_rig, predict, straight_rod
from doo_ti.io.motion_file import ClampPath
from doo_ti.rod.frames import rotation_matrix
from doo_ti.vision.render import render_set

FRAMES, LENGTH_MM, EDGES, DIAMETER_MM = 8, 90.0, 30, 0.8


def main(folder: Path, rig_file: str) -> None:
    rig = load_rig(rig_file)
    rod = straight_rod(LENGTH_MM, EDGES, direction=(0.94, 0, 0.34))
    clamps = end_clamps(rod, Clamp.FRAME, Clamp.FRAME)
    share = np.linspace(0, 1, FRAMES + 3)[:, None, None]
    turn = rotation_matrix(share[..., 0] * np.array([0.3, 0.9, 0.5]))
    path = ClampPath(np.arange(FRAMES + 3) / 10, end_position=clamps.end_position + share * np.array([-32, 10, -14]),
                     end_frame=(turn @ clamps.end_frame[0])[:, None])
    rods = predict(rod, Material(bend=6e5, twist=8e5), clamps, path).vertices[3:, 0]
    folder.mkdir(parents=True, exist_ok=True)
    lines = [",".join(["frame", *rig.names, "time_s", "seed_x", "seed_y", "seed_z", "dir_x", "dir_y", "dir_z"])]
    seed = [f"{value:.6f}" for value in (*rods[0, 0], *(rods[0, 1] - rods[0, 0]))]
    for frame, vertices in enumerate(rods):
        names = [f"{frame:03d}_{camera}.png" for camera in rig.names]
        for name, image in zip(names, render_set(rig, vertices, DIAMETER_MM, seed=frame), strict=True):
            cv2.imwrite(str(folder / name), image)
        lines.append(",".join([str(frame), *names, str(frame / 10), *(seed if frame == 0 else [""] * 6)]))
    (folder / "frames.csv").write_text("\n".join(lines) + "\n")
    np.savez(folder / "truth.npz", vertices_mm=rods)


if __name__ == "__main__":
    main(Path(sys.argv[1]), sys.argv[2])
