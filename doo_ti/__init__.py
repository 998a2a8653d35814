"""Discrete elastic rods: relaxation, learning of material parameters, perception and prediction (Javdani et al., ICRA 2011).

    from doo_ti import Grid, Material, Newton, load_observations, relax
    from doo_ti import observation_clamps, start_configuration

    observations = load_observations("suture.npz")
    clamps = observation_clamps(observations)
    start = start_configuration(observations, clamps)
    solution = relax(start, Material(bend=6e5, twist=8e5), clamps, up=observations.up)  # F of §III-D, one rod per observation
    solution.configuration.vertices, solution.status, solution.stable   # per rod, nothing averaged

PAPER.md, in the folder of this file, names the code of each equation of the paper.
"""

import os
import re
from pathlib import Path

__version__ = "0.1.0"

# Taichi greets on standard output as soon as it is imported; that belongs to the commands' results.
os.environ.setdefault("ENABLE_TAICHI_HEADER_PRINT", "0")
# Once a day it would also send a permanent identifier to its makers when it starts: nothing here uses the network.
os.environ["TI_SKIP_VERSION_CHECK"] = "ON"
if os.name == "posix" and not {"HOME", "XDG_CACHE_HOME"} & os.environ.keys():
    # Taichi ends the process where neither is set. Below /dev/null nothing can be created: without a home nothing is cached.
    _home = os.path.expanduser("~")
    os.environ["XDG_CACHE_HOME"] = f"{_home}/.cache" if os.path.isabs(_home) else os.devnull

_HOMES = {name: module for module, name in re.findall(
    r"^from (\S+) import (\w+)", Path(__file__).with_suffix(".pyi").read_text(encoding="utf-8"), re.MULTILINE)}
"""The module of each public name: those that ``__init__.pyi``, which type checkers read, imports."""
__all__ = sorted(_HOMES)


def __getattr__(name: str):
    """Import a public name from its module on first use, so that importing the package is fast."""
    if name not in _HOMES:
        raise AttributeError(f"module 'doo_ti' has no attribute {name!r}")
    from importlib import import_module

    return getattr(import_module(_HOMES[name]), name)


def __dir__() -> list[str]:
    return __all__
