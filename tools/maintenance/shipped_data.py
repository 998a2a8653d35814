"""Writes ``tests/data``, the data set that ships with the tests: the virtual laboratory's observations and images of its rods.

    python tools/maintenance/shipped_data.py [FOLDER]

Everything comes from ``scenes/*.toml`` and fixed seeds. The files have the names and the form of the development data, so that
a test can be given either folder.
"""

import argparse
import json
from dataclasses import replace
from pathlib import Path

import numpy as np

from doo_ti import load_rig, save_observations
from doo_ti.io.scene import Synthesis, load_scene
from doo_ti.lab.synthesis import synthesise
from doo_ti.perception.virtual_lab import lab_rods, save_truth
from doo_ti.system.files import write_whole
from doo_ti.vision.render import Photographs, RenderOptions, save_photographs

ROOT = Path(__file__).resolve().parents[2]
RODS = ("nylon", "vicryl", "silk", "ribbon")
SEEN = {"vicryl": ((66.0, 60.0), (78.0, 150.0)), "silk": ((42.0, 30.0), (78.0, 210.0))}
"""Rods in images: (end distance in mm, end rotation in degrees), none of which crosses or hides itself in a view."""
DIAMETER_MM, SEED = 0.5, 2011
LOOK = RenderOptions(unevenness=4.0, noise=1.0, shading=0.0, jpeg_quality=85)  # little noise, so that the files are small


def recipe(name: str) -> Synthesis:
    """The rod of a scene, by the name of its file."""
    return replace(load_scene(ROOT / "scenes" / f"{name}.toml").observations, name=name)


def write_laboratory(folder: Path) -> None:
    """Observations, the same without label noise, and the materials."""
    materials = {}
    for name in RODS:
        made = recipe(name)
        save_observations(folder / f"{name}.npz", synthesise(made))
        exact = synthesise(replace(made, label_noise_mm=0.0))
        write_whole(folder / f"{name}_truth.npz", lambda file: np.savez_compressed(
            file, vertices_mm=exact.vertices, total_twist_deg=np.degrees(exact.total_twist)))
        materials[name] = {"bend": (np.asarray(made.bend) * np.eye(2)).tolist(), "twist": made.twist, "weight": made.weight}
    (folder / "truth.json").write_text(json.dumps(materials, indent=1) + "\n", encoding="utf-8")


def write_images(folder: Path) -> None:
    """Images of the rods in SEEN, their sets, the rig and the true shapes."""
    parts = []
    for name, places in SEEN.items():
        rods = lab_rods(recipe(name))
        parts.append(rods.take([rods.names.index(f"{name}_{distance:g}mm_{rotation:03g}deg") for distance, rotation in places]))
    curve, vertices = (np.concatenate([getattr(part, name) for part in parts]) for name in ("curve", "vertices"))
    rods = replace(parts[0], names=sum((part.names for part in parts), ()), curve=curve, vertices=vertices)
    save_truth(folder / "truth.npz", rods, DIAMETER_MM)
    save_photographs(folder, Photographs(rods.names, rods.curve, rods.point, rods.direction, DIAMETER_MM,
                                         load_rig(ROOT / "scenes" / "rig.yaml"), LOOK, SEED))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folder", nargs="?", type=Path, default=ROOT / "tests" / "data")
    folder = parser.parse_args().folder
    write_laboratory(folder / "lab_a")
    write_images(folder / "images_a")


if __name__ == "__main__":
    main()
