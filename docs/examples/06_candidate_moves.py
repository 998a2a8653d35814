"""Where would a rod go? Two thousand candidate moves of one gripper, in one call: shapes, jumps and forces."""

import time

import matplotlib.pyplot as plt
import numpy as np

from doo_ti import Clamp, Material, end_clamps, predict_step, relax, straight_rod
from doo_ti.rod.frames import rotation_matrix

# A rod of 300 mm whose ends were brought 60 mm closer, so that it bows; both grippers hold it.
rod = straight_rod(300.0, 30, direction=(1, 0, 0))
material = Material(bend=2e7, twist=1.5e7)
clamps = end_clamps(rod, Clamp.FRAME, Clamp.FRAME)
clamps.end_position[:] -= (60, 0, 0)
clamps.start_frame[:] = rotation_matrix(np.array([0, -0.5, 0])) @ clamps.start_frame
clamps.end_frame[:] = rotation_matrix(np.array([0, 0.5, 0])) @ clamps.end_frame
bow = relax(rod, material, clamps).configuration

# Moves of the far gripper by up to 20 mm and turns by up to 30°.
random = np.random.default_rng(1)
moves = clamps.take(np.zeros(2000, dtype=int))
moves.end_position[:] += random.uniform(-20, 20, (2000, 3))
moves.end_frame[:] = rotation_matrix(random.uniform(-0.5, 0.5, (2000, 3))) @ moves.end_frame
predict_step(bow, material, clamps, moves)  # the first call compiles, or loads, the kernels
began = time.perf_counter()
solution, jumps = predict_step(bow, material, clamps, moves)
print(f"2000 moves in {time.perf_counter() - began:.2f} s; {(jumps > 0).sum()} jump to another branch")

# The move after which the middle of the rod is highest.
middle = solution.configuration.vertices[:, 15, 2]
best = np.argmax(np.where(solution.converged & solution.stable, middle, -np.inf))
print(f"highest middle: {middle[best]:.0f} mm after moving by {(moves.end_position - clamps.end_position)[best].round(1)} mm")
for k in range(0, 2000, 20):
    plt.plot(*solution.configuration.vertices[k][:, [0, 2]].T, color="0.7", linewidth=0.5)
plt.plot(*bow.vertices[0][:, [0, 2]].T, label="now")
plt.plot(*solution.configuration.vertices[best][:, [0, 2]].T, label="highest middle")
plt.gca().set(aspect="equal", xlabel="x, mm", ylabel="z, mm")
plt.legend()
plt.savefig("06_candidate_moves.png", dpi=100)

# Final check: the rods end at their grippers, as certified minima.
assert (solution.converged & solution.stable).mean() > 0.99
done = solution.converged
np.testing.assert_allclose(solution.configuration.vertices[done, -1], moves.end_position[done], atol=0.1)
