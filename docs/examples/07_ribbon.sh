#!/usr/bin/env bash
# A ribbon bends easily one way and hardly the other: learn both stiffnesses from simulated marks and frames.
set -euo pipefail
scenes=$(dirname "$0")/../../scenes

doo-ti sweep "$scenes/ribbon.toml" --bend-1 5e5:5e7:9 --bend-2 3e4:3e6:9 --out runs/ribbon

# Final check: the best cell is within a factor of 2.5 of the true B = diag(6e6, 1.2e5), and the picture is there.
python - <<'END'
import json
best = json.load(open("runs/ribbon/summary.json"))["best"]
print(f"bend_1 {best['bend_1']:.2g} mm³, bend_2 {best['bend_2']:.2g} mm³")
assert 0.4 < best["bend_1"] / 6e6 < 2.5 and 0.4 < best["bend_2"] / 1.2e5 < 2.5
END
test -s runs/ribbon/landscape.png
