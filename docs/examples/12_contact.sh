#!/usr/bin/env bash
# A rope over a peg with friction: it is pulled across the peg by one end.
set -euo pipefail
scenes=$(dirname "$0")/../../scenes/motion

doo-ti simulate "$scenes/rope_over_peg.toml" --out rope.npz --picture 12_contact.png

# Final check: every step converged, the rope is never inside the peg, and the peg bears its weight.
python - <<'END'
import numpy as np
with np.load("rope.npz") as found:
    status, gap, force = found["status"], found["smallest_gap_mm"], found["contact_force"]  # (R, T), (R, T), (R, T, V, 3)
print(f"smallest gap {gap.min():.2g} mm; the peg pushes up by {force[0, -1, :, 2].sum():.0f} mm²/mm")
assert (status == 0).all() and gap.min() > -1e-3 * 2.0 and force[0, -1, :, 2].sum() > 0
END
