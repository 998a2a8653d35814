"""Curves of USD scenes under transforms, as usd-core 26.11 places them."""

import numpy as np
import pytest

from doo_ti import InputError, load_observations

Usd = pytest.importorskip("pxr.Usd", reason="the extra `usd` is not installed")

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


@pytest.mark.parametrize("axis, up", [("X", [1, 0, 0]), ("Y", [0, 1, 0]), ("Z", [0, 0, 1])])
def test_the_axis_that_points_up(tmp_path, axis, up):
    (tmp_path / "x.usda").write_text(SCENE.replace('upAxis = "Z"', f'upAxis = "{axis}"  # not upAxis = "Z"'))
    assert load_observations(tmp_path / "x.usda", columns=["/World/left/rope"]).up.tolist() == up


@pytest.mark.parametrize("text, word", [
    ("nothing", "is not USD"), (SCENE.replace("[3]", "[4]", 1), "add up"), (SCENE.replace("BasisCurves", "Xform"), "none"),
    (SCENE.replace('float xformOp:rotateX = 20', 'string note = "open'), "is not USD")])
def test_wrong_scenes_are_named(tmp_path, text, word, capfd):
    (tmp_path / "x.usda").write_text(text)
    with pytest.raises(InputError, match=word):
        load_observations(tmp_path / "x.usda")
    assert not capfd.readouterr().err


def test_binary_scenes_hold_the_same(tmp_path):
    (tmp_path / "x.usda").write_text(SCENE)
    Usd.Stage.Open(str(tmp_path / "x.usda")).Export(str(tmp_path / "x.usdc"))
    np.testing.assert_allclose(load_observations(tmp_path / "x.usdc").vertices, load_observations(tmp_path / "x.usda").vertices)
