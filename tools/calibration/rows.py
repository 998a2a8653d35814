"""One row per fitted specimen, kept in a CSV file from which a study that was stopped resumes."""

import csv
import io
from dataclasses import dataclass, field, fields
from pathlib import Path

from doo_ti.system.errors import InputError
from doo_ti.system.files import write_whole
from tools.calibration.coverage import NAMES, Interval
from tools.calibration.specimens import Specimen, Variant

BOUNDS = ("value", "low", "high")
REPORTED = tuple(f"fitted_{name}_{part}" for name in NAMES for part in BOUNDS)


@dataclass(frozen=True)
class Row:
    """A specimen under a variant: its truth, what was fitted, how long that took.

    redrawn  draws that could not be synthesised before this specimen
    seconds  wall time of sweep and refinement
    failure  what the pipeline reported instead of parameters, or ""
    fitted   parameter: (value, low, high), None where not determined or unbounded; what was not reported is left out
    """

    seed: int
    observations: int
    missing: float
    wrong_branch: int
    bend: float
    twist: float
    clip_start_mm: float
    clip_end_mm: float
    rest_curvature_rms_per_mm: float
    rest_curvature_range_mm: float
    label_noise_mm: float
    end_mark_noise: bool
    clip_tilt_deg: float
    redrawn: int
    seconds: float
    failure: str = ""
    fitted: dict[str, tuple] = field(default_factory=dict)

    @property
    def key(self) -> tuple:
        return (self.seed, Variant(self.observations, self.missing, self.wrong_branch))

    def interval(self, name: str) -> Interval | None:
        """The reported value and bounds of one of ``NAMES``; None where it was not reported."""
        truth = {"bend": self.bend, "twist": self.twist, "twist_ratio": self.twist / self.bend}[name]
        return Interval(truth, *self.fitted[name]) if name in self.fitted else None


PLAIN = tuple(one for one in fields(Row) if one.name != "fitted")
COLUMNS = (*(one.name for one in PLAIN), *REPORTED)


def row_of(seed: int, variant: Variant, made: Specimen, parameters: list[dict], seconds: float, failure: str = "") -> Row:
    """The row of a specimen for which ``parameters`` were reported."""
    recipe = made.recipe
    clip_start, clip_end = recipe.clips_mm
    fitted = {one["name"]: tuple(one[part] for part in BOUNDS) for one in parameters if one["name"] in NAMES}
    return Row(
        seed, variant.observations, variant.missing, variant.wrong_branch, recipe.bend, recipe.twist, clip_start, clip_end,
        recipe.rest_curvature_rms_per_mm, recipe.rest_curvature_range_mm, recipe.label_noise_mm, recipe.end_mark_noise,
        recipe.clip_tilt_deg, made.redrawn, seconds, failure, fitted)


def load_rows(path: Path) -> list[Row]:
    """The rows of a file; none where there is no file. Raises InputError for a file with other columns or values."""
    if not path.is_file():
        return []
    lines = list(csv.reader(io.StringIO(path.read_text(encoding="utf-8"))))
    if not lines or tuple(lines[0]) != COLUMNS:
        raise InputError(path, "columns", "are not those of this study", "name another folder with --out")
    rows = []
    for number, cells in enumerate(lines[1:], 2):
        try:
            rows.append(_row(dict(zip(COLUMNS, cells, strict=True))))
        except ValueError as error:
            raise InputError(path, f"line {number}", str(error), "delete that line") from None
    return rows


def save_rows(path: Path, rows: list[Row]) -> None:
    """Write all rows, by seed; an existing file is replaced only when the new one is complete."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(COLUMNS)
    for row in sorted(rows, key=lambda row: (row.observations, row.missing, row.wrong_branch, row.seed)):
        cells = [getattr(row, one.name) for one in PLAIN]
        for name in NAMES:
            cells += ["" if number is None else number for number in row.fitted[name]] if name in row.fitted else ["-"] * 3
        writer.writerow(cells)
    write_whole(path, lambda file: file.write(text.getvalue().encode()))


def _row(cells: dict[str, str]) -> Row:
    read = {bool: lambda text: {"True": True, "False": False}[text], int: int, float: float, str: str}
    try:
        plain = {one.name: read[one.type](cells[one.name]) for one in PLAIN}
    except KeyError as error:
        raise ValueError(f"{error} is neither True nor False") from None
    fitted = {}
    for name in NAMES:
        parts = [cells[f"fitted_{name}_{part}"] for part in BOUNDS]
        if parts != ["-"] * 3:  # a dash: not reported; an empty cell: reported as unbounded or not determined
            fitted[name] = tuple(None if text == "" else float(text) for text in parts)
    return Row(**plain, fitted=fitted)
