"""Scenes: an experiment in one TOML file: its observations, the grid to search, and the options of the search (§V-A;
docs/scenes.md)."""

import hashlib
import math
import os
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from msgspec import Meta

from doo_ti.io.toml_file import (
    NotNegative,
    NumberOrMatrix,
    NumberOrPair,
    Positive,
    Table,
    Vector,
    checked,
    read_toml,
    unknown_key,
)
from doo_ti.rod.grid import UNITS, Grid, parse_axes
from doo_ti.rod.types import LARGEST, Clamp, Material
from doo_ti.system.errors import InputError, require

OBJECTIVES = ("static", "dynamic")
PRECISIONS = ("f32", "f64", "mixed")
CLAMPS = tuple(kind.name.lower() for kind in Clamp)
MOST_ROLLS = 360
MOST_FINE_EDGES, MOST_TURNS = 20_000, 1000  # of a virtual rod
Rolls = Annotated[int, Meta(ge=0, le=MOST_ROLLS)]
_Rotation = Annotated[float, Meta(ge=-360 * MOST_TURNS, le=360 * MOST_TURNS)]
_Tilt = Annotated[float, Meta(ge=0, le=45)]  # degrees, standard deviation of a virtual clip's tilt


@dataclass(frozen=True)
class Synthesis:
    """A simulated experiment: one rod, its ends clamped at each end distance and end rotation.

    bend, twist, weight    Θ of the rod, mm³ and relative; bend is α or a 2×2 matrix B
    name                   name of the rod
    seed                   of all random numbers
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
    start_direction, end_direction        directions of the clips along the rod; if on one line, shapes hardly depend on Θ
    frames                 whether the material frames are labelled too (ribbons)

    A user's clamps do not hold a rod exactly as reported: it lies at an angle in the jaw, or the clamp's pose is
    calibrated imperfectly. Frames, and marks inside clips, are reported as of the ideal clips; the rod is held as follows.

    clip_tilt_deg          each clip is tilted about its outer end, by a rotation vector across its tangent; standard deviation
                           of its two components. Drawn once for each end; it turns with the clip
    clip_offset_mm         each clip is displaced sideways; standard deviation of the two components, drawn likewise
    clip_scatter_deg       a tilt of each clip in each observation by itself, added to the constant one

    yield_curvature_per_mm 0: elastic; above: ideally plastic bending. Beyond this curvature from rest a joint bends without a
                           larger moment, and keeps the excess as rest curvature in all later observations

    Raises InputError for values out of range.
    """

    bend: NumberOrMatrix
    twist: Positive
    weight: NotNegative = 1.0
    name: str = "rod"
    seed: Annotated[int, Meta(ge=0, le=2**63 - 1)] = 0
    length_mm: Positive = 99.0
    marks: Annotated[int, Meta(ge=3, le=MOST_FINE_EDGES + 1)] = 34
    fine_edge_mm: Positive = 1.0
    end_distances_mm: tuple[Positive, ...] = (30.0, 42.0, 54.0, 66.0, 78.0, 90.0)
    end_rotations_deg: tuple[_Rotation, ...] = tuple(30.0 * k for k in range(10))
    rest_curvature_rms_per_mm: NotNegative = 1 / 900
    clip_mm: NumberOrPair = 3.0
    label_noise_mm: NotNegative = 0.12
    start_direction: Vector = (0.94, 0.0, 0.34)
    end_direction: Vector = (0.85, 0.22, -0.48)
    frames: bool = False
    rest_curvature_range_mm: NotNegative = 0.0
    end_mark_noise: bool = False
    clip_tilt_deg: _Tilt = 0.0
    clip_offset_mm: NotNegative = 0.0
    clip_scatter_deg: _Tilt = 0.0
    yield_curvature_per_mm: NotNegative = 0.0
    source: str = "synthesis"

    def __post_init__(self) -> None:
        for field in fields(self):
            value = getattr(self, field.name)
            value = value.tolist() if isinstance(value, (np.ndarray, np.generic)) else value
            object.__setattr__(self, field.name, checked(self.source, f"synthesis.{field.name}", value, field.type))
        length, edge = self.length_mm, self.fine_edge_mm
        self._require("rest_curvature_range_mm", self.rest_curvature_range_mm <= length, f"at most length_mm = {length:g}")
        self._require("clip_offset_mm", self.clip_offset_mm < length, "an offset shorter than the rod")
        self._require("length_mm", length <= MOST_FINE_EDGES * edge, f"at most {MOST_FINE_EDGES} fine edges")
        fit = all(0 < clip < length / 2 for clip in self.clips_mm)
        self._require("clip_mm", fit, "positive lengths shorter than half the rod")
        for name, spacing in (("marks", length / (self.marks - 1)), *(("clip_mm", clip) for clip in self.clips_mm)):
            count = spacing / edge
            self._require(name, round(count) >= 1 and math.isclose(count, round(count), rel_tol=1e-6),
                          f"a spacing of marks and a clip that are multiples of fine_edge_mm = {edge:g}")
        for name in ("end_distances_mm", "end_rotations_deg"):
            values = getattr(self, name)
            self._require(name, len(values) > 0 and len(set(values)) == len(values), "different numbers, at least one")
        self._require("end_distances_mm", max(self.end_distances_mm) < length, f"distances below length_mm = {length:g}")
        for name in ("start_direction", "end_direction"):
            self._require(name, any(getattr(self, name)), "a vector X, Y, Z that is not zero")
        bend = self.bend * np.eye(2) if isinstance(self.bend, float) else np.array(self.bend)
        bounded = (bend == bend.T).all() and np.abs(bend).max() <= LARGEST
        self._require("bend", bounded and np.linalg.eigvalsh(bend)[0] > 0, "a positive definite B")

    @property
    def clips_mm(self) -> tuple[float, float]:
        """Lengths of rod held at the start and at the end."""
        return self.clip_mm if isinstance(self.clip_mm, tuple) else (self.clip_mm, self.clip_mm)

    def material(self) -> Material:
        """Θ, straight at rest: the table of one material."""
        return Material(np.array(self.bend), self.twist, self.weight)

    def _require(self, name: str, holds: bool, remedy: str) -> None:
        require(holds, self.source, f"synthesis.{name}", f"{getattr(self, name)!r} is out of range", f"give {remedy}")


@dataclass(frozen=True)
class Scene:
    """One experiment: the file of its observations, or how to simulate them, and the search over Θ, as docs/scenes.md has its
    keys. Clamps that are None hold the frame where it is given, else the tangent; ``frame_weight`` is w_m of Eq. 1, mm."""

    name: str
    observations: Path | Synthesis
    grid: Grid
    frame_weight: float = 0.0
    clamp_start: Clamp | None = None
    clamp_end: Clamp | None = None
    objective: str = "static"
    pairs: Path | None = None
    roll_hypotheses: int = 0
    precision: str = "mixed"
    source: str = "scene"
    sha256: str = ""


class _File(Table):
    """A scene's file as it is written."""

    grid: dict
    observations: dict | None = None
    synthesis: dict | None = None
    name: str | None = None
    frame_weight_mm: NotNegative = 0.0
    clamp_start: Literal[CLAMPS] | None = None
    clamp_end: Literal[CLAMPS] | None = None
    objective: Literal[OBJECTIVES] = "static"
    pairs: Annotated[str, Meta(min_length=1)] | None = None
    roll_hypotheses: Rolls = 0
    precision: Literal[PRECISIONS] = "mixed"


class _ObservationsTable(Table):
    file: Annotated[str, Meta(min_length=1)]


def load_scene(path: str | os.PathLike[str]) -> Scene:
    """The scene of a TOML file. Raises InputError for unreadable files, unknown keys, wrong types and values."""
    path = Path(path)
    table, content = read_toml(path)
    file = checked(path, "", table, _File)
    if (file.observations is None) == (file.synthesis is None):
        raise InputError(path, "observations", "neither or both of [observations] and [synthesis]", "give one of them")
    name = path.stem if file.name is None else file.name
    if not name or not name.isprintable() or name in (".", "..") or set(name) & set("/\\") or len(name) > 200:
        raise InputError(path, "name", f"{name[:40]!r} cannot name a folder", "give a name without / or \\: folders get it")
    if file.pairs and file.objective != "dynamic":
        raise InputError(path, "pairs", "given, but the objective is static", 'give objective = "dynamic" too')
    if file.synthesis is not None:
        known = [field.name for field in fields(Synthesis) if field.name not in ("name", "source")]
        for key in file.synthesis:
            if key not in known:
                raise unknown_key(path, f"synthesis.{key}", known)
        for key in ("bend", "twist"):
            require(key in file.synthesis, path, f"synthesis.{key}", "missing", f"give the rod's {key} in mm³")
        observations = Synthesis(**file.synthesis, name=name, source=str(path))
    else:
        observations = path.parent / checked(path, "observations", file.observations, _ObservationsTable).file
    for axis in file.grid:
        if axis not in UNITS:
            raise unknown_key(path, f"grid.{axis}", UNITS)
    axes, bend_12 = parse_axes({axis: str(checked(path, f"grid.{axis}", value, float | str))
                                for axis, value in file.grid.items()}, str(path))
    start, end = (None if clamp is None else Clamp[clamp.upper()] for clamp in (file.clamp_start, file.clamp_end))
    return Scene(
        name=name, observations=observations, grid=Grid(tuple(axes), bend_12, str(path)), frame_weight=file.frame_weight_mm,
        clamp_start=start, clamp_end=end, objective=file.objective,
        pairs=path.parent / file.pairs if file.pairs else None, roll_hypotheses=file.roll_hypotheses,
        precision=file.precision, source=str(path), sha256=hashlib.sha256(content).hexdigest())
