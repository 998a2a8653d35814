"""A rod whose stiffness is not known is brought to a shape by both grippers, from eleven marks that are seen with noise."""

import matplotlib.pyplot as plt
import numpy as np

from doo_ti import Clamp, Material, Servo, Simulation, Targets, end_clamps, hanging, relax
from doo_ti.rod.frames import rotation_matrix

# The rod as it hangs, and as it would hang if it were as stiff as is believed.
rod, clamps = hanging(330.0, 33, start=(0, 0, 0), end=(200, 0, 0), clamp=Clamp.FRAME)
true, believed = Material(bend=9e5, twist=6e5), Material(bend=6e5, twist=6e5)
real = relax(rod, true, clamps)

# The wanted shape: of the real rod, after a motion of its grippers that the servo is not told.
goal = end_clamps(rod, Clamp.FRAME, Clamp.FRAME).take([0])
goal.start_position[:] += (30, 60, 0)
goal.end_position[:] += (-20, 80, 40)
goal.end_frame[:] = rotation_matrix(np.array([0.4, -0.5, 0.6])) @ goal.end_frame
wanted = Simulation(real.configuration, true, clamps).step(goal).configuration.vertices

# The loop: see, step, move.
random, marks = np.random.default_rng(1), np.arange(0, 34, 3)
simulation = Simulation(real.configuration, true, clamps)
servo = Servo(rod, believed, clamps, Targets(wanted))
distance = []
for _ in range(30):
    vertices = simulation.state.configuration.vertices
    plt.plot(*vertices[0][:, [1, 2]].T, color="0.7", linewidth=0.5)
    seen = np.full_like(vertices, np.nan)
    seen[:, marks] = vertices[:, marks] + 0.3 * random.normal(size=(1, len(marks), 3))
    simulation.step(servo.step(seen))
    distance.append(np.linalg.norm(simulation.state.configuration.vertices - wanted, axis=-1).mean())

learned = servo.material
low, high = learned.bend_interval[0]
print(f"{distance[0]:.0f} mm after the first step, {distance[-1]:.2f} mm after {len(distance)}")
print(f"bend {learned.bend[0]:.3g} mm³, between {low:.3g} and {high:.3g}; the real rod has {true.bend[0, 0, 0, 0]:.3g}")
plt.plot(*wanted[0][:, [1, 2]].T, linewidth=4, alpha=0.4, label="wanted")
plt.plot(*simulation.state.configuration.vertices[0][:, [1, 2]].T, label="reached")
plt.gca().set(aspect="equal", xlabel="y, mm", ylabel="z, mm")
plt.legend()
plt.savefig("15_servo.png", dpi=100)

# Final check: the rod is where it shall be, and the servo knows how stiff it is.
assert distance[-1] < 1.0
assert low < true.bend[0, 0, 0, 0] < high
