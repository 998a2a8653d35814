"""The grid view of a recording: observations side by side in an upright plane, because in space they overlap.

Axes: D observations, V vertices.
"""

from dataclasses import dataclass, field
from typing import Annotated

import numpy as np

from doo_ti.report.canvas import box, deviations, widest
from doo_ti.rod.observations import Observations
from doo_ti.system.arguments import short_repr, typed

FLAT = 3.0
"""Of what is seen from above: the depth of a view from the side over its height."""
SLENDER = 0.1
"""Of the larger extent of observations: the least width of a column."""
UNITS = {"mm": " mm", "deg": "°"}


@typed
@dataclass(frozen=True)
class Observed:
    """Observations as recordings show them.

    vertices  (D, V, 3) mm, NaN where a mark is missing
    labels    {"end_distance_mm": (D,), "end_rotation_deg": (D,)}, those that are known: the first makes the columns of the grid
              view, the second its rows
    up        (3,) direction against gravity
    numbers   (D,) what the file calls the observations, or None: 0, 1, …
    """

    __repr__ = short_repr

    vertices: Annotated[np.ndarray, "D V 3"]
    labels: dict[str, np.ndarray] = field(default_factory=dict)
    up: Annotated[np.ndarray, "3"] = (0.0, 0.0, 1.0)
    numbers: Annotated[np.ndarray | None, "D"] = None

    @classmethod
    @typed
    def of(cls, observations: Observations) -> "Observed":
        labels = {"end_distance_mm": observations.end_distance, "end_rotation_deg": observations.end_rotation}
        return cls(np.where(observations.valid[..., None], observations.vertices, np.nan),
                   {label: values for label, values in labels.items() if values is not None}, observations.up,
                   observations.labels)

    @property
    def names(self) -> list[str]:
        """``observation 13: 42 mm 60°`` for each of the D observations."""
        values = [[_quantity(label, value) for value in column] for label, column in self.labels.items()]
        numbers = range(len(self.vertices)) if self.numbers is None else self.numbers
        return [" ".join([f"observation {d}:", *parts]) if parts else f"observation {d}"
                for d, parts in zip(numbers, zip(*values, strict=True) if values else [()] * len(self.vertices), strict=True)]


@dataclass(frozen=True)
class GridView:
    """A place for each observation and its rods in an upright plane.

    offset         (D, 3) mm, added to rod and observation: subtract it for true coordinates. The first is zero
    headings       [(text, (3,) mm)] of columns and rows
    meaning        what columns and rows are
    centre, extent (3,) mm, and (width, height) mm
    basis          (3, 3) rows right, into the plane, up
    """

    offset: np.ndarray
    headings: list
    meaning: str
    centre: np.ndarray
    extent: np.ndarray
    basis: np.ndarray


def grid_view(observed: Observed) -> GridView:
    """Places in the plane along the main horizontal direction of the observations.

    Two labels that distinguish all observations, and leave at most half of the places empty, make columns and rows, ascending
    to the right and down; else observations are in reading order.
    """
    vertices, basis = observed.vertices, upright_basis(observed.vertices, observed.up)
    local = vertices @ basis.T
    low, high = box(local)
    size = (high - low).max(axis=0)
    width = max(size[0], SLENDER * widest(low[:, [0, 2]], high[:, [0, 2]]))
    pitch = np.array([1.12 * width, 0.0, -1.1 * size[2] - 0.1 * width])
    column, row, titles, meaning = _places(observed.labels, len(vertices), abs(pitch[2]) / pitch[0])
    # Centred in its column and about the plane; its lowest point at the bottom of its row.
    anchor = np.stack([0.5 * (low + high)[:, 0], 0.5 * (low + high)[:, 1], low[:, 2]], axis=-1)
    target = np.stack([column, 0 * column, row], axis=-1) * pitch
    shift = anchor[0] - target[0]
    above, left = np.array([0.0, 0.0, size[2] - 0.55 * pitch[2]]), np.array([-0.75 * pitch[0], 0.0, 0.4 * size[2]])
    headings = [(text, (shift + (above if on_top else left) + k * pitch * ([1, 0, 0] if on_top else [0, 0, 1])) @ basis)
                for on_top, k, text in titles]
    margin = (-1.1 if titles else -0.6, 0, -1.7 if any(on_top for on_top, _, _ in titles) else -1.1)
    corners = np.array([margin, (column.max() + 0.6, 0, row.max() + 0.2)]) * pitch
    return GridView((target + shift - anchor) @ basis, headings, meaning, (corners.mean(axis=0) + shift) @ basis,
                    np.abs(corners[1] - corners[0])[[0, 2]], basis)


def upright_basis(vertices: np.ndarray, up) -> np.ndarray:
    """(3, 3) rows: the main horizontal direction of rods (D, V, 3), the direction into that plane, up."""
    up = np.asarray(up, float) / np.linalg.norm(up)
    spread = deviations(vertices)
    spread = (spread - (spread @ up)[..., None] * up).reshape(-1, 3)
    # Up is a null direction of the spread; the small term keeps it last where the marks lie on one vertical line.
    right = np.linalg.eigh(spread.T @ spread - 1e-9 * (1 + np.sum(spread**2)) * np.outer(up, up))[1][:, -1]
    right = -right if right @ np.nansum(vertices[:, -1] - vertices[:, 0], axis=0) < 0 else right
    return np.stack([right, np.cross(up, right), up])


def facing(vertices: np.ndarray, up) -> tuple[np.ndarray, str]:
    """What points up in a view of rods (D, V, 3), and from where that is: from the side or, if they are flat, as on a table,
    from above."""
    basis = upright_basis(vertices, up)
    _, depth, height = np.std(deviations(vertices) @ basis.T, axis=(0, 1))
    return (basis[1], "from above") if depth > FLAT * height else (basis[2], "from the side")


def label_table(first, second) -> tuple | None:
    """(columns, (D,) column of each observation, rows, (D,) row) by two labels, (D,) each; None where these do not distinguish
    all observations."""
    columns, column = np.unique(np.asarray(first, float), return_inverse=True)
    rows, row = np.unique(np.asarray(second, float), return_inverse=True)
    return (columns, column, rows, row) if len(np.unique(row * len(columns) + column)) == len(row) else None


def _places(labels: dict, count: int, aspect: float) -> tuple[np.ndarray, np.ndarray, list, str]:
    """Column and row (D,) of each observation; titles (above a column or left of a row, its number, text); what columns and
    rows are."""
    if len(labels) >= 2:
        (across, first), (down, second) = list(labels.items())[:2]
        found = label_table(first, second)
        if found and len(found[0]) * len(found[2]) <= 2 * count:
            columns, column, rows, row = found
            return (column, row, [(True, k, _quantity(across, value)) for k, value in enumerate(columns)]
                    + [(False, k, _quantity(down, value)) for k, value in enumerate(rows)],
                    f"columns: {_words(across)}, rows: {_words(down)}")
    width = min(count, int(np.ceil(np.sqrt(1.2 * count * aspect))))
    index = np.arange(count)
    titles = [(False, k, f"from {k * width}") for k in range(-(-count // width))] if count > 1 else []
    return index % width, index // width, titles, "observations in reading order" if count > 1 else ""


def _quantity(label: str, value: float) -> str:
    return f"{value:g}{UNITS.get(label.rpartition('_')[2], '')}"


def _words(label: str) -> str:
    return label.rpartition("_")[0].replace("_", " ")
