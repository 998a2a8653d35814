"""Obstacles in the folder of a run: their numbers in an npz, and in JSON what they are and a digest of them."""

import hashlib
from dataclasses import fields
from pathlib import Path

import numpy as np

from doo_ti.contact.obstacle_file import KINDS
from doo_ti.contact.surroundings import Surroundings
from doo_ti.io.arrays import read_npz
from doo_ti.system.errors import InputError
from doo_ti.system.files import read_content, write_whole


def described(surroundings: Surroundings) -> dict:
    """As JSON holds it: the kinds of the obstacles, the rods' radius, and the sha256 of all numbers."""
    digest = hashlib.sha256()
    for name, value in _arrays(surroundings).items():
        digest.update(name.encode() + str(value.shape).encode() + np.ascontiguousarray(value).tobytes())
    names = {kind: name for name, kind in KINDS.items()}
    return {"kinds": [names[type(obstacle)] for obstacle in surroundings.obstacles],
            "radius_mm": float(surroundings.radius), "sha256": digest.hexdigest()}


def save_surroundings(path: Path, surroundings: Surroundings) -> None:
    """Write the numbers of the obstacles."""
    write_whole(path, lambda file: np.savez(file, **_arrays(surroundings)))


def load_surroundings(path: Path, description: dict) -> Surroundings:
    """What :func:`described` gave ``description`` for, from what :func:`save_surroundings` wrote. Raises InputError where the
    file holds something else, KeyError or TypeError for what is no description."""
    kinds = [KINDS[name] for name in description["kinds"]]
    keys = tuple(_key(number, field.name) for number, kind in enumerate(kinds) for field in fields(kind))
    found = read_npz(path, read_content(path), keys)
    try:
        obstacles = [kind(**{field.name: found[_key(number, field.name)] for field in fields(kind)})
                     for number, kind in enumerate(kinds)]
        surroundings = Surroundings(obstacles, float(description["radius_mm"]))
        if described(surroundings) == description:
            return surroundings
    except (KeyError, InputError):
        pass
    raise InputError(path, "file", "not what the sweep wrote", "run the sweep again, which writes it")


def _key(number: int, field: str) -> str:
    return f"obstacle_{number}_{field}"


def _arrays(surroundings: Surroundings) -> dict[str, np.ndarray]:
    return {_key(number, field.name): getattr(obstacle, field.name)
            for number, obstacle in enumerate(surroundings.obstacles) for field in fields(obstacle)}
