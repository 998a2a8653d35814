"""Motions of rods that may touch themselves (docs/contact.md): only rods that come near to themselves are computed as such."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from doo_ti.dynamics.adaptive import put
from doo_ti.dynamics.parameters import Stepping
from doo_ti.dynamics.trajectory import Trajectory
from doo_ti.relaxation.self_approach import approach_in_motion


def kept_apart(moved: Callable[..., Trajectory], stepping: Stepping, rows: np.ndarray, start: np.ndarray, radius: np.ndarray,
               progress: Callable[[int], None] | None) -> Trajectory:
    """The motion of the rods ``rows``, which are their own obstacles: of all of them as if they were not, and of those that
    may have touched themselves from one frame to the next, or passed through themselves, once more, in f64.

    moved   (stepping, rows, progress, touching): a motion without or with contact of the rods with themselves, and which rods
            have passed through themselves, as the link of their frames says
    start   (R, V, 3) mm, their places at first
    radius  (1 or R,) mm
    """
    radius = np.asarray(radius, dtype=np.float64).reshape(-1)
    found, near = moved(stepping, rows, progress)
    lengths = np.linalg.norm(np.diff(start, axis=1), axis=-1)
    places = np.concatenate([start[:, None], found.positions], axis=1)
    own = np.arange(len(rows))
    near = near | approach_in_motion(places[:, 0], places[:, 0], own, lengths, radius)
    for frame in range(found.positions.shape[1]):
        near |= approach_in_motion(places[:, frame], places[:, frame + 1], own, lengths, radius)
    if found.contact_force is None:
        found = replace(found, contact_force=np.zeros_like(found.positions),
                        touch=np.zeros(found.positions.shape[:3], dtype=np.int8))
    again = np.flatnonzero(near)
    if len(again):
        put(found, again, moved(replace(stepping, precision="f64"), rows[again], None, True)[0], slice(None))
    return found
