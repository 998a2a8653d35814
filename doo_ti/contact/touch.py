"""Whether contacts stick or slip."""

from enum import IntEnum

HELD = 0.999
"""A contact is said to stick while its friction is below that share of the coefficient times its force."""


class Touch(IntEnum):
    """What a vertex, with the edge that ends there, does at an instant of a motion: touch nothing, stick or slip."""

    NONE = 0
    """They touch nothing."""
    STICKS = 1
    """Friction holds every place where they touch."""
    SLIPS = 2
    """In some place friction is as large as its coefficient allows, or there is none."""
