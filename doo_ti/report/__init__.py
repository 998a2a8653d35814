"""Pictures: error landscapes over the parameter grid (§III-E), ribbons in space (Fig. 5c), and curves.

Only this package draws with matplotlib, on its own canvas: no window, no global figure, no changed setting.
"""

from doo_ti.report.angles import angle_curves_picture
from doo_ti.report.colors import distance_colors, landscape_colors
from doo_ti.report.identifiability import identifiability_picture
from doo_ti.report.landscapes import (
    LandscapePanel,
    cells_image,
    landscape_image,
    landscape_picture,
    landscapes_picture,
)
from doo_ti.report.motions import motions_picture
from doo_ti.report.quantities import MEAN_DISTANCE, SYMBOLS, axis_label, quantity, values_text
from doo_ti.report.reprojections import SeenRod, reprojections_picture
from doo_ti.report.ribbons import Ribbons, ribbon_sides, ribbons_picture

__all__ = [
    "MEAN_DISTANCE", "SYMBOLS", "LandscapePanel", "Ribbons", "SeenRod", "angle_curves_picture", "axis_label", "cells_image",
    "distance_colors", "identifiability_picture", "landscape_colors", "landscape_image", "landscape_picture",
    "landscapes_picture", "motions_picture", "quantity", "reprojections_picture", "ribbon_sides", "ribbons_picture",
    "values_text",
]
