"""How objects that hold arrays are printed: in one line, with shapes in place of numbers."""

from dataclasses import fields

import numpy as np


def short_repr(self: object) -> str:
    """``EndLoads(start_force (60, 3), …, physical True)``: of each field of a dataclass the shape, or the value where it is
    short. Fields that are not printed by a dataclass are left out, and so are those that are None."""
    parts = []
    for entry in fields(self):  # type: ignore[arg-type]
        value = getattr(self, entry.name)
        if entry.repr and value is not None:
            parts.append(f"{entry.name} {_short(value)}")
    return f"{type(self).__name__}({', '.join(parts)})"


def _short(value: object) -> str:
    if isinstance(value, np.ndarray):
        return f"{value.shape}" if value.ndim else f"{value:g}"
    text = repr(value)
    return text if len(text) <= 60 else f"{len(value)} entries" if hasattr(value, "__len__") else type(value).__name__


def span_text(values: np.ndarray, unit: str = "") -> str:
    """``6e+05 mm³``, or ``1e+05 to 3e+05 mm³`` where values differ."""
    low, high = (f"{value:.4g}" for value in (np.min(values), np.max(values)))
    return (low if low == high else f"{low} to {high}") + f" {unit}" * bool(unit)


def counted(count: int, what: str) -> str:
    """``1 rod``, ``60 rods``."""
    return f"{count} {what}{'s' * (count != 1)}"
