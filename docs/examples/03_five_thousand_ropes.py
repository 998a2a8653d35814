"""Five thousand ropes between two grippers, each with its own stiffness, weight and grippers: shapes, curvature, and the
forces and moments of both grippers."""

import sys
import time

import matplotlib.pyplot as plt
import numpy as np

from doo_ti import Clamp, Material, end_loads, hanging, relax

count = int(sys.argv[1]) if len(sys.argv) > 1 else 5000
random = np.random.default_rng(3)
ends = random.uniform((300, -100, -200), (900, 100, 200), (count, 3))  # mm
EI = 10 ** random.uniform(-4, -2, count)  # N m²
weight = random.uniform(0.3, 0.8, count)  # N/m
ropes, clamps = hanging(1000.0, 40, (0, 0, 0), ends, clamp=Clamp.FRAME)
material = Material.from_physical(EI, 0.7 * EI, weight)

few = np.arange(min(count, 64))  # a first call with few ropes, which compiles, or loads, the kernels
relax(ropes.take(few), material.take(few), clamps.take(few), precision="mixed")
began = time.perf_counter()
solution = relax(ropes, material, clamps, precision="mixed")
print(f"{count} ropes in {time.perf_counter() - began:.2f} s, {solution.converged.sum()} converged")

curvature = solution.configuration.curvature  # (R, 39) 1/mm at the inner vertices
loads = end_loads(solution)  # start_force, end_force (R, 3) in N; start_moment, end_moment (R, 3) in N m
moment = np.linalg.norm(loads.end_moment, axis=-1)
print(f"largest curvature 1/({1 / curvature.max():.0f} mm), force {np.linalg.norm(loads.end_force, axis=-1).max():.2f} N, "
      f"moment {moment.max():.3f} N m")
plt.scatter(np.linalg.norm(ends, axis=-1), 1e3 * moment, c=np.log10(EI), s=2)
plt.colorbar(label="log10 of EI in N m²")
plt.xlabel("distance between the grippers, mm")
plt.ylabel("moment of a gripper, N mm")
plt.savefig("03_five_thousand_ropes.png", dpi=100)

# Final check: both forces carry the rope, and the moments balance about its start (lengths in m).
sound = solution.converged & solution.stable
assert sound.mean() > 0.99
np.testing.assert_allclose((loads.start_force + loads.end_force)[sound, 2], weight[sound], atol=1e-9)
centre = 0.5 * (solution.configuration.vertices[:, 1:] + solution.configuration.vertices[:, :-1]).mean(axis=1) / 1e3
balance = (loads.start_moment + loads.end_moment + np.cross(ends / 1e3, loads.end_force)
           - np.cross(centre, weight[:, None] * [0, 0, 1.0]))
assert np.abs(balance[sound]).max() < 1e-7
