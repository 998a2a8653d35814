"""A wire harness on a board: a trunk with two branches that are welded to it."""

import matplotlib.pyplot as plt
import numpy as np

from doo_ti import Clamp, Clamps, Group, Material, Plane, Tie, relax_group, straight_rod
from doo_ti.rod.frames import rotation_matrix

# The trunk along x, held by connectors; branches of 140 mm leave it at vertices 12 and 24, to either side, at some 60°.
trunk = straight_rod(360.0, 36, start=(0, 0, 8))
leave, sides = (12, 24), (1.0, -1.0)
branches = [straight_rod(140.0, 14, start=trunk.vertices[0, vertex], direction=(0.5, side, 0))
            for vertex, side in zip(leave, sides, strict=True)]


def held(start, end, place, direction):
    """Clamps of a far end: a connector that holds position and direction."""
    turn = rotation_matrix(np.array([0, 0, np.arctan2(direction[1], direction[0])]))
    return Clamps(start, end, np.array([[0.0, 0.0, 8.0]]), np.array([place], dtype=float), np.eye(3)[None], turn[None])


clamps = [held(Clamp.FRAME, Clamp.TANGENT, (350, 0, 8), (1, 0))]
clamps += [held(Clamp.FREE, Clamp.TANGENT, (trunk.vertices[0, vertex, 0] + 60, side * 90, 8), (0.5, side))
           for vertex, side in zip(leave, sides, strict=True)]
# A weld keeps the angle that the rods have at the start. The clip there has a weight.
ties = [Tie((0, vertex), (1 + number, 0), weight=50.0, weld=True) for number, vertex in enumerate(leave)]
thick, thin = Material(bend=2e6, twist=1.5e6), Material(bend=2e5, twist=1.5e5, weight=0.3)
harness = Group([trunk, *branches], [thick, thin, thin], clamps, ties)
solution = relax_group(harness, obstacles=[Plane((0, 0, 0), (0, 0, 1))], radius=2.0)
print(solution)
for force, moment in zip(solution.tie_force[0], solution.tie_moment[0], strict=True):
    print(f"on the trunk: force {np.linalg.norm(force):.0f} mm²/mm, moment {np.linalg.norm(moment):.0f} mm²")

for number, (rod, force) in enumerate(zip(solution.rods, solution.contact_force, strict=True)):
    x, lies = rod.vertices[0], force[0, :, 2] > 0
    plt.plot(x[:, 0], x[:, 1], linewidth=2 if number else 4, label="branch" if number else "trunk")
    plt.plot(x[lies, 0], x[lies, 1], "k.", markersize=3)
plt.gca().set(aspect="equal", xlabel="x, mm", ylabel="y, mm", title="A harness from above; dots: on the board")
plt.legend()
plt.savefig("13_harness.png", dpi=100)

# Final check: a certified minimum on the board; the branch points stay together, at the angles they had.
assert solution.converged[0] and solution.stable[0] and solution.gap[0] > -1e-3 * 2.0
for number, vertex in enumerate(leave, start=1):
    np.testing.assert_allclose(solution.rods[number].vertices[0, 0], solution.rods[0].vertices[0, vertex], atol=1e-6)
    along = [solution.rods[0].frames[0, vertex, :, 0], solution.rods[number].frames[0, 0, :, 0]]
    np.testing.assert_allclose(along[0] @ along[1], 0.5 / np.hypot(0.5, 1.0), atol=1e-6)
