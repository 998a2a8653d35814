"""Pictures: error landscapes over the parameter grid (§III-E), rods in space and over images, and curves.

Only this package draws with matplotlib, on its own canvas: no window, no global figure, no changed setting.
"""

from doo_ti.report.canvas import (
    SYMBOLS,
    axis_label,
    distance_colors,
    distinct_colors,
    landscape_colors,
    quantity,
    values_text,
)
from doo_ti.report.figures import (
    Ribbons,
    SeenRod,
    angle_curves_picture,
    identifiability_picture,
    reprojections_picture,
    ribbon_sides,
    ribbons_picture,
)
from doo_ti.report.landscapes import (
    LandscapePanel,
    cells_image,
    landscape_image,
    landscape_picture,
    landscapes_picture,
)
from doo_ti.report.motions import MovingRods, motions_picture

__all__ = [
    "SYMBOLS", "LandscapePanel", "MovingRods", "Ribbons", "SeenRod", "angle_curves_picture", "axis_label", "cells_image",
    "distance_colors", "distinct_colors", "identifiability_picture", "landscape_colors", "landscape_image", "landscape_picture",
    "landscapes_picture", "motions_picture", "quantity", "reprojections_picture", "ribbon_sides", "ribbons_picture",
    "values_text",
]
