"""Distance maps of known curves, drawn by brute force: images that need no detector."""

import numpy as np

from doo_ti import Camera, DistanceMaps, Rig
from tests.oracle.reprojection import Map, polyline_distance
from tests.vision.poses import looking


def three_cameras() -> Rig:
    """Cameras 260 mm from the origin, some 100° apart, all distorted."""
    cameras = []
    for index, angle in enumerate((0.3, 2.1, 4.2)):
        back = np.array([np.cos(angle), np.sin(angle), 0.5 + 0.1 * index])
        pose = looking(-back / np.linalg.norm(back), 260.0)
        matrix = [[900.0 + 10 * index, 0, 330.0], [0, 905.0, 250.0 + 3 * index], [0, 0, 1]]
        distortion = [-0.12, 0.05, 6e-4 * (index - 1), -5e-4, 0.01 * index]
        cameras.append(Camera(f"cam{index}", 640, 480, matrix, distortion, *pose))
    return Rig(tuple(cameras))


def curves(random: np.random.Generator, count: int, edges: int, length: float = 3.0, turn: float = 0.12) -> np.ndarray:
    """(N, V, 3) mm: smooth rods around the origin, of edges that all have that length."""
    swing = turn * random.normal(size=(count, 1, 3)) + 0.4 * turn * random.normal(size=(count, edges, 3))
    tangents = np.cumsum(np.concatenate([random.normal(size=(count, 1, 3)), swing], axis=1), axis=1)[:, :edges]
    tangents /= np.linalg.norm(tangents, axis=-1, keepdims=True)
    vertices = np.concatenate([np.zeros((count, 1, 3)), np.cumsum(length * tangents, axis=1)], axis=1)
    return vertices - vertices.mean(axis=1, keepdims=True)


def drawn_maps(rig: Rig, rods: np.ndarray, margin: int = 25) -> DistanceMaps:
    """Maps of the polygons (A, V, 3) in all cameras."""
    values, windows, offset = [], [], 0
    for rod in rods:
        for line in rig.project(rod):
            left, top = np.floor(line.min(axis=0)).astype(int) - margin
            right, bottom = np.ceil(line.max(axis=0)).astype(int) + margin
            columns, lines = np.meshgrid(np.arange(left, right + 1), np.arange(top, bottom + 1))
            values.append(polyline_distance(np.stack([columns, lines], axis=-1).astype(float), line))
            windows.append((offset, left, top, right - left + 1, bottom - top + 1))
            offset += values[-1].size
    window = np.array(windows, dtype=np.int64).reshape(len(rods), len(rig.cameras), 5)
    return DistanceMaps(np.concatenate([v.ravel() for v in values]).astype(np.float32), window)


def map_of(maps: DistanceMaps, row: int, camera: int) -> Map:
    """One map, for the oracle."""
    offset, left, top, width, height = (int(number) for number in maps.window[row, camera])
    return Map(maps.values[offset : offset + width * height].reshape(height, width), left, top)
