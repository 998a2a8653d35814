"""A rod as a function in JAX: the rest curvature with which a cantilever is straight under its own weight.
Needs JAX: pip install jax"""

import jax
import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np
from scipy.optimize import minimize

from doo_ti import Clamp, Material, end_clamps, pullback, relax, straight_rod

jax.config.update("jax_enable_x64", True)
LENGTH, BEND = 300.0, 2.7e7
rod = straight_rod(LENGTH, 30, vertex_clamps=True)
clamps = end_clamps(rod, Clamp.FRAME, Clamp.FREE)
straight, joints = rod.vertices[0], (rod.edges - 1, 2)


def solved(curvature):
    return relax(rod, Material(BEND, BEND, rest_curvature=np.asarray(curvature)[None]), clamps)


def gradient(curvature, cotangent):
    name = "rest_curvature_per_joint"
    return pullback(solved(curvature), np.asarray(cotangent)[None], [name])[name][0]


@jax.custom_vjp
def vertices(curvature):
    """(V, 3) mm of the rod at rest with that curvature (E−1, 2), 1/mm."""
    shape = jax.ShapeDtypeStruct(straight.shape, jnp.float64)
    return jax.pure_callback(lambda own: solved(own).configuration.vertices[0], shape, curvature)


def backward(curvature, cotangent):
    return (jax.pure_callback(gradient, jax.ShapeDtypeStruct(joints, jnp.float64), curvature, cotangent),)


vertices.defvjp(lambda curvature: (vertices(curvature), curvature), backward)

s = straight[1:-1, 0] / LENGTH
basis = jnp.stack([s**0, 2 * s - 1, 6 * s**2 - 6 * s + 1]) / LENGTH  # of the curvature in both directions


def loss(coefficients):
    return jnp.mean((vertices(basis.T @ coefficients.reshape(3, 2)) - straight) ** 2)


found = minimize(jax.jit(jax.value_and_grad(loss)), np.zeros(6), jac=True, tol=1e-8)
curvature = np.asarray(basis.T @ found.x.reshape(3, 2))
sagging, held_up = (solved(own).configuration.vertices[0] for own in (np.zeros(joints), curvature))
print(f"sag {-sagging[-1, 2]:.1f} mm without rest curvature, {abs(held_up[-1, 2]):.4f} mm with it; {found.nfev} evaluations")
for label, shape in (("without rest curvature", sagging), ("with the one that was found", held_up)):
    plt.plot(shape[:, 0], shape[:, 2], label=label)
plt.legend(title="A cantilever under its own weight")
plt.gca().set(aspect="equal", xlabel="x, mm", ylabel="z, mm")
plt.savefig("16_gradients_jax.png", dpi=100)

# Final check: the curvature is that of the moment of the weight beyond, w (L − s)²/2 over EI, where EI/w = BEND/2.
np.testing.assert_allclose(np.linalg.norm(curvature, axis=1), LENGTH**2 * (1 - s) ** 2 / BEND, atol=1e-4 * LENGTH**2 / BEND)
