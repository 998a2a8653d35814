"""Types of the public names: complete, and as type checkers see them. And how public objects are printed."""

import enum
import inspect
import os
import re
import shutil
import subprocess
import sys
import typing
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest

import doo_ti
from doo_ti import Clamp, Clamps, EndLoads, Material, Observations, Solution
from tests.references.rods import clamps_at
from tests.relaxation.rods import wandering

ROOT = Path(__file__).resolve().parents[2]
PROGRAM = ROOT / "tests" / "public_names.py"
PUBLIC = {name: getattr(doo_ti, name) for name in doo_ti.__all__}


def test_the_program_uses_every_name():
    used = set(re.findall(r"\w+", PROGRAM.read_text(encoding="utf-8").partition("\n\n\ndef ")[2]))
    assert not set(doo_ti.__all__) - used
    assert (Path(doo_ti.__file__).parent / "py.typed").exists()
    assert not [name for name, thing in PUBLIC.items() if inspect.ismodule(thing)]


def test_every_argument_has_a_type():
    for name, thing in PUBLIC.items():
        functions = {name: thing}
        if inspect.isclass(thing):
            functions = {f"{name}.{key}": getattr(thing, key) for key, value in vars(thing).items() if not key.startswith("_")
                         and isinstance(value, classmethod | staticmethod | type(lambda: 0))}
            functions |= {f"{name}.{key}": value.fget for key, value in vars(thing).items() if isinstance(value, property)}
        for own, function in functions.items():
            signature = inspect.signature(function)
            bare = [key for key, value in signature.parameters.items()
                    if value.annotation is value.empty and key not in ("self", "cls")]
            assert own != name or "numpy._typing" not in str(signature), f"{own}: help() prints what no one reads"
            assert not bare and signature.return_annotation is not signature.empty, f"{own}: {bare}, or its result"


@pytest.mark.thorough
@pytest.mark.parametrize("checker", ["mypy", "pyright"])
def test_type_checkers_find_nothing(checker, tmp_path):
    """From another folder, as a user's program."""
    program = tmp_path / "program.py"
    program.write_text(PROGRAM.read_text(encoding="utf-8"), encoding="utf-8")
    own = ["--strict", "--follow-imports=silent", "--cache-dir", str(tmp_path / "cache")]
    words = [sys.executable, "-m", "mypy", *own] if checker == "mypy" else ["pyright", "--pythonpath", sys.executable]
    if not (find_spec(checker) if checker == "mypy" else shutil.which(checker)):
        pytest.skip(f"{checker} is not installed")
    done = subprocess.run([*words, str(program)], capture_output=True, text=True, cwd=tmp_path,
                          env={**os.environ, "MYPYPATH": str(ROOT), "PYTHONPATH": os.pathsep.join([str(ROOT), *sys.path[1:]])})
    assert done.returncode == 0, done.stdout + done.stderr


def test_objects_are_printed_in_one_line(rng):
    rods, numbers, flags = wandering(rng, 3, 12), np.zeros(3), np.ones(3, dtype=bool)
    material = Material.from_physical([1e-6, 2e-6, 3e-6], 1e-6, 0.01)
    status = numbers.astype(int)
    solution = Solution(rods, numbers, numbers, numbers, status, status, flags, np.zeros((3, 3)), status + 64)
    loads = EndLoads(*(np.zeros((3, 3)) for _ in range(4)), True)
    seen = Observations(rods.vertices, rest_length=np.full(12, 3.0), name="rope")
    assert [repr(thing) for thing in (material, Material(2e5, [[1e5, 3e5]]), rods, clamps_at(rods), solution, seen, loads)] == [
        "Material(3 materials: bend 2e+05 to 6e+05 mm³, twist 2e+05 mm³, weight 1, 0.01 N/m)",
        "Material(1 material: bend 2e+05 mm³, twist 1e+05 to 3e+05 mm³ along the rod, weight 1)",
        "Configuration(3 rods of 12 edges, 36 mm long)", "Clamps(3 rods: start frame, end frame)",
        "Solution(3 rods of 12 edges: 3 converged; 3 certified stable)", "Observations(rope: 3 rods of 13 marks, 36 mm long)",
        "EndLoads(start_force (3, 3), start_moment (3, 3), end_force (3, 3), end_moment (3, 3), physical True)"]


def classes(annotation):
    """All that an annotation names."""
    inner = [one for part in typing.get_args(annotation) for one in (part if isinstance(part, list) else [part])]
    own = {annotation} if inspect.isclass(annotation) else set()
    return own.union(*map(classes, inner))


def test_arguments_are_of_public_types():
    """Whatever a public function or constructor takes can be made from public names."""
    others = {"Refinement", "Identified", "Trajectory", "External", "InterruptedRunError", "Contacts"}  # not made by a program
    public = set(PUBLIC.values())
    for name, thing in PUBLIC.items():
        if name in others or isinstance(thing, enum.EnumMeta):
            continue
        for argument in inspect.signature(thing).parameters.values():
            own = {one for one in classes(argument.annotation) if one.__module__.startswith("doo_ti.")}
            assert not own - public, f"{name}: {argument.name} is of {own - public}"


def test_clamps_of_several_tables_keep_their_kinds_and_rows(rng):
    rods = wandering(rng, 3, 12)
    one, other = clamps_at(rods), clamps_at(rods.take([2]), Clamp.POSITION, Clamp.FRAME)
    alike, mixed = Clamps.concatenate([one, one]), Clamps.concatenate([one, other])
    assert alike.start == one.start and mixed.end == Clamp.FRAME
    assert mixed.start.tolist() == [Clamp.FRAME] * 3 + [Clamp.POSITION]
    np.testing.assert_array_equal(mixed.take([3]).end_position, other.end_position)
    np.testing.assert_array_equal(alike.start_frame[3:], one.start_frame)
