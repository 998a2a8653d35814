"""One small good file, or folder, of every format that the commands read, made by the package itself with fixed seeds.

scene.toml dynamic.toml file.toml loop.toml tied.toml   scenes: virtual lab, Eq. 3, of a file, of motion, of a group
rods.npz .csv .parquet, ribbons.npz, labs.npz           observations: with frames, on ribbons, of marks alone
pairs.csv offsets.npz .csv, path.npz .csv marks_path.npz   what goes with them, and motions
swing.toml recorded.npz theta.json table.toml           a scene of motion, its recording, what identify makes of it; an obstacle
run dynamic_run ribbon_run perceived.npz                folders of finished sweeps, and what perceive wrote
rig.yaml images/ frames.csv lengths.txt .npz            cameras, sets of images with SETS.csv and truth, a video, a rod
marks.csv labels.csv views.csv boards/                  labelled marks, and images of a calibration board
"""

import os
from pathlib import Path

import cv2
import numpy as np

from doo_ti.commands.cli import main
from doo_ti.vision.board import parse_board
from doo_ti.vision.rig_files import save_rig
from tests.commands.test_simulate import SCENE
from tests.vision.boards import look
from tests.vision.scenes import three_cameras

SEED = 2011
BOARD = "chessboard:4x3:8"
MATERIAL = ("--bend", "4e5", "--twist", "4e5", "--weight", "1")
RODS = """[synthesis]
bend = 4e5
twist = 4e5
length_mm = 24.0
marks = 9
end_distances_mm = [14.0, 19.0]
end_rotations_deg = [0.0, 120.0]
"""
GRID = '[grid]\nbend = "2e5:8e5:3"\ntwist_ratio = "0.5:2:2"\n'
LOOP = """name = "loop"
between = 2
[rod]
length_mm = 24.0
edges = 8
[materials.silk]
bend = 1.5e5
twist = 5e4
[materials.ribbon]
bend = [[4e5, 0], [0, 1e5]]
twist = 2e5
weight = 0.5
[[moments]]
time_s = 0.0
end_position_mm = [22.0, 0, 0]
[[moments]]
time_s = 1.0
end_rotation_deg = 20.0
[[moments]]
time_s = 2.0
end_position_mm = [20.0, 1.0, 0]
end_direction = [1, 0.2, 0]
"""
TIED = """radius_mm = 1.0
rate_hz = 10
duration_s = 0.1
[materials.rope]
bend = 1e5
[rods.trunk]
edges = 6
length_mm = 60.0
radius_mm = 1.5
start = "frame"
[[rods.trunk.moments]]
time_s = 0.1
start_position_mm = [0, 0, 5]
[rods.branch]
edges = 4
points_mm = [[40, 0, 0], [40, 20, 5], [40, 40, 0]]
[[ties]]
first = ["trunk", 4]
second = ["branch", 0]
weld = true
[[obstacles]]
kind = "plane"
point = [0, 0, -30]
normal = [0, 0, 1]
"""
TABLE = 'obstacles = [{ kind = "plane", point = [0, 0, -60], normal = [0, 0, 1], friction = 0.2 }]\n'

def make(folder: Path, quick: bool = False) -> None:
    """Fill ``folder``; ``quick``: with scenes, observations and motions. RuntimeError: the package refuses its own files."""
    before = Path.cwd()
    folder.mkdir(parents=True, exist_ok=True)
    os.chdir(folder)
    try:
        _scenes()
        _observations()
        _motions()
        if quick:
            return
        _moving()
        _images()
        _marks()
        _boards()
        _runs()
    finally:
        os.chdir(before)


def _command(*words: str) -> None:
    if main(words) != 0:
        raise RuntimeError(f"the corpus: doo-ti {' '.join(words)} failed")


def _scenes() -> None:
    Path("scene.toml").write_text(f'name = "silk"\nclamp_start = "frame"\nclamp_end = "frame"\n{RODS}{GRID}')
    Path("ribbon.toml").write_text(f"{RODS.replace('4e5', '[[4e5, 0], [0, 1e5]]', 1)}frames = true\n{GRID}")
    Path("dynamic.toml").write_text(f'name = "dynamic"\nobjective = "dynamic"\npairs = "pairs.csv"\n{RODS}{GRID}')
    Path("file.toml").write_text(f'name = "file"\nframe_weight_mm = 1.0\n[observations]\nfile = "rods.npz"\n{GRID}')
    Path("loop.toml").write_text(LOOP)
    Path("pairs.csv").write_text("from,to,weight,rotation_deg\n0,2,1,120\n1,3,0.5,120\n2,0,1,-120\n")


def _observations() -> None:
    for name, scene in (("rods.npz", "scene.toml"), ("ribbons.npz", "ribbon.toml")):
        _command("synth", scene, "--out", name)
    for name in ("rods.csv", "rods.parquet"):
        _command("convert", "rods.npz", name)
    keys = dict(np.load("rods.npz"))
    count, vertices = len(keys["vertices_mm"]), keys["vertices_mm"]
    np.savez("labs.npz", vertices_mm=vertices, valid=np.ones(vertices.shape[:2], bool), sigma_mm=np.array(0.12),
             up=np.array([0.0, 0.0, 1.0]))
    np.savez("offsets.npz", offset_deg=120.0 * (np.arange(count) // 2))
    Path("offsets.csv").write_text("offset_deg\n" + "".join(f"{120 * (row // 2)}\n" for row in range(count)))


def _motions() -> None:
    """Three moments, each from where the observations' first rod is held."""
    rod = dict(np.load("rods.npz"))
    first, last = rod["vertices_mm"][0, 0], rod["vertices_mm"][0, -1]
    shift = np.array([[0, 0, 0], [0.5, 0, 0], [1.0, 0.3, 0]])
    frames = {name: np.tile(rod[name][0], (3, 1, 1)) for name in ("start_frame", "end_frame")}
    np.savez("path.npz", time_s=np.arange(3.0), start_position_mm=first + 0 * shift, end_position_mm=last + shift, **frames)
    np.savez("marks_path.npz", positions_mm=rod["vertices_mm"][0] + np.linspace(0, 1, 9)[:, None] * shift[:, None])
    Path("path.csv").write_text("time_s,end_x_mm,end_y_mm,end_z_mm\n" + "".join(
        f"{time},{x:.6f},{y:.6f},{z:.6f}\n" for time, (x, y, z) in enumerate(last + shift)))


def _middle() -> np.ndarray:
    return np.load("rods.npz")["vertices_mm"].mean(axis=(0, 1))


def _rig():
    return three_cameras(70.0, 0.25, _middle())


def _moving() -> None:
    Path("tied.toml").write_text(TIED)
    _command("group", "tied.toml", "--out", "tied.npz")  # also for its kernel, which takes long to compile
    Path("swing.toml").write_text(SCENE.replace("edges = 6", "edges = 6, at_rest = true"))
    _command("simulate", "swing.toml", "--out", "swung.npz")
    positions = np.load("swung.npz")["positions_mm"]
    noise = np.random.default_rng(SEED).normal(0, 0.02, (2, *positions.shape[1:]))
    np.savez("recorded.npz", positions_mm=positions + noise, rate_hz=50.0, recording=np.array(["a", "b"]))
    _command("identify", "recorded.npz", "--modes", "1", "--bend", "1e6", "--out", "theta.json")
    Path("table.toml").write_text(TABLE)


def _images() -> None:
    save_rig(Path("rig.yaml"), _rig())
    _command("synth", "scene.toml", "--images", "images", "--rig", "rig.yaml", "--diameter", "0.6")
    header, *lines = (Path("images") / "sets.csv").read_text().splitlines()
    names = header.split(",")
    Path("images/sets.csv").write_text("\n".join([header, *lines[:2]]) + "\n")
    first = dict(zip(names, lines[0].split(","), strict=True))
    cells = [f"images/{first[f'cam{index}']}" for index in range(3)]
    seed = [first[name] for name in names if name.startswith(("seed_", "dir_"))]
    Path("frames.csv").write_text("frame,cam0,cam1,cam2,time_s,seed_x,seed_y,seed_z,dir_x,dir_y,dir_z\n" + "".join(
        ",".join([f"f{row}", *cells, f"{row / 30:.4f}", *(seed if row == 0 else [""] * 6)]) + "\n" for row in range(2)))
    Path("lengths.txt").write_text("3.0\n" * 8)
    np.savez("lengths.npz", rest_length_mm=np.full(8, 3.0))
    _command(*"perceive --rig rig.yaml --sets images/sets.csv --rest-length 3:8 --hypotheses 6 --out perceived.npz".split(),
             *MATERIAL, "--no-picture", "--no-recording")


def _marks() -> None:
    rig, vertices = _rig(), np.load("rods.npz")["vertices_mm"]
    pixels = rig.project(vertices) + np.random.default_rng(SEED).normal(0, 0.1, (3, *vertices.shape[:2], 2))
    rows = [f"pose{pose},cam{camera},{mark},{pixels[camera, pose, mark, 0]:.3f},{pixels[camera, pose, mark, 1]:.3f}\n"
            for pose in range(2) for camera in range(3) for mark in range(vertices.shape[1])]
    Path("marks.csv").write_text("observation,camera,mark,u_px,v_px\n" + "".join(rows))
    Path("labels.csv").write_text("observation,end_distance_mm,end_rotation_deg,total_twist_deg\npose0,14,0,0\npose1,19,0,0\n")


def _boards() -> None:
    board, chance, lines = parse_board(BOARD), np.random.default_rng(SEED), ["view,cam0,cam1"]
    Path("boards").mkdir(exist_ok=True)
    for view in range(4):
        turn = cv2.Rodrigues(np.array([0, 0, 0.8]) + chance.uniform(-0.35, 0.35, 3) * (view > 0))[0]
        for camera in _rig().cameras[:2]:
            image = look(board, camera, turn, _middle() - turn @ board.points.mean(axis=0), np.random.default_rng(view), 0.5)
            cv2.imwrite(f"boards/{view}_{camera.name}.png", image)
        lines.append(f"view{view},boards/{view}_cam0.png,boards/{view}_cam1.png")
    Path("views.csv").write_text("\n".join(lines) + "\n")


def _runs() -> None:
    _command("sweep", "scene.toml", "--out", "run")
    _command("sweep", "dynamic.toml", "--out", "dynamic_run")
    _command("sweep", "ribbon.toml", "--bend-1", "3e5:6e5:2", "--bend-2", "1e5", "--twist", "2e5", "--out", "ribbon_run")
