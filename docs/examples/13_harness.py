"""A wire harness: a trunk with two branches, each tied to an edge of it, on a board."""

import matplotlib.pyplot as plt
import numpy as np

from doo_ti import Clamp, Clamps, Group, Material, Plane, Tie, relax_group, straight_rod
from doo_ti.frames import rotation_matrix

# The trunk along x, held by connectors; branches of 140 mm leave it at vertices 12 and 24, to either side.
trunk = straight_rod(360.0, 36, start=(0, 0, 8))
leave, sides = (12, 24), (1.0, -1.0)
branches = [straight_rod(140.0, 14, start=trunk.vertices[0, vertex - 1], direction=(1, 0, 0)) for vertex in leave]


def held(start, end, place, direction):
    """Clamps of a far end: a connector that holds position and direction."""
    turn = rotation_matrix(np.array([0, 0, np.arctan2(direction[1], direction[0])]))
    return Clamps(start, end, np.array([[0.0, 0.0, 8.0]]), np.array([place], dtype=float), np.eye(3)[None], turn[None])


clamps = [held(Clamp.FRAME, Clamp.TANGENT, (350, 0, 8), (1, 0))]
clamps += [held(Clamp.FREE, Clamp.TANGENT, (trunk.vertices[0, vertex, 0] + 60, side * 90, 8), (0.5, side))
           for vertex, side in zip(leave, sides, strict=True)]
# Two neighbouring vertices tied: a branch shares an edge of the trunk, and so its direction. A clip there has a weight.
ties = [Tie((0, vertex - 1 + k), (1 + number, k), weight=k * 50.0) for number, vertex in enumerate(leave) for k in (0, 1)]
thick, thin = Material(bend=2e6, twist=1.5e6), Material(bend=2e5, twist=1.5e5, weight=0.3)
harness = Group([trunk, *branches], [thick, thin, thin], clamps, ties)
solution = relax_group(harness, obstacles=[Plane((0, 0, 0), (0, 0, 1))], radius=2.0, contact=False)
pulls = solution.tie_force[0].reshape(2, 2, 3).sum(axis=1)
print(solution, f"\nforces of the branches on the trunk {np.linalg.norm(pulls, axis=-1).round()} mm²/mm")

for number, (rod, force) in enumerate(zip(solution.rods, solution.contact_force, strict=True)):
    x, lies = rod.vertices[0], force[0, :, 2] > 0
    plt.plot(x[:, 0], x[:, 1], linewidth=2 if number else 4, label="branch" if number else "trunk")
    plt.plot(x[lies, 0], x[lies, 1], "k.", markersize=3)
plt.gca().set(aspect="equal", xlabel="x, mm", ylabel="y, mm", title="A harness from above; dots: on the board")
plt.legend()
plt.savefig("13_harness.png", dpi=100)

# Final check: a certified minimum on the board; the branch points stay together and share the trunk's direction.
assert solution.converged[0] and solution.stable[0] and solution.gap[0] > -1e-3 * 2.0
for number, vertex in enumerate(leave, start=1):
    main, branch = solution.rods[0].vertices[0], solution.rods[number].vertices[0]
    np.testing.assert_allclose(branch[:2], main[vertex - 1 : vertex + 1], atol=1e-6)
