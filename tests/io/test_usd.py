"""Curves of USD scenes under transforms; the expected points are those of Pixar's own library (usd-core 26.11)."""

import numpy as np
import pytest

from doo_ti.io.observation_files import load_observations
from doo_ti.system.errors import InputError

SCENE = """#usda 1.0
(
    metersPerUnit = 0.01
    upAxis = "Z"
)
def Xform "World" (
    customData = {
        string note = 'a } brace { "quoted"'  # and { in a comment
    }
)
{
    float3 xformOp:rotateXYZ = (30, -40, 75)
    double3 xformOp:translate = (1, -2, 0.5)
    uniform token[] xformOpOrder = ["xformOp:translate", "xformOp:rotateXYZ"]
    def Xform "left"
    {
        float xformOp:rotateX = 20
        float3 xformOp:scale = (1, 2, 0.5)
        uniform token[] xformOpOrder = ["xformOp:scale", "xformOp:rotateX"]
        def BasisCurves "rope"
        {
            int[] curveVertexCounts = [3]
            point3f[] points.timeSamples = { 0: [(0, 0, 0), (1, 0, 0), (1, 1, 0)], 1: [(0, 0, 1), (1, 0, 2), (1, 1, 3)] }
            quatf xformOp:orient = (0.6, 0, -0.8, 0)
            double3 xformOp:translate:pivot = (1, 2, 3)
            uniform token[] xformOpOrder = ["xformOp:translate:pivot", "xformOp:orient", "!invert!xformOp:translate:pivot"]
        }
    }
    def Xform "right"
    {
        def BasisCurves "rope"
        {
            int[] curveVertexCounts = [3]
            point3f[] points = [(0, 0, 0), (1, 0, 0), (1, 1, 0)]
            matrix4d xformOp:transform = ( (0, 1, 0, 0), (-1, 0, 0, 0), (0, 0, 1, 0), (10, 20, 30, 1) )
            uniform token[] xformOpOrder = ["!resetXformStack!", "xformOp:transform"]
        }
    }
}
"""
LEFT = [[(4.095197, 0.345463, 3.317132), (4.796484, -0.105952, 3.184864), (3.125968, -0.382224, 4.018161)],
        [(3.684127, -0.293647, 2.68614), (3.974344, -1.384172, 1.92288), (1.892758, -2.299554, 2.125184)]]
RIGHT = [[(10, 20, 30), (10, 21, 30), (9, 21, 30)]]


@pytest.mark.parametrize("names, expected", [
    (["/World/left/rope"], LEFT), (["/World/right/rope"], RIGHT), (None, LEFT + RIGHT)])
def test_transforms_of_a_prim_and_of_those_around_it(tmp_path, names, expected):
    (tmp_path / "x.usda").write_text(SCENE)
    found = load_observations(tmp_path / "x.usda", columns=names)
    np.testing.assert_allclose(found.vertices, 10 * np.array(expected), atol=1e-5)  # cm


def test_each_rotation_turns_about_its_axes_in_their_order(tmp_path):
    """The image of (1, 0, 0) and of (0, 0, 1), by the turns about single axes."""
    def turned(axes: str) -> np.ndarray:
        matrix = np.eye(3)
        for axis in axes:
            sine, cosine = np.sin(np.radians({"X": 10, "Y": 20, "Z": 30}[axis])), np.cos(np.radians(
                {"X": 10, "Y": 20, "Z": 30}[axis]))
            matrix = {"X": np.array([[1, 0, 0], [0, cosine, -sine], [0, sine, cosine]]),
                      "Y": np.array([[cosine, 0, sine], [0, 1, 0], [-sine, 0, cosine]]),
                      "Z": np.array([[cosine, -sine, 0], [sine, cosine, 0], [0, 0, 1]])}[axis] @ matrix
        return matrix
    for axes in ("XYZ", "XZY", "YXZ", "YZX", "ZXY", "ZYX"):
        (tmp_path / "x.usda").write_text(f"""#usda 1.0
(metersPerUnit = 0.001)
def BasisCurves "rope" {{
    int[] curveVertexCounts = [3]
    point3f[] points = [(1, 0, 0), (0, 0, 0), (0, 0, 1)]
    float3 xformOp:rotate{axes} = (10, 20, 30)
    uniform token[] xformOpOrder = ["xformOp:rotate{axes}"]
}}""")
        found = load_observations(tmp_path / "x.usda").vertices[0]
        np.testing.assert_allclose(found, (turned(axes) @ np.array([[1, 0, 0], [0, 0, 0], [0, 0, 1.0]]).T).T, atol=1e-12)


@pytest.mark.parametrize("old, new, word", [
    ("float xformOp:rotateX = 20", "float xformOp:rotateX.timeSamples = { 0: 20, 1: 30 }", "changes over time"),
    ("float xformOp:rotateX = 20", "", "no value"), ("(1, 2, 0.5)", "(1, 2)", "xformOp:scale"),
    ("xformOp:translate:pivot = (1, 2, 3)", "xformOp:translate:pivot = (1, 2, nan)", "xformOp:translate:pivot"),
    ('"!invert!xformOp:translate:pivot"', '"!invert!xformOp:scale:none"', "no value"),
    ('["xformOp:scale", ', '["xformOp:shear", "xformOp:scale", ', "xformOp:shear"),
    ("(1, 2, 0.5)", "(1e300, 2, 1e300)", "not finite"),
])
def test_wrong_transforms_are_named(tmp_path, old, new, word):
    (tmp_path / "x.usda").write_text(SCENE.replace(old, new))
    with pytest.raises(InputError, match=word):
        load_observations(tmp_path / "x.usda", columns=["/World/left/rope"])


@pytest.mark.parametrize("axis, up", [("X", [1, 0, 0]), ("Y", [0, 1, 0]), ("Z", [0, 0, 1])])
def test_the_axis_that_points_up(tmp_path, axis, up):
    (tmp_path / "x.usda").write_text(SCENE.replace('upAxis = "Z"', f'upAxis = "{axis}"  # not upAxis = "Z"'))
    assert load_observations(tmp_path / "x.usda", columns=["/World/left/rope"]).up.tolist() == up


@pytest.mark.parametrize("old, new, word", [
    ('upAxis = "Z"', 'upAxis = "W"', "upAxis"),
    ('def Xform "right"', 'def Xform "left"', "/World/left/rope: the prim is there twice"),
    ("int[] curveVertexCounts = [3]", 'string note = "open\nint[] curveVertexCounts = [3]', "line 22: \" is not closed"),
])
def test_wrong_scenes_are_named(tmp_path, old, new, word):
    assert old in SCENE
    (tmp_path / "x.usda").write_text(SCENE.replace(old, new))
    with pytest.raises(InputError, match=word):
        load_observations(tmp_path / "x.usda")
