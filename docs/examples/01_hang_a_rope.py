"""Hang three ropes of different stiffness between two hooks, and compare their sag and their pull."""

import matplotlib.pyplot as plt
import numpy as np

from doo_ti import Material, hanging, relax

# Three ropes of 1 m, 40 edges each, between hooks 0.3 m apart; they weigh 0.5 N/m. Positions are in mm, z points up.
stiffness = np.array([1e-5, 1e-3, 1e-1])  # EI in N m²
rope, clamps = hanging(1000.0, 40, start=np.zeros((3, 3)), end=(300, 0, 0))
solution = relax(rope, Material.from_physical(EI=stiffness, GJ=stiffness, weight_per_length=np.full(3, 0.5)), clamps)

vertices = solution.configuration.vertices  # (3, 41, 3)
pull = np.linalg.norm(solution.end_force_in_newton(0.5), axis=-1)
for k in range(3):
    print(f"EI {stiffness[k]:g} N m²: sag {-vertices[k, :, 2].min():.0f} mm, pull {pull[k]:.2f} N")
    plt.plot(vertices[k, :, 0], vertices[k, :, 2], label=f"EI = {stiffness[k]:g} N m²")
plt.gca().set(aspect="equal", xlabel="x, mm", ylabel="z, mm")
plt.legend()
plt.savefig("01_hang_a_rope.png", dpi=100)

# Final check: certified minima; the limp rope hangs as a catenary, and each hook carries half the weight.
assert solution.converged.all() and solution.stable.all()
a = 50.044  # mm, from 1000 = 2 a sinh(150/a)
assert abs(-vertices[0, :, 2].min() - a * (np.cosh(150 / a) - 1)) < 2
np.testing.assert_allclose(solution.end_force_in_newton(0.5)[:, 2], 0.25, rtol=1e-6)
