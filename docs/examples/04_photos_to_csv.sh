#!/usr/bin/env bash
# Three photographs of a thread, taken at once by calibrated cameras, to its centreline as CSV.
set -euo pipefail
images=$(dirname "$0")/../../tests/data/images_a

# The thread leaves its clip at the seed point, in the seed direction; 33 edges of 3 mm.
doo-ti perceive "$images"/vicryl_66mm_060deg_{left,front,right}.jpg --rig "$images/rig.yaml" \
    --seed-point 0,0,0 --seed-direction 0.94,0,0.34 --rest-length 3:33 --out thread.csv
head -3 thread.csv

# Final check: within 0.3 mm of the true thread.
python - "$images" <<'END'
import sys
import numpy as np
from doo_ti import load_observations
found = load_observations("thread.csv").vertices[0]
with np.load(f"{sys.argv[1]}/truth.npz") as truth:
    row = truth["names"].tolist().index("vicryl_66mm_060deg")
    error = np.linalg.norm(found - truth["vertices_mm"][row], axis=-1)
print(f"{error.mean():.3f} mm off on average, {error.max():.3f} mm at most")
assert error.max() < 0.3
END
