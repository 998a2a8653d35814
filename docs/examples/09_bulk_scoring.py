"""Score thousands of (observation, material) pairs in one call: distances, energies and statuses come back as arrays."""

import sys
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

from doo_ti import Material, distance, load_observations, observation_clamps, relax, start_configuration

# Ten observed poses of a cable, in metres with y up, under 400 materials: 4000 rods.
file = Path(__file__).parent / "data" / "cable.csv"
observations = load_observations(file, unit="m", up=(0, 1, 0), columns={"observation": "pose", "vertex": "mark"})
count = int(sys.argv[1]) if len(sys.argv) > 1 else 400
material = Material(bend=np.geomspace(5e5, 5e7, count), twist=4e6)

clamps = observation_clamps(observations)
rows, cells = np.divmod(np.arange(observations.count * count), count)
solution = relax(start_configuration(observations, clamps), material, clamps, up=observations.up, precision="mixed",
                 configuration_index=rows, material_index=cells)
error = distance(solution.configuration, observations, rows).reshape(observations.count, count)  # Eq. 1, mm
print(f"{len(rows)} rods: {solution.converged.sum()} converged, {solution.stable.sum()} certified stable")

best = material.bend[np.argmin(error.mean(axis=0)), 0, 0, 0]
print(f"smallest mean error {error.mean(axis=0).min():.2f} mm at bend {best:.3g} mm³")
plt.loglog(material.bend[:, 0, 0, 0], error.T, color="0.7", linewidth=0.8)
plt.loglog(material.bend[:, 0, 0, 0], error.mean(axis=0), label="mean of ten poses")
plt.xlabel("bend stiffness, mm³")
plt.ylabel("distance to the marks (Eq. 1), mm")
plt.legend()
plt.savefig("09_bulk_scoring.png", dpi=100)

# Final check: all rods converged, each row of results is that of its own pair, and the minimum is near the true stiffness.
assert solution.converged.all() and np.isfinite(error).all()
alone = relax(start_configuration(observations, clamps).take([3]), material.take([count // 2]), clamps.take([3]),
              up=observations.up, precision="mixed")
np.testing.assert_array_equal(alone.energy[0], solution.energy[3 * count + count // 2])
assert 0.5 < best / 4.08e6 < 2
