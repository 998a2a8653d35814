#!/usr/bin/env bash
# How much is a rod twisted? Its marks do not show it, but its shape does.
set -euo pipefail
scenes=$(dirname "$0")/../../scenes

doo-ti synth "$scenes/vicryl.toml" --out vicryl.npz               # simulated marks, and the true twist
doo-ti convert vicryl.npz marks.npz --select 0:60:7
doo-ti twist marks.npz --bend 6e5 --twist 8e5 --out twist.csv --picture 05_twist.png

# Final check: of these nine rods at least eight are within 45° of the truth.
python - <<'END'
import csv
import numpy as np
from doo_ti import load_observations
found = np.array([float(row["total_twist_deg"]) for row in csv.DictReader(open("twist.csv"))])
error = np.abs(found - np.degrees(load_observations("marks.npz").total_twist))
print(f"median error {np.median(error):.0f}°, largest {error.max():.0f}°")
assert (error < 45).sum() >= len(error) - 1
END
