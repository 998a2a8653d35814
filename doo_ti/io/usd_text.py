"""Curves of USD scenes, in the text form ``.usda``: every ``BasisCurves`` or ``NurbsCurves``, its points in order.

The stage states ``metersPerUnit`` (0.01 by default) and ``upAxis`` (Y by default). Points with time samples give a curve for
each sample. Control points of cubic curves are taken as points of the rod, which they are only for interpolating bases.
Transforms of the prims and of those around them are applied (:mod:`doo_ti.io.usd_prims`).
"""

import re
from pathlib import Path

import numpy as np

from doo_ti.errors import InputError
from doo_ti.io.curves import Curves, checked_points, chosen_names
from doo_ti.io.usd_prims import Prim, placement, prims

UP = {"Y": (0.0, 1.0, 0.0), "Z": (0.0, 0.0, 1.0)}
KINDS = ("BasisCurves", "NurbsCurves")
LEAST_METRES, MOST_METRES = 1e-9, 1e6
TRIPLE = re.compile(r"\(\s*([^\s,()]+)\s*,\s*([^\s,()]+)\s*,\s*([^\s,()]+)\s*\)")


def read_usd(path: Path, content: bytes, names: list[str] | None = None) -> Curves:
    """The curves of a .usda file, all or those of the prims ``names``. Raises InputError for files without curves, for
    transforms that change over time and for curves of different sizes."""
    text = content.decode(errors="replace")
    if not text.startswith("#usda"):
        raise InputError(path, "file", "is not USD in text form", "convert it with: usdcat IN.usd -o OUT.usda")
    curved = [prim for prim in prims(text) if prim.kind in KINDS]
    names_of = [prim.name for prim in curved]
    found = {prim.path if names_of.count(prim.name) > 1 else prim.name: prim for prim in curved}
    if not found:
        raise InputError(path, "BasisCurves", "the file has none", "export the rod as a curve")
    chosen = chosen_names(path, "BasisCurves", list(found), names)
    curves = [curve for name in chosen for curve in _placed(path, found[name])]
    sizes = {len(curve) for curve in curves}
    if len(sizes) > 1:
        raise InputError(path, "points", f"curves of {min(sizes)} to {max(sizes)} points", "name curves that have equally many")
    up = re.search(r'\bupAxis\s*=\s*"([YZ])"', text)
    return Curves(checked_points(path, np.stack(curves)), 1000.0 * _metres_per_unit(path, text), UP[up[1] if up else "Y"])


def _placed(path: Path, prim: Prim) -> list[np.ndarray]:
    """The curves (V, 3) of one prim in the world."""
    matrix = placement(path, prim)
    return [points @ matrix[:3, :3].T + matrix[:3, 3] for points in _curves(path, prim.name, prim.text)]


def _metres_per_unit(path: Path, text: str) -> float:
    """The stage's unit of length; 0.01 where it states none."""
    stated = re.search(r"\bmetersPerUnit\s*=\s*([^\s()]+)", text)
    try:
        value = float(stated[1]) if stated else 0.01
    except ValueError:
        value = 0.0
    if not LEAST_METRES <= value <= MOST_METRES:
        raise InputError(path, "metersPerUnit", f"{stated[1][:20]!r}", f"give {LEAST_METRES:g} to {MOST_METRES:g}")
    return value


def _curves(path: Path, name: str, text: str) -> list[np.ndarray]:
    """The curves (V, 3) of one prim: one after the other, and of every time sample."""
    counts = re.search(r"\bcurveVertexCounts\s*=\s*\[([^\]]*)\]", text)
    lists = re.findall(r"\bpoints(?:\.timeSamples)?\s*=\s*(\{[^}]*\}|\[[^\]]*\])", text)
    if not counts or not lists:
        raise InputError(path, name, "has no points or no curveVertexCounts", "export the rod as a curve")
    samples = re.findall(r"\[([^\]]*)\]", lists[-1])
    try:
        sizes = [int(word) for word in counts[1].replace(",", " ").split()]
        points = [np.array([[float(part) for part in triple] for triple in TRIPLE.findall(sample)]) for sample in samples]
    except ValueError as error:
        raise InputError(path, name, str(error), "export the rod as a curve") from None
    if not sizes or min(sizes) < 1 or not points or any(len(each) != sum(sizes) for each in points):
        raise InputError(path, name, "curveVertexCounts do not add up to the points", "export the rod as a curve")
    return [curve for each in points for curve in np.split(each, np.cumsum(sizes)[:-1])]
