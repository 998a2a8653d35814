"""Rigs and rods to render or to draw, distance maps of known curves by brute force, and errors of a detection."""

import cv2
import numpy as np

from doo_ti import Camera, Detection, DistanceMaps, Rig
from doo_ti.rod.frames import normal_to, unit_vectors
from doo_ti.vision.tubes import smooth_curve
from tests.oracle.reprojection import Map, polyline_distance


def small_rig(count: int = 2) -> Rig:
    """Distorted cameras 250 mm from the origin, 480 × 360 px."""
    cameras = []
    for index in range(count):
        rotation = cv2.Rodrigues(np.array([0.3 - 0.5 * index, 0.4 * index, 0.1]))[0]
        matrix = [[600.0, 0, 240 + index], [0, 600.0, 180], [0, 0, 1]]
        distortion = [-0.08, 0.03, 5e-4, -4e-4, 0]
        cameras.append(Camera(f"cam{index}", 480, 360, matrix, distortion, rotation, np.array([0.0, 0, 250])))
    return Rig(tuple(cameras))


def bow(vertices: int = 34) -> np.ndarray:
    """(V, 3) mm: a bent and twisted rod some 110 mm long around the origin."""
    s = np.linspace(-1, 1, vertices)[:, None]
    return np.concatenate([45 * s, 18 * np.cos(2.2 * s) - 8, 9 * np.sin(3 * s)], axis=1)


def line_of(points: np.ndarray, direction: np.ndarray | None = None, width_px: float = 3.0, shape=(480, 640)) -> Detection:
    """A dark line detected at ``points`` (N, 2) px, which follow each other where no ``direction`` (N, 2) is given."""
    direction = unit_vectors(np.gradient(points, axis=0)) if direction is None else np.broadcast_to(direction, points.shape)
    return Detection(points, direction, np.full(len(points), 50.0), width_px, "dark", shape, "ridge")


def normals(line: np.ndarray) -> np.ndarray:
    """(n, 2) unit normals of a dense line (n, 2) px."""
    return normal_to(unit_vectors(np.gradient(line, axis=0)))


def against(found: Detection, line: np.ndarray) -> tuple[np.ndarray, float, float]:
    """(n,) px signed errors of the points beside the line, share of the line that is covered, share of false points."""
    distance = np.linalg.norm(found.points[:, None] - line, axis=-1)
    nearest = distance.argmin(axis=1)
    error = ((found.points - line[nearest]) * normals(line)[nearest]).sum(axis=1)
    real = distance.min(axis=1) < max(3, 0.75 * found.width_px)  # the ends are round
    beside = real & (nearest > 0) & (nearest < len(line) - 1)
    return error[beside], float((distance.min(axis=0) < 1).mean()), float(1 - real.mean())


def three_cameras(distance: float = 260.0, size: float = 1.0, middle=(0.0, 0.0, 0.0)) -> Rig:
    """Cameras that far from ``middle``, mm, some 100° apart, all distorted; ``size`` times 640 × 480 px."""
    cameras = []
    for index, angle in enumerate((0.3, 2.1, 4.2)):
        back = np.array([np.cos(angle), np.sin(angle), 0.5 + 0.1 * index])
        pose = looking(-back / np.linalg.norm(back), distance, middle)
        matrix = np.diag([size, size, 1.0]) @ [[900.0 + 10 * index, 0, 330.0], [0, 905.0, 250.0 + 3 * index], [0, 0, 1]]
        distortion = [-0.12, 0.05, 6e-4 * (index - 1), -5e-4, 0.01 * index]
        cameras.append(Camera(f"cam{index}", round(640 * size), round(480 * size), matrix, distortion, *pose))
    return Rig(tuple(cameras))


def curves(random: np.random.Generator, count: int, edges: int, length: float = 3.0, turn: float = 0.12) -> np.ndarray:
    """(N, V, 3) mm: smooth rods around the origin, of edges that all have that length."""
    swing = turn * random.normal(size=(count, 1, 3)) + 0.4 * turn * random.normal(size=(count, edges, 3))
    tangents = np.cumsum(np.concatenate([random.normal(size=(count, 1, 3)), swing], axis=1), axis=1)[:, :edges]
    vertices = np.pad(np.cumsum(length * unit_vectors(tangents), axis=1), ((0, 0), (1, 0), (0, 0)))
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


def drawn_scene(seed: int, count: int, edges: int, pieces: int = 1) -> tuple[Rig, np.ndarray, DistanceMaps]:
    """Three cameras, rods (A, V, 3) mm, and their maps, drawn in so many pieces to an edge."""
    rods = curves(np.random.default_rng(seed), count, edges)
    return three_cameras(), rods, drawn_maps(three_cameras(), smooth_curve(rods, pieces) if pieces > 1 else rods)


def map_of(maps: DistanceMaps, row: int, camera: int) -> Map:
    offset, left, top, width, height = (int(number) for number in maps.window[row, camera])
    return Map(maps.values[offset : offset + width * height].reshape(height, width), left, top)


def looking(forward: np.ndarray, distance: float, middle=(0.0, 0.0, 0.0)) -> tuple[np.ndarray, np.ndarray]:
    """(R, t) of an upright camera that looks along the unit vector ``forward`` at ``middle``, mm, from ``distance`` mm away."""
    right = unit_vectors(np.cross(forward, [0.0, 0.0, 1.0]))
    rotation = np.stack([right, np.cross(forward, right), forward])
    return rotation, -rotation @ (middle - distance * forward)
