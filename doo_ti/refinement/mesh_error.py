"""What the mesh's edges of finite length do to where the marks are, and its correction.

A discrete rod clamped in the middle of an edge is off the continuum by h² to leading order. So with marks x_h and x_k on
meshes of edges h and k < h,

    x_0 ≈ x_h + (x_k − x_h) h²/(h² − k²),

and the second term, taken once where a fit has come to and kept, makes the fit one of the continuum to the next order (h⁴).
"""

from dataclasses import replace

import numpy as np

from doo_ti.refinement.held_rod import HeldRod
from doo_ti.refinement.unknowns import Unknowns, Values
from doo_ti.relaxation.newton import Newton
from doo_ti.relaxation.relax import relax
from doo_ti.types import Configuration, Solution


def mesh_correction(unknowns: Unknowns, values: Values, solution: Solution, solver: Newton) -> np.ndarray:
    """(D, M, 3) the second term above, mm; zero for rods that do not end on the same branch of a mesh twice as fine."""
    coarse = unknowns.rod
    finer = replace(unknowns, rod=replace(coarse, edges=2 * coarse.edges - 1))
    fine = relaxed_on(finer, values, solution, coarse, solver)
    h, k = (rod.mesh(values.clip).edge for rod in (coarse, finer.rod))
    change = finer.rod.marks(fine, values.clip) - coarse.marks(solution, values.clip)
    sound = solution.converged & solution.stable & fine.converged & fine.stable
    sound &= np.abs(np.nan_to_num(change, nan=np.inf)).max(axis=(1, 2)) < h
    return np.where(sound[:, None, None], change, 0.0) * h**2 / (h**2 - k**2)


def relaxed_on(unknowns: Unknowns, values: Values, solution: Solution, before: HeldRod, solver: Newton) -> Solution:
    """F on another mesh, from where ``solution`` is on the mesh of ``before``."""
    rod = unknowns.rod
    mesh, old = rod.mesh(values.clip), before.mesh(values.clip)
    middles = 0.5 * (mesh.place[1:] + mesh.place[:-1])
    weights = old.at_edges(middles)[0]
    quaternions = solution.configuration.quaternions
    # Neighbouring frames as quaternions of one sign, so that what lies between them is their mean.
    sign = np.sign(np.einsum("rek,rek->re", quaternions[:, 1:], quaternions[:, :-1]))
    sign = np.concatenate([np.ones((len(sign), 1)), np.cumprod(np.where(sign == 0, 1.0, sign), axis=1)], axis=1)
    between = np.einsum("xe,rek->rxk", weights, sign[..., None] * quaternions)
    between /= np.linalg.norm(between, axis=-1, keepdims=True)
    clamps = rod.mesh_clamps(values.clip, unknowns.pose(values))
    start = np.where(np.isfinite(clamps.start_position), clamps.start_position, solution.configuration.start)
    begin = Configuration(start, between, np.full(rod.edges, mesh.edge))
    return relax(begin, unknowns.material(values), clamps, replace(solver, first_shift=0.0), up=values.theta.up)
