"""Whether contacts stick or slip."""

from enum import IntEnum


class Touch(IntEnum):
    """What a vertex, with the edge that ends there, does at an instant of a motion: touch nothing, stick or slip."""

    NONE = 0
    """They touch nothing."""
    STICKS = 1
    """Friction holds every place where they touch."""
    SLIPS = 2
    """In some place friction is as large as its coefficient allows, or there is none."""
