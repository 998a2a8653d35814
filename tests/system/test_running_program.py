"""Programs that use Taichi themselves, before and after our kernels, and processes forked from them."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

TOGETHER = """
import hashlib
import taichi as ti
from doo_ti import Clamp, InputError, Material, hanging, relax

OPTIONS, VALUE = {}, 0.3333333432674408
ROPE, CLAMPS = hanging(500.0, 12, start=(0, 0, 0), end=(300, 0, 0), clamp=Clamp.FRAME)


def bits():
    solution = relax(ROPE, Material(1e6, 1e6), CLAMPS, precision="mixed")
    print(hashlib.sha256(solution.configuration.vertices.tobytes()).hexdigest(), flush=True)
    return solution


@ti.kernel
def grow():
    for i in field:
        field[i] += 1


@ti.kernel
def third() -> ti.f64:
    return 1 / 3


def begin():
    global field
    ti.init(arch=ti.cpu, **OPTIONS)
    field = ti.field(ti.i32, shape=4)


def own(count):
    print(field.to_numpy().tolist() == [count] * 4 and third() == VALUE, flush=True)

"""
BEFORE = "begin(); grow(); bits(); grow(); own(2); bits(); own(2)"
AFTER = "first = bits(); begin(); grow(); bits(); grow(); own(2); relax(first, Material(2e6, 1e6)); begin(); bits(); own(0); " \
        "ti.reset(); bits(); begin(); own(0)"
OTHERS = "OPTIONS = dict(default_fp=ti.f64, default_ip=ti.i64, debug=True, opt_level=0, cpu_max_num_threads=1)\n" \
         "VALUE = 1 / 3\n"


def said(folder: Path, script: str) -> list[str]:
    path = folder / "program.py"  # Taichi reads a kernel's source
    path.write_text(script, encoding="utf-8")
    done = subprocess.run([sys.executable, "-W", "ignore", path], capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, done.stderr
    return [line for line in done.stdout.splitlines() if not line.startswith("[Taichi]")]


@pytest.mark.thorough
@pytest.mark.parametrize(("calls", "options", "own", "ours"), [(BEFORE, "", 2, 2), (AFTER, "", 3, 4), (BEFORE, OTHERS, 2, 2)])
def test_the_users_own_taichi_program_stays_and_ours_runs_in_it(tmp_path, calls, options, own, ours):
    lines = said(tmp_path, f"{TOGETHER}{options}{calls}")
    assert lines.count("True") == own
    assert [line for line in lines if line != "True"] == said(tmp_path, f"{TOGETHER}bits()") * ours


REFUSED = """
def refused():
    try:
        bits()
    except InputError as error:
        print(error.source, error.field)

ti.init(arch=ti.cpu)
thread = __import__("threading").Thread(target=refused)
thread.start()
thread.join()
field = ti.field(ti.i32)
refused()
ti.root.dense(ti.i, 4).place(field)
assert bits().converged.all()
grow()
print(field.to_numpy().tolist())
"""


@pytest.mark.thorough
def test_what_cannot_be_ready_is_refused_before_anything_is_lost(tmp_path):
    lines = said(tmp_path, TOGETHER + REFUSED)
    assert [lines[0], lines[1], lines[-1]] == ["Taichi thread", "Taichi fields", "[1, 1, 1, 1]"]


FORKED = """
child = os.fork()
if child == 0:
    signal.alarm(20)  # ends it where it waits
    try:
        bits()
    except InputError as error:
        print(error.field, flush=True)
    END
_, status = os.waitpid(child, 0)
print(os.waitstatus_to_exitcode(status))
bits()
"""


@pytest.mark.thorough
@pytest.mark.skipif(not hasattr(os, "fork"), reason="nothing forks here")
@pytest.mark.parametrize(("begin", "end", "code"), [
    ("bits()", "sys.exit(7)", 7), ("bits()", "raise RuntimeError", 1), ("bits(); begin(); bits()", "sys.exit(7)", 7)])
def test_a_forked_process_ends_as_it_would(tmp_path, begin, end, code):
    lines = said(tmp_path, f"import os, signal, sys\n{TOGETHER}{begin}\n{FORKED.replace('END', end)}")
    assert lines[-3:] == ["fork", str(code), lines[0]]
