"""The smooth curve through a rod's vertices: a cubic spline over chord length, twice continuously differentiable."""

import numpy as np


def smooth_curve(vertices: np.ndarray, samples: int) -> np.ndarray:
    """(..., (V − 1) samples + 1, 3) mm: points of the curve through (..., V, 3) vertices, ``samples`` to an edge.

    The curve passes through every vertex; its parameter is chord length. At the ends the first two and the last two edges
    are one cubic each ("not a knot"), so that clamped ends keep their curvature; fewer than four vertices end straight.
    """
    vertices = np.asarray(vertices, dtype=np.float64)
    chord = np.linalg.norm(np.diff(vertices, axis=-2), axis=-1)[..., None]
    slope = np.diff(vertices, axis=-2) / chord
    second = _second_derivatives(chord[..., 0], slope)
    place = np.arange(samples)[:, None] / samples
    h, a, b = (part[..., None, :] for part in (chord, second[..., :-1, :], second[..., 1:, :]))
    start, end = vertices[..., :-1, None, :], vertices[..., 1:, None, :]
    bulge = (1 - place) * place * h * h / 6 * ((2 - place) * a + (1 + place) * b)
    inner = (1 - place) * start + place * end - bulge
    return np.concatenate([inner.reshape(*vertices.shape[:-2], -1, 3), vertices[..., -1:, :]], axis=-2)


def _second_derivatives(chord: np.ndarray, slope: np.ndarray) -> np.ndarray:
    """(..., V, 3) 1/mm: second derivatives at the vertices, of (..., V − 1) chords and their (..., V − 1, 3) slopes."""
    count = chord.shape[-1] + 1
    matrix, wanted = np.zeros((*chord.shape[:-1], count, count)), np.zeros((*chord.shape[:-1], count, 3))
    inner = np.arange(1, count - 1)
    matrix[..., inner, inner - 1], matrix[..., inner, inner + 1] = chord[..., :-1], chord[..., 1:]
    matrix[..., inner, inner] = 2 * (chord[..., :-1] + chord[..., 1:])
    wanted[..., inner, :] = 6 * np.diff(slope, axis=-2)
    if count < 4:
        matrix[..., 0, 0] = matrix[..., -1, -1] = 1
    else:
        for row, first in ((0, 0), (-1, count - 3)):
            before, after = chord[..., first], chord[..., first + 1]
            matrix[..., row, first], matrix[..., row, first + 1] = after, -before - after
            matrix[..., row, first + 2] = before
    return np.linalg.solve(matrix, wanted)
