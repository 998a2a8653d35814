"""Scenes: an experiment in one TOML file, its observations, the grid to search and how (§V-A).

    name = "silk"                 # the rod's material
    frame_weight_mm = 0.0         # w_m of Eq. 1
    clamp_start = "frame"         # position, tangent, frame or free; left out: frame where it is given, else tangent
    clamp_end = "frame"
    objective = "static"          # Eq. 2, or "dynamic", Eq. 3
    pairs = "pairs.csv"           # of Eq. 3, relative to the scene; left out: from the labels, as in the paper
    spins = 0                     # hypotheses where an end's spin is unknown although it was held; 0: it spins
    precision = "mixed"           # f32, f64 or mixed

    [observations]                # a file, its path relative to the scene …
    file = "silk.npz"

    [synthesis]                   # … or the virtual lab: the fields of Synthesis
    bend = 1.5e5
    twist = 5e4

    [grid]                        # axes as the command line writes them
    bend = "5e4:1e7:25"
    twist_ratio = "0.1:6:25"
"""

import hashlib
import math
import os
import tomllib
from dataclasses import dataclass, fields
from pathlib import Path

import numpy as np

from doo_ti.errors import InputError
from doo_ti.grid import UNITS, Grid, parse_axis, parse_bend
from doo_ti.io.files import MOST_TEXT_BYTES, read_content
from doo_ti.types import LARGEST, Clamp, Material

OBJECTIVES = ("static", "dynamic")
PRECISIONS = ("f32", "f64", "mixed")
MOST_SPINS = 360
MOST_FINE_EDGES, MOST_TURNS = 20_000, 1000
"""Of a virtual rod."""
LARGEST_TILT_DEG = 45.0
"""Standard deviation of a virtual clip's tilt."""
CLAMPS = tuple(kind.name.lower() for kind in Clamp)


@dataclass(frozen=True)
class Synthesis:
    """What the virtual lab makes: one rod, its ends held at each distance and turned to each rotation.

    bend, twist, weight    Θ of the rod, mm³ and relative; bend is α or a 2×2 matrix B
    name                   what the rod is called
    seed                   of everything random
    length_mm, marks       the rod and the number V of marks on it, evenly spaced, ends included
    fine_edge_mm           edge length of the mesh that is relaxed; marks and clips lie on its vertices
    end_distances_mm, end_rotations_deg   every distance with every rotation
    rest_curvature_rms_per_mm             of the random curvature of the rod at rest, pointwise, about each of m1 and m2
    rest_curvature_range_mm               0: independent at each joint of the fine mesh; above: a smooth Gaussian random field
                           along the rod in its material frame, whose correlation over a distance s is exp(-s²/(2 range²))
    clip_mm                length of rod held at each end, or a pair: held at the start, held at the end
                           (the first joint beside it bends over a whole fine edge, so the continuous rod that this mesh
                           stands for is held half a fine edge less)
    label_noise_mm         standard deviation of each coordinate of the marks
    end_mark_noise         whether the marks that clips hold have that noise too; else they are known exactly
    start_direction, end_direction        where the clips point along the rod; clips on one line would hide Θ
    frames                 whether the material frames are labelled too (ribbons)

    A user's clamps do not hold a rod exactly as reported: it lies at an angle in the jaw, or the clamp's pose is
    calibrated imperfectly. Frames, and marks inside clips, are reported as of the ideal clips; the rod is held as follows.

    clip_tilt_deg          each clip is tilted about its outer end, by a rotation vector across its tangent; standard deviation
                           of its two components. Drawn once for each end; it turns with the clip
    clip_offset_mm         each clip is displaced sideways; standard deviation of the two components, drawn likewise
    clip_scatter_deg       a tilt of each clip in each observation by itself, added to the constant one

    Raises InputError for values out of range.
    """

    bend: float | tuple
    twist: float
    weight: float = 1.0
    name: str = "rod"
    seed: int = 0
    length_mm: float = 99.0
    marks: int = 34
    fine_edge_mm: float = 1.0
    end_distances_mm: tuple[float, ...] = (30.0, 42.0, 54.0, 66.0, 78.0, 90.0)
    end_rotations_deg: tuple[float, ...] = tuple(30.0 * k for k in range(10))
    rest_curvature_rms_per_mm: float = 1 / 900
    clip_mm: float | tuple[float, float] = 3.0
    label_noise_mm: float = 0.12
    start_direction: tuple[float, float, float] = (0.94, 0.0, 0.34)
    end_direction: tuple[float, float, float] = (0.85, 0.22, -0.48)
    frames: bool = False
    rest_curvature_range_mm: float = 0.0
    end_mark_noise: bool = False
    clip_tilt_deg: float = 0.0
    clip_offset_mm: float = 0.0
    clip_scatter_deg: float = 0.0
    source: str = "synthesis"

    def __post_init__(self):
        for field in fields(self):
            value = _convert(self.source, field.name, getattr(self, field.name))
            object.__setattr__(self, field.name, value)
        self._require("seed", self.seed >= 0, "0 or more")
        self._require("marks", self.marks >= 3, "3 or more")
        for name in ("length_mm", "fine_edge_mm", "twist"):
            self._require(name, getattr(self, name) > 0, "a positive number")
        self._require("clip_mm", min(self.clips_mm) > 0, "a positive number, or two of them")
        for name in ("weight", "rest_curvature_rms_per_mm", "rest_curvature_range_mm", "label_noise_mm", "clip_tilt_deg",
                     "clip_offset_mm", "clip_scatter_deg"):
            self._require(name, getattr(self, name) >= 0, "zero or a positive number")
        self._require("rest_curvature_range_mm", self.rest_curvature_range_mm <= self.length_mm,
                      f"a range of at most length_mm = {self.length_mm:g}")
        for name in ("clip_tilt_deg", "clip_scatter_deg"):
            self._require(name, getattr(self, name) <= LARGEST_TILT_DEG, f"at most {LARGEST_TILT_DEG:g} degrees")
        self._require("clip_offset_mm", self.clip_offset_mm < self.length_mm, "an offset shorter than the rod")
        self._require("length_mm", self.length_mm <= MOST_FINE_EDGES * self.fine_edge_mm,
                      f"at most {MOST_FINE_EDGES} fine edges")
        spacing = ("marks", self.length_mm / (self.marks - 1))
        for name, length in (spacing, *(("clip_mm", clip) for clip in self.clips_mm)):
            count = length / self.fine_edge_mm
            self._require(name, round(count) >= 1 and math.isclose(count, round(count), rel_tol=1e-6),
                          f"a spacing of marks and a clip that are multiples of fine_edge_mm = {self.fine_edge_mm:g}")
        self._require("clip_mm", 2 * max(self.clips_mm) < self.length_mm, "clips shorter than half the rod")
        for name in ("end_distances_mm", "end_rotations_deg"):
            values = getattr(self, name)
            self._require(name, len(values) > 0 and len(set(values)) == len(values), "different numbers, at least one")
        self._require("end_rotations_deg", max(map(abs, self.end_rotations_deg)) <= MOST_TURNS * 360.0,
                      f"at most {MOST_TURNS} turns")
        distances = self.end_distances_mm
        self._require("end_distances_mm", 0 < min(distances) and max(distances) < self.length_mm,
                      f"distances between 0 and length_mm = {self.length_mm:g}")
        for name in ("start_direction", "end_direction"):
            direction = getattr(self, name)
            self._require(name, len(direction) == 3 and any(direction) and max(map(abs, direction)) <= LARGEST,
                          "a vector X, Y, Z")
        bend = self.bend * np.eye(2) if isinstance(self.bend, float) else np.array(self.bend)
        self._require("bend", (bend == bend.T).all() and np.linalg.eigvalsh(bend)[0] > 0, "a positive definite B")

    @property
    def clips_mm(self) -> tuple[float, float]:
        """Lengths of rod held at the start and at the end."""
        return self.clip_mm if isinstance(self.clip_mm, tuple) else (self.clip_mm, self.clip_mm)

    def material(self) -> Material:
        """Θ, straight at rest: the table of one material."""
        return Material(np.array(self.bend), self.twist, self.weight)

    def _require(self, name: str, holds: bool, remedy: str) -> None:
        if not holds:
            value = getattr(self, name)
            raise InputError(self.source, f"synthesis.{name}", f"{value!r} is out of range", f"give {remedy}")


@dataclass(frozen=True)
class Scene:
    """One experiment: what was observed, or how to synthesise it, and the search over Θ.

    observations  the file, or the recipe
    frame_weight  w_m of Eq. 1, mm
    clamp_start, clamp_end  Clamp, or None: the frame where it is given, else the tangent
    objective     "static", Eq. 2, or "dynamic", Eq. 3
    pairs         the file of Eq. 3's pairs, or None: from the labels
    spins         hypotheses, evenly over a turn, where an end's spin is unknown although it was held; 0: it spins
    """

    name: str
    observations: Path | Synthesis
    grid: Grid
    frame_weight: float = 0.0
    clamp_start: Clamp | None = None
    clamp_end: Clamp | None = None
    objective: str = "static"
    pairs: Path | None = None
    spins: int = 0
    precision: str = "mixed"
    source: str = "scene"
    sha256: str = ""


def load_scene(path: str | os.PathLike) -> Scene:
    """The scene of a TOML file. Raises InputError for unreadable files, unknown keys, wrong types and values."""
    path = Path(path)
    content = read_content(path, MOST_TEXT_BYTES, "name a readable scene")
    try:
        table = tomllib.loads(content.decode())
    except (ValueError, RecursionError) as error:
        raise InputError(path, "file", f"not TOML ({error})", "correct the scene") from None
    known = ("name", "frame_weight_mm", "clamp_start", "clamp_end", "objective", "pairs", "spins", "precision",
             "observations", "synthesis", "grid")
    _check_keys(path, "", table, known)
    if ("observations" in table) == ("synthesis" in table):
        raise InputError(path, "observations", "neither or both of [observations] and [synthesis]", "give one of them")
    name = _text(path, "name", table.get("name", path.stem))
    if not name.isprintable() or name in (".", "..") or set(name) & set("/\\") or len(name) > 200:
        raise InputError(path, "name", f"{name[:40]!r} names no folder", "give a name without / or \\, folders are called so")
    objective = _choice(path, "objective", table.get("objective", "static"), OBJECTIVES)
    return Scene(
        name=name,
        observations=_observations(path, table) if "observations" in table else _synthesis(path, name, table),
        grid=_grid(path, _section(path, table, "grid")),
        frame_weight=_weight(path, table.get("frame_weight_mm", 0.0)),
        clamp_start=_clamp(path, table, "clamp_start"),
        clamp_end=_clamp(path, table, "clamp_end"),
        objective=objective,
        pairs=_pairs(path, table, objective),
        spins=_spins(path, table.get("spins", 0)),
        precision=_choice(path, "precision", table.get("precision", "mixed"), PRECISIONS),
        source=str(path),
        sha256=hashlib.sha256(content).hexdigest(),
    )


def _check_keys(path, section: str, table: dict, known) -> None:
    unknown = [key for key in table if key not in known]
    if unknown:
        where = f"{section}.{unknown[0]}" if section else unknown[0]
        raise InputError(path, where, "unknown scene key", f"the keys are {', '.join(known)}")


def _section(path, table: dict, key: str) -> dict:
    if not isinstance(table.get(key), dict):
        problem = "missing" if key not in table else f"{table[key]!r} is no table"
        raise InputError(path, key, problem, f"add the table [{key}]")
    return table[key]


def _observations(path: Path, table: dict) -> Path:
    section = _section(path, table, "observations")
    _check_keys(path, "observations", section, ("file",))
    if "file" not in section:
        raise InputError(path, "observations.file", "missing", 'give file = "…", relative to the scene')
    return path.parent / _text(path, "observations.file", section["file"])


def _synthesis(path: Path, name: str, table: dict) -> Synthesis:
    section = _section(path, table, "synthesis")
    known = [field.name for field in fields(Synthesis) if field.name not in ("name", "source")]
    _check_keys(path, "synthesis", section, known)
    for needed in ("bend", "twist"):
        if needed not in section:
            raise InputError(path, f"synthesis.{needed}", "missing", f"give the rod's {needed} in mm³")
    return Synthesis(**section, name=name, source=str(path))


def _grid(path: Path, section: dict) -> Grid:
    _check_keys(path, "grid", section, tuple(UNITS))
    axes, bend_12 = [], 0.0
    for name, value in section.items():
        if isinstance(value, bool) or not isinstance(value, (str, int, float)):
            raise InputError(path, f"grid.{name}", f"{value!r} is no axis", 'give a number or "LO:HI:N[:log|:lin]"')
        if name == "bend":
            found, bend_12 = parse_bend(str(value), name, str(path))
            axes += found
        else:
            axes.append(parse_axis(name, str(value), str(path)))
    return Grid(tuple(axes), bend_12, str(path))


def _weight(path: Path, value) -> float:
    if isinstance(value, bool) or not isinstance(value, (int, float)) or not 0 <= value <= LARGEST:
        raise InputError(path, "frame_weight_mm", f"{value!r} is no length", "give zero or a positive number of mm")
    return float(value)


def _pairs(path: Path, table: dict, objective: str) -> Path | None:
    if "pairs" not in table:
        return None
    if objective != "dynamic":
        raise InputError(path, "pairs", "given, but the objective is static", 'give objective = "dynamic" too')
    return path.parent / _text(path, "pairs", table["pairs"])


def _spins(path: Path, value) -> int:
    if type(value) is not int or not 0 <= value <= MOST_SPINS:
        raise InputError(path, "spins", f"{value!r} is no number of angles", f"give 0 to {MOST_SPINS}")
    return value


def _clamp(path: Path, table: dict, key: str) -> Clamp | None:
    return Clamp[_choice(path, key, table[key], CLAMPS).upper()] if key in table else None


def _choice(path: Path, key: str, value, choices: tuple[str, ...]) -> str:
    if value not in choices:
        raise InputError(path, key, f"{value!r} is none of the choices", f"give one of {', '.join(choices)}")
    return value


def _text(path: Path, key: str, value) -> str:
    if not isinstance(value, str) or not value:
        raise InputError(path, key, f"{value!r} is no text", "give text in quotes")
    return value


def _convert(source: str, name: str, value):
    """A field of Synthesis in its type. Raises InputError where it has another."""
    kind = {field.name: field.type for field in fields(Synthesis)}[name]
    what = {str: "text", int: "a whole number below 2**63", bool: "true or false", float: "a finite number"}.get(
        kind, {"bend": "a positive number or a matrix [[A1, A12], [A12, A2]]",
               "clip_mm": "a length in mm, or two: [START, END]"}.get(name, "a list of finite numbers"))
    shapes = {"bend": ((), (2, 2)), "clip_mm": ((), (2,))}.get(name, ((),) if kind is float else None)
    try:
        if kind in (str, int, bool):
            if type(value) is not kind or kind is int and abs(value) >= 2**63:
                raise TypeError
            return value
        return _finite(value, shapes)
    except (TypeError, ValueError):
        raise InputError(source, f"synthesis.{name}", f"{value!r} has the wrong type", f"give {what}") from None


def _finite(value, shapes: tuple | None):
    """A float, or a tuple of as many levels as the array has, of one of these ``shapes``, None: of any one-dimensional shape;
    else TypeError."""
    array = np.asarray(value)
    fits = array.ndim == 1 if shapes is None else array.shape in shapes
    if array.dtype.kind not in "iuf" or not fits or not np.isfinite(array).all():
        raise TypeError
    values = array.astype(float).tolist()
    return values if array.ndim == 0 else tuple(map(tuple, values)) if array.ndim == 2 else tuple(values)
