"""Rods as a function in PyTorch: bending and twisting stiffness from 60 noisy shapes of one rod.
Needs PyTorch: pip install torch"""

import matplotlib.pyplot as plt
import numpy as np
import torch

from doo_ti import Clamp, Material, end_clamps, pullback, relax, straight_rod
from doo_ti.rod.frames import rotation_matrix

rng = np.random.default_rng(1)
rod = straight_rod(300.0, 30).take(np.zeros(60, dtype=int))  # held in 60 ways
clamps = end_clamps(rod, Clamp.FRAME, Clamp.FRAME)
clamps.end_position[:] += rng.uniform((-150, -80, -80), (-60, 80, 80), (60, 3))
clamps.end_frame[:] = rotation_matrix(rng.normal(0.0, 0.8, (60, 3))) @ clamps.end_frame


class Rods(torch.autograd.Function):
    """(R, V, 3) vertices of rods at rest, mm, from their bend and twist stiffness (R,), mm³."""

    @staticmethod
    def forward(ctx, bend, twist):
        ctx.solution = relax(rod, Material(bend.numpy(), twist.numpy()), clamps)
        return torch.from_numpy(ctx.solution.configuration.vertices)

    @staticmethod
    def backward(ctx, cotangent):
        pulled = pullback(ctx.solution, cotangent.numpy(), ("bend", "twist"))
        return tuple(torch.from_numpy(np.where(pulled.usable, pulled[name], 0.0)) for name in ("bend", "twist"))


true = np.array([8e6, 5e6])
seen = relax(rod, Material(*true), clamps).configuration.vertices
seen = torch.from_numpy(seen + rng.normal(0.0, 0.5, seen.shape))

logarithm = torch.tensor(np.log([4e6, 1.2e7]), requires_grad=True)
optimizer = torch.optim.LBFGS([logarithm], lr=0.5, max_iter=30, line_search_fn="strong_wolfe")
path = []


def closure():
    optimizer.zero_grad()
    bend, twist = logarithm.exp()  # one of each for all rods
    error = ((Rods.apply(bend.expand(60), twist.expand(60)) - seen) ** 2).mean(dim=(1, 2))
    loss = torch.log1p(error).mean()  # a rod on another branch than the one that was seen counts little
    loss.backward()
    path.append([loss.item(), bend.item(), twist.item()])
    return loss


optimizer.step(closure)
path, found = np.array(path), logarithm.exp().detach().numpy()
print(f"bend {found[0]:.4g}, twist {found[1]:.4g} mm³ after {len(path)} evaluations; true {true[0]:.4g}, {true[1]:.4g}")
for column, name in ((1, "bend"), (2, "twist")):
    plt.semilogy(path[:, column] / true[column - 1], label=f"{name}, found over true")
plt.gca().set(xlabel="evaluation", title="Stiffness from 60 shapes with 0.5 mm of noise")
plt.legend()
plt.savefig("17_gradients_torch.png", dpi=100)

# Final check.
np.testing.assert_allclose(found, true, rtol=0.01)
