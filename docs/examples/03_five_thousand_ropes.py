"""Five thousand ropes between two grippers, each with its own stiffness, weight and grippers: shapes, curvature and forces."""

import sys
import time

import matplotlib.pyplot as plt
import numpy as np

from doo_ti import Clamp, Material, hanging, relax

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

tangents = np.diff(solution.configuration.vertices, axis=1) / 25.0  # (R, 40, 3): edges are 25 mm long
curvature = np.linalg.norm(np.diff(tangents, axis=1), axis=-1) / 25.0  # (R, 39) 1/mm at the inner vertices
end_force = solution.end_force_in_newton(weight[:, None])  # (R, 3) N, of the gripper on the rod
start_force = np.array([0, 0, 1.0]) * weight[:, None] - end_force  # both carry the rope, which is 1 m long
print(f"largest curvature 1/({1 / curvature.max():.0f} mm), largest force {np.linalg.norm(end_force, axis=-1).max():.2f} N")
plt.scatter(np.linalg.norm(ends, axis=-1), np.linalg.norm(end_force, axis=-1), c=np.log10(EI), s=2)
plt.colorbar(label="log10 of EI in N m²")
plt.xlabel("distance between the grippers, mm")
plt.ylabel("force of a gripper, N")
plt.savefig("03_five_thousand_ropes.png", dpi=100)

# Final check: the forces of the grippers are the change of energy when one of them moves (in N m per m).
assert (solution.converged & solution.stable).mean() > 0.99
moved = clamps.take(np.arange(count))
moved.end_position[:, 0] += 0.01
other = relax(solution.configuration, material, moved)
change = (other.energy - relax(solution.configuration, material, clamps).energy) / 0.01
kept = other.converged & solution.converged & solution.stable
np.testing.assert_allclose(change[kept], solution.end_force[kept, 0], rtol=1e-2, atol=1e-2 * np.abs(change).max())
