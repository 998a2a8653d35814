"""Clips that hold the end edges whole.

An edge whose tangent is clamped bends from its middle on, as the discrete rod has it: the vertex where it ends has half of the
edge's length to bend in (docs/chain.md). A clip that reaches up to that vertex leaves no such half, and a rod that is
fitted without saying so comes out too soft. Cutting the held edges short, up to the same vertex, says so.
"""

from dataclasses import replace

import numpy as np

from doo_ti.dataset import Observations
from doo_ti.errors import InputError


def held_whole(observations: Observations, length: float) -> Observations:
    """``observations`` whose first and last edges are cut to ``length`` mm from the outside; all inner vertices stay.

    Use it where both ends' tangents or frames are clamped. Where no frame is given the edge keeps its observed direction, and
    the inner vertex is put where the rest length has it, which is where the clamp holds it.
    Raises InputError for a length that is not positive or exceeds one of these edges.
    """
    lengths = observations.rest_length.copy()
    if not 0 < length <= min(lengths[0], lengths[-1]):
        raise InputError(observations.source, "clip", f"{length:g} mm of end edges of {lengths[0]:g} and {lengths[-1]:g} mm",
                         "give a positive length below theirs")
    vertices = observations.vertices.copy()
    for outer, inner, frame in ((0, 1, observations.start_frame), (-1, -2, observations.end_frame)):
        edge = vertices[:, inner] - vertices[:, outer]
        outwards = -edge / np.linalg.norm(edge, axis=-1, keepdims=True)
        if frame is not None:
            outwards = frame[..., 0] * (-1.0 if outer == 0 else 1.0)
        held = vertices[:, outer] - lengths[outer] * outwards
        vertices[:, outer] = held + length * outwards
        if frame is None:
            vertices[:, inner] = held
        lengths[outer] = length
    return replace(observations, vertices=vertices, rest_length=lengths)
