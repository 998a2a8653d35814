"""The virtual lab's rods for images (§V-A), and their true shapes.

Axes: S observations, V marks, n vertices of the fine mesh.
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from doo_ti.io.scene import Synthesis
from doo_ti.lab.synthesis import fine_vertices
from doo_ti.system.errors import InputError
from doo_ti.system.files import write_whole


@dataclass(frozen=True)
class LabRods:
    """The rods of a scene, free of any noise.

    names        S of them: rod, end distance and end rotation
    curve        (S, n, 3) mm: the fine mesh, with its rest curvature and its clips
    vertices     (S, V, 3) mm: its marks
    rest_length  (V − 1,) mm between them
    """

    names: tuple[str, ...]
    curve: np.ndarray
    vertices: np.ndarray
    rest_length: np.ndarray

    @property
    def point(self) -> np.ndarray:
        """(S, 3) mm: v⁰."""
        return self.vertices[:, 0]

    @property
    def direction(self) -> np.ndarray:
        """(S, 3) unit vectors along e⁰, which the clip holds if it is at least as long."""
        first = self.vertices[:, 1] - self.vertices[:, 0]
        return first / np.linalg.norm(first, axis=-1, keepdims=True)

    def take(self, rows) -> "LabRods":
        """The rods of these rows."""
        rows = np.asarray(rows)
        return LabRods(tuple(np.array(self.names)[rows].tolist()), self.curve[rows], self.vertices[rows], self.rest_length)


def lab_rods(synthesis: Synthesis) -> LabRods:
    """The rods behind :func:`doo_ti.lab.synthesis.synthesise`, in its order.

    Raises InputError for rods that are not round, and InterruptedRunError where a rod cannot be carried to a stable
    equilibrium.
    """
    if not synthesis.material().is_isotropic or synthesis.frames:
        raise InputError(synthesis.source, "synthesis.bend", f"{synthesis.name} is not round",
                         "images are of threads: give one number, and no frames")
    curve = fine_vertices(synthesis)
    spacing = synthesis.length_mm / (synthesis.marks - 1)
    names = tuple(f"{synthesis.name}_{distance:g}mm_{rotation:03g}deg" for rotation in synthesis.end_rotations_deg
                  for distance in synthesis.end_distances_mm)
    return LabRods(names, curve, curve[:, :: round(spacing / synthesis.fine_edge_mm)], np.full(synthesis.marks - 1, spacing))


def save_truth(path: Path, rods: LabRods, diameter_mm: float) -> None:
    """Write the true shapes as npz: ``names``, ``vertices_mm``, ``curve_mm``, ``rest_length_mm``, ``thread_diameter_mm``."""
    write_whole(path, lambda file: np.savez_compressed(
        file, names=np.array(rods.names), vertices_mm=rods.vertices, curve_mm=rods.curve, rest_length_mm=rods.rest_length,
        thread_diameter_mm=diameter_mm))
