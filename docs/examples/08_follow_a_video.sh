#!/usr/bin/env bash
# Follow a thread through a video of three cameras: its centreline in every frame, as CSV.
set -euo pipefail
here=$(dirname "$0")
rig=$here/../../scenes/rig.yaml

python "$here/make_video.py" video "$rig"    # frames.csv names the images of each frame; its first line has the seed
doo-ti track --rig "$rig" --frames video/frames.csv --rest-length 3:30 --bend 6e5 --twist 8e5 --out video.csv

# A picture, and the final check: no frame is lost, every vertex within 0.5 mm.
python - "$rig" <<'END'
import sys
import matplotlib.pyplot as plt
import numpy as np
from doo_ti import load_observations, load_rig
found, camera = load_observations("video.csv").vertices, load_rig(sys.argv[1]).cameras[0]
figure, panels = plt.subplots(1, 3, figsize=(10, 3), layout="constrained")
for panel, frame in zip(panels, (0, 4, 7)):
    panel.imshow(plt.imread(f"video/{frame:03d}_{camera.name}.png"), cmap="gray")
    points = camera.project(found[frame])
    (left, top), (right, bottom) = points.min(axis=0) - 40, points.max(axis=0) + 40
    panel.plot(*points.T, "--", color="tab:orange", linewidth=1)
    panel.set(title=f"frame {frame}, camera {camera.name}", xlim=(left, right), ylim=(bottom, top), xticks=[], yticks=[])
plt.savefig("08_follow_a_video.png", dpi=100)
with np.load("video/truth.npz") as truth:
    error = np.linalg.norm(found - truth["vertices_mm"], axis=-1)
print(f"{len(error)} frames, {error.mean():.3f} mm off on average, {error.max():.3f} mm at most")
assert error.max() < 0.5
END
