"""Recordings for the rerun viewer: a run over solver iterations, a figure over the cells of its grid, ribbons,
and the growth of rods in images.

Only this package imports rerun; import it where it is used, not at a module's top: that takes half a second.
Entities, timelines and counts: docs/recording.md.
"""

from doo_ti.record.cells import CellsOfRun, Rods, record_cells
from doo_ti.record.motion import record_motion
from doo_ti.record.perception import record_perception
from doo_ti.record.ribbons import record_ribbons
from doo_ti.record.sweep import record_sweep
from doo_ti.record.tracking import record_track
from doo_ti.record.viewer import FILE, open_viewer, save_screenshot
from doo_ti.record.wall import FAILED

__all__ = ["FAILED", "FILE", "CellsOfRun", "Rods", "open_viewer", "record_cells", "record_motion",
           "record_perception", "record_ribbons", "record_sweep", "record_track", "save_screenshot"]
