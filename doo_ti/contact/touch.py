"""Whether contacts stick or slip."""

from enum import IntEnum


class Touch(IntEnum):
    """Of a vertex and the edge that ends there, at an instant of a motion."""

    NONE = 0
    """They touch nothing."""
    STICKS = 1
    """Friction holds every place where they touch."""
    SLIPS = 2
    """Some place has as much friction as its coefficient allows, or there is no friction."""
