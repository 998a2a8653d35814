"""Curves of USD scenes, in the text form ``.usda``: every ``BasisCurves`` or ``NurbsCurves``, its points in order.

The stage states ``metersPerUnit`` (0.01 by default) and ``upAxis`` (Y by default). Points with time samples give a curve for
each sample. Control points of cubic curves are taken as points of the rod, which they are only for interpolating bases.
Transforms of the prims and of those around them are applied (:mod:`doo_ti.io.usd_prims`).
"""

import re
from collections import Counter
from pathlib import Path

import numpy as np

from doo_ti.io.curves import Curves, checked_points, chosen_names
from doo_ti.io.usd_prims import Prim, placement, prims
from doo_ti.system.errors import InputError

UP = {"X": (1.0, 0.0, 0.0), "Y": (0.0, 1.0, 0.0), "Z": (0.0, 0.0, 1.0)}
KINDS = ("BasisCurves", "NurbsCurves")
LEAST_METRES, MOST_METRES = 1e-9, 1e6
TRIPLE = re.compile(r"\(\s*([^\s,()]+)\s*,\s*([^\s,()]+)\s*,\s*([^\s,()]+)\s*\)")


def read_usd(path: Path, content: bytes, names: list[str] | None = None) -> Curves:
    """The curves of a .usda file, all or those of the prims ``names``. Raises InputError for files without curves, for
    transforms that change over time and for curves of different sizes."""
    text = content.decode(errors="replace")
    if not text.startswith("#usda"):
        raise InputError(path, "file", "is not USD in text form", "convert it with: usdcat IN.usd -o OUT.usda")
    stage, *others = prims(path, text)
    curved = [prim for prim in others if prim.kind in KINDS]
    times, times_path = Counter(prim.name for prim in curved), Counter(prim.path for prim in curved)
    twice = next((name for name, count in times_path.items() if count > 1), None)
    if twice is not None:
        raise InputError(path, twice, "the prim is there twice", "give each curve a name of its own")
    found = {prim.path if times[prim.name] > 1 else prim.name: prim for prim in curved}
    if not found:
        raise InputError(path, "BasisCurves", "the file has none", "export the rod as a curve")
    chosen = chosen_names(path, "BasisCurves", list(found), names)
    curves = [curve for name in chosen for curve in _placed(path, found[name])]
    sizes = {len(curve) for curve in curves}
    if len(sizes) > 1:
        raise InputError(path, "points", f"curves of {min(sizes)} to {max(sizes)} points", "name curves that have equally many")
    up = stage.values.get("upAxis", "Y").strip("\"'")
    if up not in UP:
        raise InputError(path, "upAxis", f"{up[:20]!r}", f"give one of {', '.join(UP)}")
    return Curves(checked_points(path, np.stack(curves)), 1000.0 * _metres_per_unit(path, stage), UP[up])


def _placed(path: Path, prim: Prim) -> list[np.ndarray]:
    """The curves (V, 3) of one prim in the world."""
    matrix = placement(path, prim)
    return [points @ matrix[:3, :3].T + matrix[:3, 3] for points in _curves(path, prim)]


def _metres_per_unit(path: Path, stage: Prim) -> float:
    """The stage's unit of length; 0.01 where it states none."""
    stated = stage.values.get("metersPerUnit", "0.01")
    try:
        value = float(stated)
    except ValueError:
        value = 0.0
    if not LEAST_METRES <= value <= MOST_METRES:
        raise InputError(path, "metersPerUnit", f"{stated[:20]!r}", f"give {LEAST_METRES:g} to {MOST_METRES:g}")
    return value


def _curves(path: Path, prim: Prim) -> list[np.ndarray]:
    """The curves (V, 3) of one prim: one after the other, and of every time sample."""
    counts = prim.values.get("curveVertexCounts")
    lists = prim.values.get("points.timeSamples") or prim.values.get("points")
    if counts is None or lists is None:
        raise InputError(path, prim.name, "has no points or no curveVertexCounts", "export the rod as a curve")
    samples = [part.partition("]")[0] for part in lists.split("[")[1:]]
    try:
        sizes = [int(word) for word in counts.strip("[]").replace(",", " ").split()]
        points = [np.array([[float(part) for part in triple] for triple in TRIPLE.findall(sample)]) for sample in samples]
    except ValueError as error:
        raise InputError(path, prim.name, str(error), "export the rod as a curve") from None
    if not sizes or min(sizes) < 1 or not points or any(len(each) != sum(sizes) for each in points):
        raise InputError(path, prim.name, "curveVertexCounts do not add up to the points", "export the rod as a curve")
    return [curve for each in points for curve in np.split(each, np.cumsum(sizes)[:-1])]
