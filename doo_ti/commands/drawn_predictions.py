"""Pictures and recordings of ``doo-ti predict``. Axes: T moments, R rods, V vertices."""

import hashlib
from pathlib import Path

import numpy as np

from doo_ti.rod.frames import matrix_from_quaternion
from doo_ti.rod.types import Clamp


def draw_prediction(task, prediction, arrays: dict[str, np.ndarray], pictures: dict[str, Path | None],
                    lines: list[str]) -> None:
    """Write what is asked for.

    task      what was predicted, with its name, names of rods, clamps, direction against gravity, marks and surroundings
    arrays    those of the file
    pictures  path or None by suffix, ``.png`` and ``.rrd``
    lines     the result as text
    """
    from doo_ti.report import MovingRods, motions_picture
    from doo_ti.report.touched import Touched

    marks = None if task.marks is None else task.marks[prediction.motion]
    touched = None if not task.surroundings else Touched(task.surroundings, *(
        np.swapaxes(arrays[name], 0, 1) for name in ("vertices_mm", "contact_force")), task.newtons)
    rods = MovingRods(prediction.time, arrays["vertices_mm"], task.names, prediction.jumps, prediction.followed, task.up,
                      _gripper_lines(task, prediction, arrays["vertices_mm"]), marks, touched)
    if pictures[".png"] is not None:
        motions_picture(pictures[".png"], rods, title=task.name)
    if pictures[".rrd"] is not None:
        from doo_ti.record import record_motion

        force, unit = ("end_force_N", "N") if "end_force_N" in arrays else ("end_force", "mm")
        curves = {"Energy [mm²]": prediction.energy, "Total twist [°]": arrays["total_twist_deg"],
                  f"Force at the far clamp [{unit}]": np.linalg.norm(arrays[force], axis=-1)}
        record_motion(pictures[".rrd"], run_id=hashlib.sha256(rods.vertices.tobytes()).hexdigest()[:32], name=task.name,
                      rods=rods, curves=curves, text="\n\n".join(line.strip() for line in lines))


def _gripper_lines(task, prediction, vertices: np.ndarray) -> np.ndarray:
    """(T, R, 4, 2, 3) mm: at each end the edge that is held, and a bar across it along m1; NaN where an end is free."""
    lines = np.full((*vertices.shape[:2], 4, 2, 3), np.nan)
    half = 0.02 * prediction.rest_length.sum()
    for first, edge, kind in ((0, 0, task.clamps.start), (2, -1, task.clamps.end)):
        held = np.broadcast_to(np.asarray(kind) > Clamp.FREE, len(task.clamps.start_position))[prediction.motion]
        place = vertices[:, :, edge]
        across = half * matrix_from_quaternion(prediction.quaternions[:, :, edge])[..., 1]
        lines[:, held, first] = vertices[:, held][:, :, (0, 1) if edge == 0 else (-2, -1)]
        lines[:, held, first + 1] = np.stack([place - across, place + across], axis=2)[:, held]
    return lines
