"""Curves of USD scenes: the points of every ``BasisCurves`` and ``NurbsCurves``, in order, where transforms put them.

Points with time samples give a curve for each sample; transforms may change over time with them. Control points of cubic
curves are taken as points of the rod, which they are only for interpolating bases. Files are read by Pixar's library, the extra
``usd``.
"""

from pathlib import Path

import numpy as np

from doo_ti.io.curves import Curves, checked_points, chosen_names
from doo_ti.system.errors import InputError

UP = {"X": (1.0, 0.0, 0.0), "Y": (0.0, 1.0, 0.0), "Z": (0.0, 0.0, 1.0)}


def read_usd(path: Path, content: bytes, names: list[str] | None = None) -> Curves:
    """The curves of a USD file, all or those of the prims ``names``. Raises InputError for files that cannot be read or have no
    curves, for curves of different sizes, and where usd-core is not installed."""
    try:
        from pxr import Tf, Usd, UsdGeom
    except ImportError:
        raise InputError(path, "file", "usd-core is not installed", "pip install 'doo_ti[usd]'") from None
    try:
        stage = Usd.Stage.Open(str(path))
    except Tf.ErrorException as error:
        reason = str(error).strip().splitlines()[-1].strip()
        raise InputError(path, "file", f"is not USD ({reason})", "export the rod as a curve") from None
    prims = [prim for prim in stage.Traverse() if prim.IsA(UsdGeom.BasisCurves) or prim.IsA(UsdGeom.NurbsCurves)]
    if not prims:
        raise InputError(path, "BasisCurves", "the file has none", "export the rod as a curve")
    called = [prim.GetName() for prim in prims]
    found = {name if called.count(name) == 1 else str(prim.GetPath()): UsdGeom.Curves(prim)
             for name, prim in zip(called, prims, strict=True)}
    curves = [curve for name in chosen_names(path, "BasisCurves", list(found), names)
              for curve in _placed(path, name, found[name])]
    sizes = {len(curve) for curve in curves}
    if len(sizes) > 1:
        raise InputError(path, "points", f"curves of {min(sizes)} to {max(sizes)} points", "name curves that have equally many")
    unit = 1000.0 * UsdGeom.GetStageMetersPerUnit(stage)
    return Curves(checked_points(path, np.stack(curves)), unit, UP[str(UsdGeom.GetStageUpAxis(stage))])


def _placed(path: Path, name: str, curves) -> list[np.ndarray]:
    """The curves (V, 3) of one prim in the world: one after the other, and at every time sample."""
    from pxr import Usd

    found = []
    for time in curves.GetPointsAttr().GetTimeSamples() or [Usd.TimeCode.Default()]:
        points, sizes = (np.array(attribute.Get(time) or ()) for attribute in (
            curves.GetPointsAttr(), curves.GetCurveVertexCountsAttr()))
        if not len(sizes) or sizes.min() < 1 or sizes.sum() != len(points):
            raise InputError(path, name, "curveVertexCounts do not add up to the points", "export the rod as a curve")
        matrix = np.array(curves.ComputeLocalToWorldTransform(time))  # of rows of points
        found += np.split(points.astype(np.float64) @ matrix[:3, :3] + matrix[3, :3], np.cumsum(sizes)[:-1])
    return found
