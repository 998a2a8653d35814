"""How obstacles are turned: axes about a direction, and checks of what is given."""

import numpy as np

from doo_ti.system.errors import InputError


def require_direction(name: str, field: str, value: np.ndarray, what: str = "of length zero") -> None:
    """Raise InputError unless every row has a length."""
    if not (np.linalg.norm(value, axis=-1) > 0).all():
        raise InputError(name, field, what, "give three numbers that are not all zero")


def require_rotation(name: str, rotation: np.ndarray) -> None:
    """Raise InputError unless every matrix is a rotation."""
    off = np.abs(np.swapaxes(rotation, -1, -2) @ rotation - np.eye(3)).max(initial=0.0)
    if not off <= 1e-6:
        raise InputError(name, "rotation", f"off a rotation by {off:.2g}", "give a 3×3 rotation matrix")
    if not (np.linalg.det(rotation) > 0).all():
        raise InputError(name, "rotation", "a reflection", "give a 3×3 rotation matrix, whose determinant is 1")


def axes_about(direction: np.ndarray) -> np.ndarray:
    """(rows, 3, 3) three axes as columns, the third along ``direction`` (rows, 3)."""
    third = direction / np.linalg.norm(direction, axis=-1, keepdims=True)
    helper = np.where(np.abs(third[:, :1]) < 0.7, [[1.0, 0.0, 0.0]], [[0.0, 1.0, 0.0]])
    first = np.cross(helper, third)
    first /= np.linalg.norm(first, axis=-1, keepdims=True)
    return np.stack([first, np.cross(third, first), third], axis=-1)
