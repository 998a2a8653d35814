"""Imports: downward only, each heavy library in one module, and no heavy library with the package itself."""

import ast
import tomllib
from collections.abc import Iterator
from functools import cache
from pathlib import Path

from tests.processes import ROOT, python

PACKAGE = ROOT / "doo_ti"

# From the bottom up: a module imports from layers below its own, never from beside it.
LAYERS = [{"system"}, {"physics"}, {"rod"}, {"io"}, {"contact"}, {"relaxation"}, {"vision", "dynamics"}, {"groups", "motion"},
          {"lab", "report"}, {"manipulation"}, {"perception"}, {"record"}, {"learning"}, {"refinement"}, {"commands"},
          {"__main__"}]
LEVEL = {name: level for level, names in enumerate(LAYERS) for name in names}
APART = {"learning", "perception"}
ONLY = {"rerun": {"record"}, "matplotlib": {"report"}, "jax": set(), "cv2": {"vision"}, "yaml": {"io"},
        "distributed": {"learning"}, "trimesh": {"contact"}}


def modules() -> dict[str, Path]:
    """Dotted name below doo_ti: path, of every module."""
    found = {}
    for path in sorted(PACKAGE.rglob("*.py")):
        parts = path.relative_to(PACKAGE).with_suffix("").parts
        found[".".join(part for part in parts if part != "__init__") or "__init__"] = path
    return found


MODULES = modules()


def layer(name: str) -> str:
    """The room of a module: its folder, or itself."""
    return name.split(".")[0]


def statements(block: ast.AST) -> Iterator[ast.AST]:
    for part in ("body", "handlers", "orelse", "finalbody"):
        for node in getattr(block, part, []):
            yield node
            yield from statements(node)


@cache
def imported(path: Path) -> set[str]:
    """Dotted names that a file imports; ``from x import y`` counts as x.y where that is a module of ours, else as x."""
    names = set()
    for node in statements(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0 or PACKAGE not in path.parents, f"{path}: relative import"
            source = node.module or "."
            for alias in node.names:
                below = f"{source}.{alias.name}".removeprefix("doo_ti.")
                names.add(f"doo_ti.{below}" if source.startswith("doo_ti") and below in MODULES else source)
    return names


def own(path: Path) -> set[str]:
    return {layer(name.removeprefix("doo_ti.")) for name in imported(path) if name.startswith("doo_ti.")}


def test_imports_run_downward():
    for name in MODULES.keys() - {"__init__"}:
        room = layer(name)
        assert room in LEVEL, f"doo_ti/{room} has no layer: give it one in LAYERS"
        upward = {other for other in own(MODULES[name]) if other != room and LEVEL[other] >= LEVEL[room]}
        assert not upward, f"{name} imports {sorted(upward)}, which lie beside or above it"


def test_physics_stands_on_nothing_but_taichi():
    for name, path in MODULES.items():
        if layer(name) == "physics":
            assert own(path) <= {"physics"}, name
            foreign = {other.split(".")[0] for other in imported(path)} - {"doo_ti"}
            allowed = {"taichi", "numpy", "collections", "dataclasses", "fractions", "functools", "math", "typing"}
            assert foreign <= allowed, name


def test_each_heavy_library_has_one_door():
    for library, rooms in ONLY.items():
        users = {layer(name) for name, path in MODULES.items() if any(
            other.split(".")[0] == library for other in imported(path))}
        assert users <= rooms, library


def test_learning_and_perception_are_apart_and_relax_knows_no_observations():
    """``rod.observations`` neither by itself nor through what it imports."""
    for name in (name for name in MODULES if layer(name) in APART):
        assert not own(MODULES[name]) & (APART - {layer(name)}), name
    seen, waiting = set(), {name for name in MODULES if layer(name) == "relaxation"}
    while waiting:
        name = waiting.pop()
        seen.add(name)
        waiting |= {other.removeprefix("doo_ti.") for other in imported(MODULES[name])} & MODULES.keys() - seen
    assert "system.files" in seen and "rod.observations" not in seen  # the kernel cache writes files


def test_one_place_starts_taichi_and_makes_kernels():
    """``runtime.kernel`` refuses a launch that another thread's could meet."""
    starters, makers = [], []
    for name, path in MODULES.items():
        text = path.read_text(encoding="utf-8")
        for node in ast.walk(ast.parse(text)) if "ti.kernel" in text or ".init(" in text else []:
            if isinstance(node, ast.Attribute) and node.attr == "kernel" and getattr(node.value, "id", "") == "ti":
                makers.append(name)
            elif isinstance(node, ast.Call) and getattr(node.func, "attr", "") == "init":
                starters.append(name)
    assert starters == makers == ["system.runtime"]


def test_no_file_postpones_annotations():
    files = [path for folder in ("doo_ti", "tests", "tools") for path in (ROOT / folder).rglob("*.py")]
    assert len(files) > 50
    for path in files:
        assert "\nfrom __future__ " not in path.read_text(encoding="utf-8"), path


def test_importing_costs_nothing_heavy():
    """Heavy libraries are imported where they are used: taichi 1 s, rerun 0.5 s."""
    heavy = ["taichi", "rerun", "cv2", "matplotlib", "pyarrow", "dask", "scipy", "jax", "distributed", "trimesh"]
    result = python("-c", f"import sys, doo_ti.commands.cli; print([name for name in {heavy} if name in sys.modules])")
    assert result.returncode == 0, result.stderr
    assert result.stdout.strip() == "[]"


def test_every_room_is_installed():
    named = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["tool"]["setuptools"]["packages"]
    assert set(named) == {".".join(file.parent.relative_to(ROOT).parts) for file in PACKAGE.rglob("*.py")} | {"doo_ti.scenes"}
