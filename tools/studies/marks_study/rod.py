"""Equilibria of a Kirchhoff rod as a continuum, clamped at both ends: a boundary value problem, by spectral collocation.

The unknowns are the rotations R(s) of the cross sections at Legendre–Gauss–Lobatto points and the force n(0) in the start
clamp. With R' = R [κ], m = R b B (κ − κ₀), b(s) a relative stiffness, n(s) = n(0) + w s up and r' = t, they solve
m' + t × n = 0 and ∫ t = r(L) − r(0). Lengths are in rod lengths, moments in EI / L: bend stiffness is 1, twist stiffness
GJ / EI, and weight w L³ / EI.

Each rod is followed from a circular arc without weight, an equilibrium known in closed form, to its clamps and weight; in the
end its second variation says whether it is stable. Rods are solved many at a time.
"""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.polynomial import legendre
from scipy.spatial.transform import Rotation

TOLERANCE = 1e-8  # rad, of the last Newton step
TAIL = 1e-5       # largest share of the last Legendre coefficients of the tangent
NEWTON = 7        # steps before a continuation step is halved
SMALLEST = 2e-3   # continuation step


@dataclass(frozen=True)
class Points:
    """Legendre–Gauss–Lobatto points on [0, 1], their weights, and the matrices of differentiation and to coefficients."""

    s: np.ndarray
    weights: np.ndarray
    derivative: np.ndarray
    coefficients: np.ndarray

    def integral_to(self, s: np.ndarray) -> np.ndarray:
        """(len(s), points): values at the points to the integral of their polynomial from 0 to s."""
        columns = []
        for k in range(len(self.s)):
            one = legendre.legint(np.eye(len(self.s))[k], lbnd=-1) / 2
            columns.append(legendre.legval(2 * np.asarray(s) - 1, one))
        return np.stack(columns, axis=-1) @ self.coefficients


@lru_cache
def points(degree: int) -> Points:
    last = np.eye(degree + 1)[degree]
    x = np.concatenate([[-1.0], np.sort(legendre.legroots(legendre.legder(last)).real), [1.0]])
    values = legendre.legval(x, last)
    gaps = x[:, None] - x + np.eye(degree + 1)
    derivative = values[:, None] / (values * gaps)
    np.fill_diagonal(derivative, 0.0)
    derivative[0, 0], derivative[-1, -1] = -degree * (degree + 1) / 4, degree * (degree + 1) / 4
    return Points((x + 1) / 2, 1 / (degree * (degree + 1) * values**2), 2 * derivative,
                  np.linalg.inv(legendre.legvander(x, degree)))


def cross(v: np.ndarray) -> np.ndarray:
    """(…, 3, 3): the matrix of v ×."""
    zero = np.zeros(v.shape[:-1])
    x, y, z = np.moveaxis(v, -1, 0)
    return np.stack([zero, -z, y, z, zero, -x, -y, x, zero], axis=-1).reshape(*v.shape, 3)


def turned(rotation: np.ndarray) -> np.ndarray:
    """(…, 3, 3) of rotation vectors."""
    return Rotation.from_rotvec(rotation.reshape(-1, 3)).as_matrix().reshape(*rotation.shape, 3)


def rotation_vector(frames: np.ndarray) -> np.ndarray:
    return Rotation.from_matrix(frames.reshape(-1, 3, 3)).as_rotvec().reshape(frames.shape[:-1])


@dataclass
class Rods:
    """P rods as above; frames are (P, points, 3, 3) with the columns t, m1, m2."""

    at: Points
    frames: np.ndarray
    force: np.ndarray       # (P, 3) in the start clamp
    ratio: float            # GJ / EI
    weight: np.ndarray      # (P, 3), w up
    curvature: np.ndarray   # (P, points, 3) of the unloaded rod, in its frames
    span: np.ndarray        # (P, 3) between the clamps
    stiffness: np.ndarray   # (points,) b

    def bending(self) -> np.ndarray:
        """(P, points, 3): curvature of the rods as they are held, in their frames; the first component is the twist."""
        spin = np.swapaxes(self.frames, -1, -2) @ np.einsum("jk,pkab->pjab", self.at.derivative, self.frames)
        return np.stack([spin[..., 2, 1] - spin[..., 1, 2], spin[..., 0, 2] - spin[..., 2, 0],
                         spin[..., 1, 0] - spin[..., 0, 1]], axis=-1) / 2

    def moments(self) -> np.ndarray:
        return (self.frames @ ((self.bending() - self.curvature) * self.scaled([self.ratio, 1, 1]))[..., None])[..., 0]

    def scaled(self, diagonal: list[float]) -> np.ndarray:
        """(points, 3) b times the ``diagonal`` of B."""
        return self.stiffness[:, None] * diagonal

    def linearised(self):
        """Residual (P, points, 3) of the moments, its derivative (P, points, 3, points, 3) by rotations, and the tangents."""
        d, tangents, m = self.at.derivative, self.frames[..., 0], self.moments()
        n = self.force[:, None] + self.at.s[:, None] * self.weight[:, None]
        stiffness = (self.frames * self.scaled([self.ratio, 1, 1])[:, None]) @ np.swapaxes(self.frames, -1, -2)
        by = np.einsum("pkab,kl->pkalb", stiffness, d)
        each = np.arange(len(d))
        by[:, each, :, each, :] -= np.moveaxis(cross(m), 1, 0)
        rods, count = by.shape[:2]
        by = (d @ by.reshape(rods, count, -1)).reshape(by.shape)
        by[:, each, :, each, :] += np.moveaxis(cross(n) @ cross(tangents), 1, 0)
        return np.einsum("jk,pka->pja", d, m) + np.cross(tangents, n), by, tangents

    def newton_step(self, end_turn: np.ndarray) -> np.ndarray:
        """Take one step, at which the end's frame turns by ``end_turn``; returns its largest rotation, (P,)."""
        residual, by, tangents = self.linearised()
        rods, count = tangents.shape[:2]
        inner = 3 * (count - 2)
        arms = cross(tangents)
        matrix, right = np.zeros((rods, inner + 3, inner + 3)), np.empty((rods, inner + 3))
        matrix[:, :inner, :inner] = by[:, 1:-1, :, 1:-1].reshape(rods, inner, inner)
        matrix[:, :inner, inner:] = arms[:, 1:-1].reshape(rods, inner, 3)
        weighted = self.at.weights[:, None, None] * arms
        matrix[:, inner:, :inner] = np.moveaxis(weighted[:, 1:-1], 1, 2).reshape(rods, 3, inner)
        known = np.einsum("pjab,pb->pja", by[:, 1:-1, :, -1], end_turn)
        right[:, :inner] = -(residual[:, 1:-1] + known).reshape(rods, inner)
        gap = np.einsum("j,pja->pa", self.at.weights, tangents) - self.span
        right[:, inner:] = gap - np.einsum("pab,pb->pa", weighted[:, -1], end_turn)
        step = np.linalg.solve(matrix, right[..., None])[..., 0]
        rotation = np.zeros((rods, count, 3))
        rotation[:, 1:-1], rotation[:, -1] = step[:, :inner].reshape(rods, -1, 3), end_turn
        self.frames = turned(rotation) @ self.frames
        self.force = self.force + step[:, inner:]
        return np.abs(rotation).max((1, 2))

    def stable(self) -> np.ndarray:
        """(P,): whether the second variation of the energy is positive where the ends are held."""
        _, by, tangents = self.linearised()
        rods, count = tangents.shape[:2]
        inner = 3 * (count - 2)
        form = -(self.at.weights[:, None, None, None] * by)[:, 1:-1, :, 1:-1].reshape(rods, inner, inner)
        held = (self.at.weights[:, None, None] * cross(tangents))[:, 1:-1].reshape(rods, inner, 3)
        free = np.linalg.qr(held, mode="complete")[0][:, :, 3:]
        reduced = np.swapaxes(free, 1, 2) @ (form + np.swapaxes(form, 1, 2)) @ free
        return np.linalg.eigvalsh(reduced)[:, 0] > 0

    def resolved(self) -> np.ndarray:
        """(P,): whether the tangent's expansion has converged."""
        size = np.abs(np.einsum("kj,pja->pka", self.at.coefficients, self.frames[..., 0]))
        return size[:, -3:].max((1, 2)) < TAIL

    def points_at(self, s: np.ndarray) -> np.ndarray:
        """(P, len(s), 3): places at these lengths from the start."""
        return np.einsum("mj,pja->pma", self.at.integral_to(s), self.frames[..., 0])


def arcs(at: Points, start: np.ndarray, chord: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Frames of the circular arcs that leave ``start`` and end in the direction ``chord``, and the places of their ends."""
    axis = np.cross(start[..., 0], chord)
    sine = np.linalg.norm(axis, axis=-1)
    half = np.arctan2(sine, (start[..., 0] * chord).sum(-1))
    axis *= (2 * half / sine)[:, None]
    frames = turned(at.s[:, None] * axis[:, None]) @ start[:, None]
    return frames, chord * (np.sin(half) / half)[:, None]


def equilibria(degree, ratio, weight, start, span, end, curvature, stiffness) -> tuple[Rods, np.ndarray]:
    """P rods between the clamps ``start`` (P, 3, 3) at 0 and ``end`` at ``span`` (P, 3), and which of them are stable ones
    that were reached and resolved.

    weight     (P, 3), w up L³ / EI
    curvature  (points, 3) of the unloaded rod, times the length
    stiffness  (points,) b
    """
    at = points(degree)
    frames, arc_end = arcs(at, start, span / np.linalg.norm(span, axis=-1, keepdims=True))
    arc_frame, rods = frames[:, -1].copy(), len(span)
    turn = rotation_vector(end @ np.swapaxes(arc_frame, 1, 2))
    force, done, step = np.zeros((rods, 3)), np.zeros(rods), np.full(rods, 0.1)
    while (active := np.flatnonzero((done < 1) & (step > SMALLEST))).size:
        goal = np.minimum(done + step, 1.0)[active]
        share = goal[:, None]
        part = Rods(at, frames[active], force[active], ratio, share * weight[active],
                    share[..., None] * curvature[None], arc_end[active] + share * (span - arc_end)[active], stiffness)
        target = turned(share * turn[active]) @ arc_frame[active]
        ended, live, taken = np.zeros(len(active), bool), np.ones(len(active), bool), np.zeros(len(active))
        for _ in range(NEWTON):
            moved = part.newton_step(rotation_vector(target @ np.swapaxes(part.frames[:, -1], 1, 2)))
            taken += ~ended
            live &= moved < 0.8
            ended |= moved < TOLERANCE
            if (ended | ~live).all():
                break
        good = ended & live
        frames[active[good]], force[active[good]], done[active[good]] = part.frames[good], part.force[good], goal[good]
        step[active] *= np.where(good, np.where(taken <= 4, 1.7, 1.0), 0.4)
    found = Rods(at, frames, force, ratio, weight, np.broadcast_to(curvature, (rods, *curvature.shape)), span, stiffness)
    reached = np.flatnonzero(done >= 1)
    right = np.zeros(rods, bool)
    if reached.size:
        kept = Rods(at, frames[reached], force[reached], ratio, weight[reached], found.curvature[reached], span[reached],
                    stiffness)
        right[reached] = kept.stable() & kept.resolved()
    return found, right
