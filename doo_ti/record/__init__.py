"""Recordings for the rerun viewer: a sweep, a figure over the cells of its grid, motions, ribbons, and rods in images.

Only this package imports rerun; import it where it is used, not at a module's top: that takes half a second.
Entities, timelines and counts: docs/recording.md.
"""

from doo_ti.record.images import record_perception, record_servo, record_track
from doo_ti.record.motions import record_group, record_motion, record_ribbons
from doo_ti.record.sweep import CellsOfRun, Rods, SweepTrajectory, record_cells, record_sweep
from doo_ti.record.viewer import FAILED, open_viewer, save_screenshot, serve_viewer

__all__ = ["FAILED", "CellsOfRun", "Rods", "SweepTrajectory", "open_viewer", "record_cells", "record_group",
           "record_motion", "record_perception", "record_ribbons", "record_servo", "record_sweep", "record_track",
           "save_screenshot", "serve_viewer"]
