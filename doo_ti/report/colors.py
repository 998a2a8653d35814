"""Colours of distances: one scale for pictures and recordings."""

import numpy as np

MISSING = "#9a9a9a"
"""What has no distance."""


def landscape_colors(values: np.ndarray, landscape: np.ndarray) -> np.ndarray:
    """(..., 3) uint8 of ``values`` in mm, as the picture of ``landscape`` colours them; grey where NaN."""
    return _colors(norm_of(landscape), values)


def distance_colors(distance: np.ndarray, scale: np.ndarray | None = None) -> np.ndarray:
    """(..., 3) uint8 for rods on a dark ground: teal, the smallest distance of ``scale``, to yellow, the largest; grey
    where NaN. The scale is that of ``distance`` itself unless another one is given."""
    from matplotlib.colors import LogNorm, Normalize

    norm = norm_of(distance if scale is None else scale)
    # The dark half of the map would not show: start the scale below the data.
    if isinstance(norm, LogNorm):
        norm = LogNorm(norm.vmin * (norm.vmin / norm.vmax) ** 0.9, norm.vmax)
    else:
        norm = Normalize(norm.vmin - 0.9 * (norm.vmax - norm.vmin), norm.vmax)
    return _colors(norm, distance)


def norm_of(values: np.ndarray):
    """The colour scale of distances. A sweep spans decades: on a linear scale the valley would be one colour."""
    from matplotlib.colors import LogNorm, Normalize

    finite = values[np.isfinite(values)]
    low, high = (float(finite.min()), float(finite.max())) if finite.size else (0.0, 1.0)
    return LogNorm(low, high) if 0 < 3 * low < high else Normalize(low, high if high > low else low + 1)


def _colors(norm, values: np.ndarray) -> np.ndarray:
    from matplotlib import colormaps
    from matplotlib.colors import to_rgba

    color_map = colormaps["viridis"].with_extremes(bad=to_rgba(MISSING))
    return color_map(norm(np.ma.masked_invalid(values)), bytes=True)[..., :3]
