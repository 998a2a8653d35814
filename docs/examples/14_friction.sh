#!/usr/bin/env bash
# Friction of a rope on a table, and its stiffness, from recordings of it being dragged by one end.
set -euo pipefail

cat > table.toml <<'END'
[[obstacles]]
kind = "plane"
point = [0, 0, 0]
normal = [0, 0, 1]
END

# Recordings to learn from: a rope of 0.5 m, dragged in curves, with 0.1 mm of noise at all markers,
# two of which are on the gripper.
drag() {  # a number, a first place and a second one
    { cat <<END
rate_hz = 100
duration_s = 2.0
[rod]
length_mm = 500.0
edges = 56
radius_mm = 4.0
position_mm = [0, 0, 12]
at_rest = true
[materials.rope]
bend = 1.5e6
bend_damping_s = 0.02
[[moments]]
time_s = 0.2
[[moments]]
time_s = 1.1
start_position_mm = [$2, 12]
start_direction = [0.3, -1, 0]
[[moments]]
time_s = 2.0
start_position_mm = [$3, 12]
start_direction = [1, 0, 0]
END
    cat table.toml; echo "friction = 0.4"; } > drag.toml
    doo-ti simulate drag.toml --out made.npz
    python - "$1" <<'END'
import sys
import numpy as np
with np.load("made.npz") as made:
    positions = made["positions_mm"][:, :, [0, 1, *range(4, 57, 4)]]  # (1, T, 16 markers, 3)
noise = np.random.default_rng(int(sys.argv[1])).normal(0.0, 0.1, positions.shape)
np.savez(f"dragged_{sys.argv[1]}.npz", positions_mm=positions + noise, rate_hz=100.0)
END
}
drag 1 "-60, 150" "-200, 60"
drag 2 "100, 120" "180, -40"
drag 3 "-150, 30" "-120, 160"

doo-ti identify dragged_*.npz --free-end --obstacles table.toml --radius 4 --modes 0 --fit bend_damping,friction \
    --out theta.json --picture 14_friction.png

# Final check: what made the recordings is found again.
python - <<'END'
import json
theta = json.load(open("theta.json"))
print(f"friction {theta['friction']:.3f} (0.4 in truth), bend {theta['bend_mm3']:.3g} mm³ (1.5e6)")
assert abs(theta["friction"] / 0.4 - 1) < 0.05 and abs(theta["bend_mm3"] / 1.5e6 - 1) < 0.1
END
