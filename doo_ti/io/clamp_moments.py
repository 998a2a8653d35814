"""The clamps of a rod's ends as scenes state them: how they hold, and where they are at some moments.

    start = "frame"                    # free, position, tangent or frame
    end = "free"

    [[moments]]                        # none or more; what is left out stays as it was; smooth between them
    time_s = 0.0
    start_position_mm = [0, 0, 0]      # at first where the rod is
    start_direction = [0, 0, -1]
    end_position_mm = [0, 0, -1000]
    end_direction = [0, 0, -1]
    start_turns = 0.0                  # about its direction, since the beginning (0)
    end_turns = 2.5
"""

from dataclasses import dataclass
from typing import Literal

import numpy as np

from doo_ti.errors import InputError
from doo_ti.frames import bishop_frames, turned_about_tangent
from doo_ti.io.keyframes import between_moments
from doo_ti.io.toml_file import Finite, NotNegative, Table, Vector
from doo_ti.types import Configuration

ClampName = Literal["free", "position", "tangent", "frame"]


class Moment(Table):
    """One moment; what is None stays as it was."""

    time_s: NotNegative
    start_position_mm: Vector | None = None
    start_direction: Vector | None = None
    end_position_mm: Vector | None = None
    end_direction: Vector | None = None
    start_turns: Finite | None = None
    end_turns: Finite | None = None


@dataclass(frozen=True)
class EndPaths:
    """Where both ends of a rod are held at T instants: positions (T, 3) mm, and frames (T, 3, 3) with columns t, m1, m2."""

    start_position: np.ndarray
    end_position: np.ndarray
    start_frame: np.ndarray
    end_frame: np.ndarray


def end_paths(source, key: str, rows: list, start: Configuration, time: np.ndarray) -> EndPaths:
    """The paths of the ends of one rod at the instants ``time`` (T,) s.

    rows   the moments, the value of ``key`` in the file ``source``
    start  the rod: where its ends are as long as no moment says otherwise

    An end does not turn about its direction while that changes (a Bishop frame over time), other than by its ``turns``. Raises
    InputError as :func:`.between_moments` does, and where the way between two directions leads through none.
    """
    vertices, frames = start.vertices[0], start.frames[0]
    first = {"start_position_mm": vertices[0], "start_direction": frames[0, :, 0], "end_position_mm": vertices[-1],
             "end_direction": frames[-1, :, 0], "start_turns": 0.0, "end_turns": 0.0}
    paths = between_moments(source, key, rows, Moment, first, time)
    held = {}
    for end, edge in (("start", 0), ("end", -1)):
        direction = paths[f"{end}_direction"]
        size = np.linalg.norm(direction, axis=-1, keepdims=True)
        if not (size > 0).all():
            raise InputError(source, key, f"{end}_direction turns around in one step", "give a direction between")
        held[end] = turned_about_tangent(bishop_frames(direction / size, frames[edge, :, 1]),
                                         2 * np.pi * paths[f"{end}_turns"])
    return EndPaths(paths["start_position_mm"], paths["end_position_mm"], held["start"], held["end"])
