"""How Taichi is started, by which threads and processes; its kernels; programs that use Taichi themselves, or fork."""

import inspect
import json
import os
import time
from pathlib import Path

import pytest

from doo_ti.relaxation import chain, contacts, newton_trip
from doo_ti.system import runtime
from doo_ti.system.taichi_internals import _lines_of
from tests.first_use import CALLS, PREPARED
from tests.processes import python

WHERE = """
import json
import os
before = {int(task) for task in os.listdir("/proc/self/task")}
from doo_ti.system import runtime
runtime.start(threads=THREADS)
tasks = sorted({int(task) for task in os.listdir("/proc/self/task")} - before)
print(json.dumps([[sorted(os.sched_getaffinity(task)) for task in tasks][-THREADS:], sorted(os.sched_getaffinity(0))]))
"""
PROCESSORS = sorted(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else []
of_two = pytest.mark.skipif(len(PROCESSORS) < 2, reason="takes Linux and two processors")


def places(threads: int, **environment) -> list:
    """(processors each of Taichi's threads may use, those the caller may)."""
    return json.loads(python("-c", WHERE.replace("THREADS", str(threads)), **environment).stdout)


@of_two
def test_as_many_threads_as_processors_have_one_each():
    threads, caller = places(len(PROCESSORS))
    assert sorted(threads) == [[processor] for processor in PROCESSORS] and caller == PROCESSORS


@of_two
@pytest.mark.thorough
@pytest.mark.parametrize(("fewer", "environment"), [(1, {}), (0, {"DOO_TI_PINNED": "0"})])
def test_other_threads_go_where_the_system_likes(fewer, environment):
    threads, _ = places(len(PROCESSORS) - fewer, **environment)
    assert threads == [PROCESSORS] * (len(PROCESSORS) - fewer)


ENDED = """
import os
import subprocess
from doo_ti.system import runtime

ended = subprocess.Popen(["true"])
ended.wait()  # its number names nobody any more
runtime.thread_count = lambda: len(runtime.processors())
runtime.pin([ended.pid, os.getpid()])
print(len(os.sched_getaffinity(0)))
"""


@of_two
@pytest.mark.thorough
def test_a_thread_that_has_ended_is_passed_over():
    done = python("-W", "ignore", "-c", ENDED)
    assert done.stdout.strip() == "1", done.stderr


START = ("from doo_ti.commands.cli import main; import sys; "
         "sys.exit(main(['relax', 'absent.npz', '--bend', '1e5', '--out', 'F.npz']))")


@pytest.mark.sampled(1)
@pytest.mark.parametrize(("name", "value"), [("DOO_TI_ARCHITECTURE", "gpu"), ("DOO_TI_ARCHITECTURE", ""), ("TI_ARCH", "cuda"),
                                             ("TI_ARCH", "vulkan"), ("TI_ARCH", ""), ("TI_ARCH", "nothing")])
def test_where_to_run_is_said_once(tmp_path, name, value):
    done = python("-W", "ignore", "-c", START, folder=tmp_path, **{name: value})
    assert done.returncode == 2 and done.stderr.count("\n") == 1 and f"environment: {name}" in done.stderr


@pytest.mark.thorough
def test_cuda_without_a_device_is_refused(tmp_path):
    script = "import taichi as ti; print(ti.lang.misc.is_arch_supported(ti.cuda))"
    if "True" in python("-c", script).stdout:
        pytest.skip("there is a device")
    for start in (START, "from doo_ti.system import runtime; runtime.start()"):
        done = python("-W", "ignore", "-c", start, folder=tmp_path, DOO_TI_ARCHITECTURE="cuda")
        assert "environment: DOO_TI_ARCHITECTURE" in done.stderr.splitlines()[-1]
        assert (done.returncode, done.stderr.count("\n")) == (2, 1) or start is not START


FORKED_BEFORE = """
import os
from doo_ti.system import runtime

child = os.fork()
if child:
    os.waitpid(child, 0)
print(runtime.start(), flush=True)
if child == 0:
    os._exit(0)
"""


@pytest.mark.thorough
@pytest.mark.skipif(not hasattr(os, "fork"), reason="nothing forks here")
def test_a_process_forked_before_the_first_use_has_kernels_of_its_own():
    done = python("-W", "ignore", "-c", FORKED_BEFORE)
    assert done.stdout.split() == ["cpu", "cpu"], done.stderr


def test_a_kernel_that_is_compiled_briefly_changes_no_setting():
    import taichi as ti

    runtime.start()
    settings, seen = ti.lang.impl.current_cfg(), []

    @runtime.compiled_briefly
    def kernel(number: int) -> None:
        seen.append((number, settings.advanced_optimization))
        if number == 2:
            raise ValueError
    before = settings.advanced_optimization
    kernel(1)
    with pytest.raises(ValueError):
        kernel(number=2)
    on_cpu = runtime.start() == "cpu"
    assert seen == [(1, not on_cpu), (2, not on_cpu)] and settings.advanced_optimization == before


def test_the_clock_of_limits_stands_still_while_kernels_compile():
    began = time.monotonic() - runtime.working_time()
    with runtime._compiling():
        time.sleep(0.05)
    assert time.monotonic() - runtime.working_time() - began >= 0.05


FIRST = ("relax", "simulate")


@pytest.mark.parametrize(("name", "threads"), [
    *(pytest.param(name, 8, marks=pytest.mark.thorough) for name in FIRST),
    *(pytest.param(name, threads, marks=pytest.mark.slow) for name in (*CALLS, *PREPARED) for threads in (2, 8)
      if name not in FIRST or threads < 8)])
def test_any_function_may_be_the_first_of_several_threads(name, threads):
    """Which use the kernels for the first time at the same moment: Taichi compiles for one at a time."""
    done = python("-m", "tests.first_use", name, threads)
    assert done.stdout.split("\n")[-2:] == ["alike", ""], f"{done.stdout}{done.stderr}"


def test_no_kernel_is_launched_beside_another():
    """A launch that does not hold the turn fails, whether or not another thread happens to launch then."""
    launched = []
    runtime.start()

    @runtime.kernel
    def nothing():
        pass
    with pytest.raises(RuntimeError, match="nothing"):
        nothing()
    runtime.exclusive(lambda: launched.append(nothing()))()
    assert launched == [None]
    with pytest.raises(RuntimeError):  # the turn is given back
        nothing()


def test_lines_of_kernels_functions_are_those_of_inspect():
    def otherwise(function):
        raise AssertionError(f"{function} is not found by its line")
    lines, found = _lines_of(otherwise), 0
    for kind in (chain.Chain, contacts.RodContacts, newton_trip.NewtonTrip):
        for function in vars(kind).values():
            if hasattr(function, "_is_taichi_function"):
                assert lines(function) == inspect.getsourcelines(function)
                found += 1
    assert found > 20


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
    done = python("-W", "ignore", path)
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
