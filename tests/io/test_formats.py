"""Files of other programs: each format gives the same marks in mm, the right way up; units, names and errors."""

import numpy as np
import pytest

from doo_ti.io.observation_files import load_observations, read_curves, read_recording, save_observations
from tests.conftest import check_refused

MARKS = np.array([[[0.0, 10, 0], [30, 5, 1], [60, 5, 0], [90, 10, 2]], [[0.0, 10, 0], [25, 0, 1], [55, 0, 0], [80, 10, 2]]])
"""(2, 4, 3) mm."""


def motive(points: np.ndarray, unit: str) -> str:
    """A Motive export of markers M1 … MV, with a rigid body and an unlabelled marker before them."""
    names = ["Gripper", *(f"Rope:M{k + 1}" for k in range(points.shape[1])), "Unlabeled 7"]
    kinds = ["Rigid Body", *["Marker"] * (len(names) - 1)]
    def row(first, second, cells):
        return ",".join([first, second, *(cell for cell in cells for _ in range(3))])
    lines = ["Format Version,1.23,Take Name,rope,Export Frame Rate,120.000000,Rotation Type,Quaternion,"
             f"Length Units,{unit},Coordinate Space,Global", "", row("", "Type", kinds), row("", "Name", names),
             row("", "ID", names), row("", "", ["Position"] * len(names)), "Frame,Time (Seconds)" + ",X,Y,Z" * len(names)]
    for frame, marks in enumerate(points):
        cells = ["1.5"] * 3 + ["" if np.isnan(x) else repr(float(x)) for x in marks.ravel()] + [""] * 3
        lines.append(",".join([str(frame), f"{frame / 120:.6f}", *cells]))
    return "\n".join(lines) + "\n"


def nexus(points: np.ndarray) -> str:
    """A Nexus export, with another section before it and one behind."""
    names = [f"Rope:M{k + 1}" for k in range(points.shape[1])]
    rows = [f"{frame + 1},0," + ",".join(repr(float(x)) for x in marks.ravel()) for frame, marks in enumerate(points)]
    return "\n".join(["Devices", "1000", "Frame,Sub Frame,Fx", ",,N", "1,0,3", "", "Trajectories", "100",
                      ",," + ",,,".join(names) + ",,", "Frame,Sub Frame" + ",X,Y,Z" * len(names),
                      ",," + ",".join(["mm"] * 3 * len(names)), *rows, "", "Joints", "100"]) + "\n"


def table(points: np.ndarray, names: str, number: bool = True) -> str:
    rows = [",".join([*([str(d), str(v)] if number else []), *(repr(float(x)) for x in mark)])
            for d, rod in enumerate(points) for v, mark in enumerate(rod)]
    return "\n".join([names, *rows]) + "\n"


def german(text: str) -> str:
    return text.replace(",", ";").replace(".", ",")


FILES = {
    "motive.csv": (motive(MARKS / 1000, "Meters"), (0, 1, 0)),
    "motive_mm.csv": (motive(MARKS, "Millimeters"), (0, 1, 0)),
    "nexus.csv": (nexus(MARKS), (0, 0, 1)),
    "blocks.txt": ("# a rod\n" + "\n\n".join("\n".join("%r, %r, %r" % tuple(mark) for mark in rod.tolist()) for rod in MARKS),
                   (0, 0, 1)),
    "lines.csv": ("\n".join(" ".join(map(repr, rod.ravel().tolist())) for rod in MARKS), (0, 0, 1)),
    "metres.csv": (table(MARKS / 1000, "observation,vertex,x_m,y_m,z_m"), (0, 0, 1)),
    "bare.csv": (table(MARKS, "observation,vertex,x,y,z"), (0, 0, 1)),
    "spreadsheet.csv": (german(table(MARKS / 1000, "observation,vertex,x_m,y_m,z_m")), (0, 0, 1)),
    "motive_german.csv": (german(motive(MARKS / 1000, "Meters")), (0, 1, 0)),
    "nexus_german.csv": (german(nexus(MARKS)), (0, 0, 1)),
    "lines_german.csv": ("\n\n".join("\n".join(german("%r,%r,%r" % tuple(mark)) for mark in rod) for rod in MARKS.tolist()),
                         (0, 0, 1)),
    "lines_german.txt": ("\n".join(" ".join(map(repr, rod.ravel().tolist())).replace(".", ",") for rod in MARKS), (0, 0, 1))}


@pytest.mark.parametrize("name", FILES)
def test_each_format_gives_the_same_marks(tmp_path, name):
    text, up = FILES[name]
    (tmp_path / name).write_text(text)
    observations = load_observations(tmp_path / name)
    np.testing.assert_allclose(observations.vertices, MARKS, rtol=0, atol=1e-9)
    np.testing.assert_array_equal(observations.up, up)
    assert load_observations(tmp_path / name, up=(1, 0, 0)).up.tolist() == [1, 0, 0]


@pytest.mark.parametrize("name", ["motive.csv", "blocks.txt", "bare.csv"])
def test_a_unit_applies_whatever_the_file_states(tmp_path, name):
    numbers = {"motive.csv": MARKS / 1000}.get(name, MARKS)
    (tmp_path / name).write_text(FILES[name][0])
    for unit, factor in (("mm", 1), ("cm", 10), ("m", 1000)):
        observations = load_observations(tmp_path / name, unit=unit)
        np.testing.assert_allclose(observations.vertices, factor * numbers, rtol=1e-12)
        np.testing.assert_allclose(observations.rest_length.sum(), factor * load_observations(
            tmp_path / name, unit="mm").rest_length.sum(), rtol=1e-12)


def test_an_npz_in_metres(tmp_path):
    np.savez(tmp_path / "x.npz", vertices_mm=MARKS / 1000, rest_length_mm=np.full(3, 0.031), sigma_mm=1e-4)
    observations = load_observations(tmp_path / "x.npz", unit="m")
    np.testing.assert_allclose(observations.vertices, MARKS)
    np.testing.assert_allclose(observations.rest_length, 31.0)
    np.testing.assert_allclose(observations.sigma, 0.1)


def test_columns_of_other_names(tmp_path):
    (tmp_path / "x.csv").write_text(table(MARKS, "shot,mark,PosX,PosY,PosZ"))
    names = {"observation": "shot", "vertex": "mark", "x": "PosX", "y": "PosY", "z": "PosZ"}
    np.testing.assert_array_equal(load_observations(tmp_path / "x.csv", columns=names).vertices, MARKS)
    (tmp_path / "y.csv").write_text(table(MARKS[:1], "x,y,z", number=False))  # rows in order, of one observation
    np.testing.assert_array_equal(load_observations(tmp_path / "y.csv").vertices, MARKS[:1])
    (tmp_path / "z.csv").write_text(table(MARKS, "Observation,VERTEX,X,Y,Z"))
    np.testing.assert_array_equal(load_observations(tmp_path / "z.csv").vertices, MARKS)
    swapped = load_observations(tmp_path / "y.csv", columns={"y": "z", "z": "y"})
    np.testing.assert_array_equal(swapped.vertices, MARKS[:1][..., [0, 2, 1]])


@pytest.mark.parametrize("suffix", [".csv", ".parquet", ".npz"])
def test_names_of_observations(tmp_path, suffix):
    """They are in the order of the file, and kept in others; among numbers a name is refused."""
    _, *rows = table(MARKS, "observation,vertex,x,y,z").splitlines()
    names = [f"shot {len(MARKS) - d}" for d in range(len(MARKS))]
    text = "\n".join(["observation,vertex,x,y,z", *(f"{names[int(row.split(',')[0])]},{row.split(',', 1)[1]}" for row in rows)])
    (tmp_path / "x.csv").write_text(text)
    save_observations(tmp_path / f"y{suffix}", load_observations(tmp_path / "x.csv"))
    found = load_observations(tmp_path / f"y{suffix}")
    np.testing.assert_array_equal(found.vertices, MARKS)
    assert found.labels.tolist() == names
    (tmp_path / "x.csv").write_text(text.replace(names[0], "7"))
    check_refused(f"observation: '{names[1]}' in line", load_observations, tmp_path / "x.csv")
    np.savez(tmp_path / "seen.npz", vertices_mm=MARKS, name=np.array(names))  # as perceive writes them
    assert load_observations(tmp_path / "seen.npz").labels.tolist() == names


def test_marks_numbered_from_one(tmp_path):
    head, *rows = table(MARKS, "observation,vertex,x,y,z").splitlines()
    cells = [row.split(",") for row in rows]
    (tmp_path / "x.csv").write_text("\n".join([head, *(",".join([d, str(int(v) + 1), *rest]) for d, v, *rest in cells)]))
    np.testing.assert_array_equal(load_observations(tmp_path / "x.csv").vertices, MARKS)


@pytest.mark.parametrize("text", [motive(MARKS, "Millimeters"), nexus(MARKS)], ids=["motive", "nexus"])
def test_markers_by_name(tmp_path, text):
    (tmp_path / "x.csv").write_text(text)
    order = [3, 1, 0]
    names = [f"Rope:M{k + 1}" for k in order]
    np.testing.assert_allclose(load_observations(tmp_path / "x.csv", columns=names).vertices, MARKS[:, order])
    assert read_curves(tmp_path / "x.csv").rate in (100.0, 120.0)
    check_refused("M9", load_observations, tmp_path / "x.csv", columns=["M9"])


def test_markers_that_were_not_seen(tmp_path):
    seen = np.concatenate([MARKS, MARKS])
    seen[1, 2], seen[3] = np.nan, np.nan
    (tmp_path / "x.csv").write_text(motive(seen, "Millimeters"))
    observations = load_observations(tmp_path / "x.csv")
    np.testing.assert_array_equal(observations.valid, [[True] * 4, [True, True, False, True], [True] * 4])
    assert np.isnan(read_curves(tmp_path / "x.csv").points[3]).all()  # a recording keeps its frames


def test_frames_keep_the_numbers_of_the_file(tmp_path):
    """Of a recording also those that it leaves out are there, without markers."""
    (tmp_path / "x.csv").write_text(nexus(MARKS))
    assert load_observations(tmp_path / "x.csv").labels.tolist() == [1, 2]
    rods = np.concatenate([MARKS, MARKS[:1] + 1.0])
    head, *rows = table(rods, "frame,vertex,x,y,z").splitlines()
    cells = [row.split(",") for row in rows]
    (tmp_path / "y.csv").write_text("\n".join([head, *(",".join([str((4, 6, 10)[int(d)]), *rest]) for d, *rest in cells)]))
    found = read_recording(tmp_path / "y.csv", columns={"observation": "frame"}, rate=10.0)
    assert found.frames.tolist() == [4, 6, 8, 10] and np.isnan(found.positions[2]).all()
    np.testing.assert_array_equal(found.positions[[0, 1, 3]], rods)
    (tmp_path / "z.csv").write_text((tmp_path / "y.csv").read_text().replace("\n10,", "\n100001,"))
    check_refused("frames 4 to 100001", read_recording, tmp_path / "z.csv", columns={"observation": "frame"}, rate=10.0)


CABLE = """<mujoco><worldbody><body name="b" pos="1 2 3" quat="0.70710678118 0 0 0.70710678118">
<composite prefix="a" type="cable" curve="cos(s) sin(s) s" count="7 1 1" size="0.6 .1 4" offset="0.1 0 1" initial="none">
<plugin plugin="mujoco.elasticity.cable"><config key="twist" value="5e8"/><config key="bend" value="2e9"/></plugin>
<geom type="capsule" size=".005" density="1100"/></composite></body>
<composite prefix="v" type="cable" vertex="0 0 0 .1 0 0 .2 .01 0 .3 0 0 .4 0 0 .5 0 0 .6 0 0"/>
<flexcomp name="f" type="grid" dim="1" count="7 1 1" spacing="0.1 .1 .1" pos="0.5 0 0"/></worldbody></mujoco>"""


def test_mujoco_cables(tmp_path):
    """The points of the first are those that MuJoCo 3.3 gives its capsules."""
    (tmp_path / "x.xml").write_text(CABLE)
    expected = 1000 * np.array([[1.0, 2.2, 4.0], [0.91339746, 2.05, 4.1], [1.08660254, 2.05, 4.2], [1.0, 2.2, 4.3],
                                [0.91339746, 2.05, 4.4], [1.08660254, 2.05, 4.5], [1.0, 2.2, 4.6]])
    observations = load_observations(tmp_path / "x.xml")
    assert observations.vertices.shape == (3, 7, 3)
    np.testing.assert_allclose(observations.vertices[0], expected, atol=1e-4)
    np.testing.assert_allclose(observations.vertices[1, 2], [200, 10, 0])
    np.testing.assert_allclose(observations.vertices[2, :, 0], 500 + 100 * np.arange(-3, 4))


def test_files_that_are_refused(tmp_path):
    cases = {
        "x.xml": ("<mujoco>", "XML"), "y.xml": ("<mujoco><worldbody/></mujoco>", "cable"),
        "z.xml": (CABLE.replace("quat=", "euler="), "euler"), "w.xml": ("<!DOCTYPE x>" + CABLE, "document type"),
        "v.xml": (CABLE.replace("cos(s) sin(s)", "tan(s) s"), "tan"), "x.txt": ("1 2 3\n4 5", "line 2"),
        "y.txt": ("1 2 3\n4 5 6\n7 8 9\n\n1 2 3", "points"), "z.txt": ("1 2 3\n4 5 nan\n7 8 9", "finite"),
        "x.csv": (motive(MARKS[:, :2], "Meters"), "2 markers"),
        "y.csv": (motive(MARKS, "Meters").replace("Frame,T", "T"), "Frame"),
        "u.xml": (CABLE.replace('prefix="v"', 'prefix="a"'), "a: the cable is there twice"),
        "v.csv": (motive(MARKS, "Feet"), "feet"), "u.csv": (nexus(MARKS).replace("mm", "ft"), "'ft'"),
        "t.csv": (nexus(MARKS).replace("M2", "M1"), "Rope:M1"),
        "z.csv": (nexus(MARKS).replace("10.0", "ten", 1), "ten"), "w.csv": ("a,b\n1,2\n", "x_mm"), "s.csv": ("\n\n", "file"),
        "r.csv": ("observation,x_mm,x_mm,y_mm,z_mm\n0,1,1,1,1\n", "x_mm"), "q.csv": ("x_mm,y_mm,z_mm\n", "no rows")}
    for name, (text, word) in cases.items():
        (tmp_path / name).write_text(text)
        check_refused(f"{name}: .*{word}", load_observations, tmp_path / name)


def test_options_that_do_not_fit_the_file(tmp_path):
    (tmp_path / "x.txt").write_text(FILES["blocks.txt"][0])
    (tmp_path / "x.csv").write_text(table(MARKS, "observation,vertex,x,y,z"))
    (tmp_path / "m.csv").write_text(motive(MARKS, "Meters"))
    np.savez(tmp_path / "x.npz", vertices_mm=MARKS)
    for name, columns in (("x.txt", ["a"]), ("x.csv", ["x", "y"]), ("x.csv", {"w": "x"}), ("x.csv", {"x": "w"}),
                          ("m.csv", {"x": "w"}), ("x.npz", ["a"])):
        check_refused(": ", load_observations, tmp_path / name, columns=columns)
    for load in (load_observations, read_recording):
        check_refused("inch", load, tmp_path / "x.csv", unit="inch")
