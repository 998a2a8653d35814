#!/usr/bin/env bash
# Cables in motion: their upper ends are moved sideways, stopped and moved back; the limp ones swing, the stiff ones hardly.
set -euo pipefail
scenes=$(dirname "$0")/../../scenes/motion

doo-ti simulate "$scenes/hanging_cables.toml" --out cables.npz --picture 11_dynamics.png

# Final check: every step of every cable converged, and edges kept their lengths.
python - <<'END'
import numpy as np
with np.load("cables.npz") as found:
    positions, status = found["positions_mm"], found["status"]  # (R, T, V, 3), (R, T)
lengths = np.linalg.norm(np.diff(positions, axis=2), axis=-1)
print(f"{positions.shape[0]} cables, {positions.shape[1]} frames; edges {lengths.min():.6f} to {lengths.max():.6f} mm")
assert (status == 0).all() and np.ptp(lengths) < 1e-6
END
