#!/usr/bin/env bash
# From marks in your own CSV file, in metres with y up, to the bend stiffness EI with its 95 % interval.
set -euo pipefail
data=$(dirname "$0")/data

# Columns pose, mark, x, y, z: ten poses of a cable with 26 marks. Its outer 40 mm are in grippers.
doo-ti sweep "$data/cable.csv" --unit m --up 0,1,0 --columns observation=pose,vertex=mark \
    --EI 1e-5:1e-1:25 --linear-density 50 --out runs/cable  # the cable weighs 50 g/m
# This cable is straight at rest; leave --rest-curvature out for a real one.
doo-ti refine runs/cable --parameters bend --linear-density 50 --rest-curvature none --no-models --out refined.json

# Final check: the interval of EI contains the true value, 1e-3 N m².
python - <<'END'
import json
EI, low, high = json.load(open("refined.json"))[0]["stiffness"]["EI_Nm2"]
print(f"EI = {EI:.3g} N m², 95 %: {low:.3g} to {high:.3g}")
assert low < 1e-3 < high < 1.1 * low
END
