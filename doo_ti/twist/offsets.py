"""What a gripper tells of a rod's far end, from a file: how the observations' end frames lie to each other (§IV-B).

    offset_deg        τ of Eq. 4, whole turns included; or
    end_frame         frames of the last edge, columns t, m1, m2 (in CSV nine columns end_frame_t_x, end_frame_m1_x, …), and
    start_frame       the same of the first edge, where the near end is not at rest
    total_twist_deg   to pick the whole turns of the end frames

each with a row per observation, in npz or CSV.
"""

from dataclasses import replace
from pathlib import Path

import numpy as np

from doo_ti.errors import InputError
from doo_ti.io.arrays import frame_columns, read_arrays
from doo_ti.io.observations import Observations

MOST_DEG = 36_000.0
_FIELDS = {"start_frame": "start_frame", "end_frame": "end_frame", "total_twist_deg": "total_twist"}
KNOWN = {"offset_deg": ((), ("offset_deg",)), "total_twist_deg": ((), ("total_twist_deg",)),
         "start_frame": ((3, 3), frame_columns("start_frame")), "end_frame": ((3, 3), frame_columns("end_frame"))}


def load_offsets(path: Path, observations: Observations) -> tuple[Observations, np.ndarray | None]:
    """The observations with the frames of the file, and τ (N,) in rad where the file holds it.

    Raises InputError for files that cannot be read, hold neither, or hold other than a row for each observation.
    """
    arrays = read_arrays(Path(path), KNOWN)
    for key, value in arrays.items():
        wanted = (observations.count, *KNOWN[key][0])
        if value.shape != wanted:
            raise InputError(path, key, f"shape {value.shape}", f"make it {wanted}, one for each observation")
    if "offset_deg" in arrays:
        if not (np.abs(arrays["offset_deg"]) <= MOST_DEG).all():
            raise InputError(path, "offset_deg", "not finite, or more than 100 turns", "give degrees, whole turns included")
        return observations, np.radians(arrays["offset_deg"])
    if "end_frame" not in arrays:
        raise InputError(path, "end_frame", "missing", "give offset_deg or end_frame")
    if "total_twist_deg" in arrays:
        arrays["total_twist_deg"] = np.radians(arrays["total_twist_deg"])
    known = {_FIELDS[key]: value for key, value in arrays.items()}
    return replace(observations, source=str(path), **known), None
