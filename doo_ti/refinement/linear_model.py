"""The residuals of all observations, linear in the unknowns, around where a fit is.

    r_d = r_d(now) + J_d x + Z_d z_d + noise,    x ~ N(x̄, A⁻¹), z_d ~ N(0, S), noise ~ N(0, σ²)

x are the P unknowns that all observations share, z_d the Q effects of one observation: how far its clamps are off, and the
amplitudes of smooth displacements that the model has no other place for. x is counted from where the fit is, z_d from zero.
Axes: D observations, N residuals of one kind in each.
"""

from dataclasses import dataclass

import numpy as np

from doo_ti.refinement.held_rod import POSE


@dataclass(frozen=True)
class Residuals:
    """Residuals of one kind, all with the noise of ``scale``, a name of :mod:`doo_ti.refinement.scales`.

    values   (D, N) with z_d = 0; zero where nothing was seen
    shared   (D, N, P) J
    effects  (D, N, Q) Z
    count    (D,) how many independent numbers count
    """

    scale: str
    values: np.ndarray
    shared: np.ndarray
    effects: np.ndarray
    count: np.ndarray


@dataclass(frozen=True)
class Moments:
    """Products of the residuals of one kind, which is all that the evidence needs of them.

    squares  Σ r²
    shared   (P, P) Σ JᵀJ, and (P,) Σ Jᵀr
    mixed    (D, P, Q) JᵀZ
    effects  (D, Q, Q) ZᵀZ, and (D, Q) Zᵀr
    count    numbers compared
    """

    scale: str
    squares: float
    shared: np.ndarray
    shared_slope: np.ndarray
    mixed: np.ndarray
    effects: np.ndarray
    effects_slope: np.ndarray
    count: float

    @classmethod
    def of(cls, residuals: Residuals) -> "Moments":
        # Products per observation, then sums: an observation's share does not depend on its company.
        transposed = np.swapaxes(residuals.shared, 1, 2)
        values = residuals.values[..., None]
        return cls(
            residuals.scale, float((residuals.values**2).sum()), (transposed @ residuals.shared).sum(axis=0),
            (transposed @ values).sum(axis=0)[:, 0], transposed @ residuals.effects,
            np.swapaxes(residuals.effects, 1, 2) @ residuals.effects,
            (np.swapaxes(residuals.effects, 1, 2) @ values)[..., 0], float(residuals.count.sum()))


def smooth_modes(place: np.ndarray, held: tuple[bool, bool], count: int) -> np.ndarray:
    """(M, G) smooth displacements of marks at arc lengths ``place`` (M,) that are zero where an end is held, the k-th shrunk by
    1/k²."""
    share = (place - place[0]) / (place[-1] - place[0])
    k = np.arange(1, count + 1)
    if all(held):
        modes = np.sin(np.pi * np.outer(share, k))
    elif held[0]:
        modes = np.sin(np.pi * np.outer(share, k - 0.5))
    else:
        modes = np.cos(np.pi * np.outer(share, k - 0.5))
    return modes / k**2


GAP_MODES = 6


def effect_scales(effects: int) -> tuple[str, ...]:
    """(Q,) the scale of each effect of an observation: poses first, if there are any, then the gap's amplitudes."""
    poses = ("turn_scatter",) * 6 + ("shift_scatter",) * 6
    gap = ("gap",) * (3 * GAP_MODES)
    return poses + gap if effects == POSE + len(gap) else gap
