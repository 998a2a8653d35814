"""Files of other programs' libraries: curves of MuJoCo models and of USD scenes, and OpenCV's YAML.

**MuJoCo**: cables, ``<composite type="cable">`` and ``<flexcomp dim="1" type="grid">``, in their shape in the model. A
composite states its points as ``vertex``, or as a ``curve``: with i = 0 … N − 1 along the cable and sizes (a, b, c), the word
``s`` means a i/(N − 1), ``cos(s)`` b cos(π c i/(N − 1)), ``sin(s)`` the same with sin, and ``0`` zero. Poses of the element
and of the bodies around it are applied. Lengths are in metres, z points up.

**USD**: the points of every ``BasisCurves`` and ``NurbsCurves``, in order, where transforms put them; points with time samples
give a curve for each. Control points of cubic curves are taken as points of the rod, which they are only for interpolating
bases. Files are read by Pixar's library, the extra ``usd``.

**OpenCV's FileStorage YAML**, the format of rigs (§V-A): OpenCV's own reader crashes on damaged files, so that they are read
without it. A matrix is a map ``rows, cols, dt, data`` with the tag ``!!opencv-matrix``.
"""

import xml.etree.ElementTree as ElementTree
from contextlib import suppress
from pathlib import Path

import numpy as np

from doo_ti.io.arrays import first_line
from doo_ti.io.curves import Curves, chosen_names, stacked
from doo_ti.rod.frames import matrix_from_quaternion
from doo_ti.system.errors import InputError, require

OTHER_ROTATIONS = ("euler", "axisangle", "xyaxes", "zaxis")
REMEDY = "give a model with a cable, as MuJoCo's documentation describes it"
MOST_POINTS = 200_000  # of all cables that are stated by their count: a few characters of the file


def read_mujoco(path: Path, content: bytes, names: list[str] | None = None) -> Curves:
    """The cables of a model, all or those whose ``prefix`` or ``name`` is in ``names``. Raises InputError for files that are no
    model, for models without a cable and for poses in other forms than ``pos`` and ``quat``."""
    try:
        root = ElementTree.fromstring(content, ElementTree.XMLParser(target=_Tree()))
    except (ElementTree.ParseError, ValueError, LookupError) as error:  # LookupError: an unknown encoding
        raise InputError(path, "file", f"is not XML ({error})", REMEDY) from None
    found: dict[str, np.ndarray] = {}
    for world in root.iter("worldbody"):
        _gather(path, world, found)
    require(found, path, "worldbody", "has no cable", REMEDY)
    chosen = [found[name] for name in chosen_names(path, "prefix", list(found), names)]
    return Curves(stacked(path, chosen), 1000.0)


class _Tree(ElementTree.TreeBuilder):
    """Without declarations of entities, which can expand without end."""

    def doctype(self, name, public, system):
        raise ValueError("it declares a document type")


def _gather(path: Path, world, found: dict) -> None:
    """Add the cables (V, 3) of a model by name."""
    elements = [(child, np.zeros(3), np.eye(3)) for child in reversed(world)]  # with the poses of the bodies around them
    while elements:
        child, position, rotation = elements.pop()
        if child.tag not in ("body", "frame", "composite", "flexcomp"):
            continue
        if child.tag == "composite" and child.get("type") != "cable" or child.tag == "flexcomp" and (
                child.get("dim", "2"), child.get("type", "grid")) != ("1", "grid"):
            continue
        here, turned = _pose(path, child, position, rotation)
        if child.tag in ("body", "frame"):
            elements += [(inner, here, turned) for inner in reversed(child)]
            continue
        name = child.get("prefix") or child.get("name") or f"cable {len(found)}"
        require(name not in found, path, name, "the cable is there twice", "give each a prefix or a name of its own")
        points = _of_composite(path, child, found) if child.tag == "composite" else _of_flex(path, child, found)
        found[name] = here + points @ turned.T


def _pose(path: Path, child, position: np.ndarray, rotation: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Position (3,) and rotation (3, 3) in the world of an element in a body with that pose."""
    own = next((name for name in OTHER_ROTATIONS if child.get(name)), None)
    require(own is None, path, own, f"of a {child.tag}", "give its rotation as quat")
    here = position + rotation @ _vector(path, child, "offset" if child.tag == "composite" else "pos", "0 0 0", 3)
    quaternion = _vector(path, child, "quat", "1 0 0 0", 4)
    require(np.linalg.norm(quaternion) > 0, path, "quat", "of no length", "give a rotation")
    return here, rotation @ matrix_from_quaternion(quaternion / np.linalg.norm(quaternion))


def _count(path: Path, element, default: str, found: dict) -> int:
    """The number of points of a cable beside those ``found``."""
    count = _vector(path, element, "count", default, None)[0]
    before = sum(map(len, found.values()))
    if not 3 <= count <= MOST_POINTS - before:
        beside = f" beside {before:,} of other cables" if before else ""
        raise InputError(path, "count", f"{count:.0f} points{beside}", f"give three or more, at most {MOST_POINTS:,} in all")
    return int(count)


def _of_composite(path: Path, element, found: dict) -> np.ndarray:
    """(V, 3) m in the coordinates of the element."""
    if element.get("vertex"):
        points = _vector(path, element, "vertex", "", None)
        require(len(points) % 3 == 0, path, "vertex", f"{len(points)} numbers", "give three for each point")
        return points.reshape(-1, 3)
    count = _count(path, element, "0", found)
    size = np.resize(_vector(path, element, "size", "1 0 0", None), 3)
    share, points = np.arange(count) / (count - 1), np.zeros((count, 3))
    shapes = {"s": size[0] * share, "cos(s)": size[1] * np.cos(np.pi * size[2] * share),
              "sin(s)": size[1] * np.sin(np.pi * size[2] * share), "0": 0.0 * share}
    for axis, word in enumerate(element.get("curve", "s 0 0").split()[:3]):
        require(word in shapes, path, "curve", f"{word!r}", f"give three of {', '.join(shapes)}")
        points[:, axis] = shapes[word]
    return points


def _of_flex(path: Path, element, found: dict) -> np.ndarray:
    """(V, 3) m: a line along x, its middle at the origin."""
    count = _count(path, element, "10 1 1", found)
    spacing = _vector(path, element, "spacing", "0.02 0.02 0.02", None)[0]
    return np.outer((np.arange(count) - (count - 1) / 2) * spacing, [1.0, 0.0, 0.0])


def _vector(path: Path, element, name: str, default: str, size: int | None) -> np.ndarray:
    """The finite numbers of an attribute."""
    text = element.get(name, default)
    try:
        value = np.array([float(word) for word in text.split()])
    except ValueError:
        value = np.array([np.nan])
    if not len(value) or not np.isfinite(value).all() or size is not None and len(value) != size:
        raise InputError(path, name, f"{text[:40]!r}", f"give {size or 'finite'} numbers")
    return value


# --- USD -----------------------------------------------------------------------------------------------------------------

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
    require(prims, path, "BasisCurves", "the file has none", "export the rod as a curve")
    called = [prim.GetName() for prim in prims]
    found = {name if called.count(name) == 1 else str(prim.GetPath()): UsdGeom.Curves(prim)
             for name, prim in zip(called, prims, strict=True)}
    curves = [curve for name in chosen_names(path, "BasisCurves", list(found), names)
              for curve in _placed(path, name, found[name])]
    unit = 1000.0 * UsdGeom.GetStageMetersPerUnit(stage)
    return Curves(stacked(path, curves), unit, UP[str(UsdGeom.GetStageUpAxis(stage))])


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


# --- OpenCV --------------------------------------------------------------------------------------------------------------

KINDS = ("u", "c", "w", "s", "i", "f", "d")  # of numbers in a matrix of one channel


class DamagedError(ValueError):
    """Text that FileStorage does not write."""


def read_opencv_yaml(text: str):
    """The values of one document: dictionaries, lists, text, numbers, and matrices as arrays (rows, cols) in f64. Raises
    DamagedError for text that is not such YAML, and for damaged matrices. No other kind of object is created."""
    import yaml

    class Loader(yaml.SafeLoader):
        def compose_node(self, parent, index):
            if self.check_event(yaml.AliasEvent):  # FileStorage writes none, and they can expand without end
                raise DamagedError("an alias")
            return super().compose_node(parent, index)

        def matrix(self, node):
            return matrix_of(self.construct_mapping(node, deep=True))

    Loader.add_constructor("tag:yaml.org,2002:opencv-matrix", Loader.matrix)
    # FileStorage begins with a line that only OpenCV takes for a version of YAML, %YAML:1.0.
    lines = text.splitlines(keepends=True)
    body = "".join(lines[1:]) if lines and lines[0].startswith("%YAML") else text
    try:
        return yaml.load(body, Loader)
    except (yaml.YAMLError, RecursionError, OverflowError, TypeError, ValueError, AttributeError) as error:
        # The last three: a key that is a list, a date that is none.
        raise DamagedError(first_line(error)) from None


def matrix_of(entries: dict) -> np.ndarray:
    """The matrix of rows, cols, dt and data. Raises DamagedError."""
    rows, columns, kind, data = (entries.get(key) for key in ("rows", "cols", "dt", "data"))
    for name, value in (("rows", rows), ("cols", columns)):
        if type(value) is not int or value < 1:
            raise DamagedError(f"{name} of a matrix is {value!r}")
    if kind not in KINDS:
        raise DamagedError(f"dt of a matrix is {kind!r}")
    if not isinstance(data, list) or len(data) != rows * columns:
        raise DamagedError(f"data of a matrix are not {rows} x {columns} numbers")
    return np.array([_number(value) for value in data]).reshape(rows, columns)


def _number(value) -> float:
    if isinstance(value, int | float | str) and not isinstance(value, bool):  # YAML takes 1e3, without a point, for text
        with suppress(ValueError, OverflowError):
            return float(value)
    raise DamagedError(f"{value!r} in a matrix is no number")
