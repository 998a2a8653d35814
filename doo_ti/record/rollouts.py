"""Rods in motion as a recording: beside what was recorded of them, with errors over time. Axes: R rods, T frames."""

from pathlib import Path

import numpy as np
import rerun
import rerun.blueprint as blueprint

from doo_ti.record.stream import OBSERVED, drawn_strips, log_up, panels, recording, space_view

SIMULATED = (255, 140, 60)
MOST_RODS = 64


def record_rollout(path: Path, name: str, names: list[str], positions: np.ndarray, recorded: np.ndarray | None,
                   rate: float, up=(0.0, 0.0, 1.0)) -> None:
    """Record (R, T, V, 3) rods side by side, at most :data:`MOST_RODS`, mm, on the timeline ``time``.

    ``/world/simulated`` and ``/world/recorded`` hold a strip for each rod; ``/error/NAME`` the mean |difference| in mm.
    """
    rods = positions[:MOST_RODS]
    seen = None if recorded is None else recorded[:MOST_RODS]
    offset = _side_by_side(rods)
    views = [space_view("rods", "/world")]
    if seen is not None:
        views.append(blueprint.TimeSeriesView(name="error [mm]", origin="/error"))
    layout = blueprint.Blueprint(blueprint.Vertical(*views, row_shares=[3, 1][: len(views)]), *panels("time"))
    with recording(path, f"rollout {name}", name, layout) as stream:
        log_up(stream, "/world", np.asarray(up))
        for frame in range(rods.shape[1]):
            stream.set_time("time", duration=frame / rate)
            stream.log("/world/simulated", rerun.LineStrips3D(
                drawn_strips(rods[:, frame] + offset), colors=SIMULATED, labels=names[:MOST_RODS], show_labels=False))
            if seen is not None:
                stream.log("/world/recorded", rerun.LineStrips3D(drawn_strips(seen[:, frame] + offset), colors=OBSERVED))
                error = np.abs(rods[:, frame] - seen[:, frame]).mean(axis=(1, 2))
                stream.log("/error", rerun.Scalars(error[np.isfinite(error)].mean() if np.isfinite(error).any() else np.nan))


def _side_by_side(rods: np.ndarray) -> np.ndarray:
    """(R, 1, 3) offsets along x and y that put the rods into a square grid."""
    columns = int(np.ceil(np.sqrt(len(rods))))
    low, high = np.nanmin(rods, axis=(1, 2)), np.nanmax(rods, axis=(1, 2))
    pitch = 1.1 * (high - low).max(axis=0)[:2]
    place = np.stack([np.arange(len(rods)) % columns, np.arange(len(rods)) // columns], axis=-1)
    return np.concatenate([place * pitch, np.zeros((len(rods), 1))], axis=-1)[:, None]
