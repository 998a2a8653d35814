"""How Taichi is started: which processors its threads may use."""

import json
import os
import subprocess
import sys
import time

import pytest

from doo_ti.system import runtime

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
pytestmark = pytest.mark.skipif(len(PROCESSORS) < 2, reason="takes Linux and two processors")


def places(threads: int, **environment) -> list:
    """(processors each of Taichi's threads may use, those the caller may)."""
    done = subprocess.run([sys.executable, "-c", WHERE.replace("THREADS", str(threads))], capture_output=True, text=True,
                          env={**os.environ, **environment}, check=True)
    return json.loads(done.stdout)


def test_as_many_threads_as_processors_have_one_each():
    threads, caller = places(len(PROCESSORS))
    assert sorted(threads) == [[processor] for processor in PROCESSORS] and caller == PROCESSORS


@pytest.mark.thorough
def test_fewer_threads_go_where_the_system_likes():
    threads, _ = places(len(PROCESSORS) - 1)
    assert threads == [PROCESSORS] * (len(PROCESSORS) - 1)


@pytest.mark.thorough
def test_an_environment_variable_leaves_it_to_the_system():
    threads, _ = places(len(PROCESSORS), DOO_TI_PINNED="0")
    assert threads == [PROCESSORS] * len(PROCESSORS)


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


def test_a_thread_that_has_ended_is_passed_over():
    done = subprocess.run([sys.executable, "-c", ENDED], capture_output=True, text=True)
    assert done.stdout.strip() == "1", done.stderr


OTHER_THREADS = """
from threading import Event, Thread
import numpy as np
from doo_ti import Clamp, Clamps, Configuration, Material, relax
from doo_ti.system import runtime

rods = Configuration(np.zeros((1, 3)), np.tile([1.0, 0, 0, 0], (1, 9, 1)), np.full(9, 3.0))
clamps = Clamps(Clamp.FRAME, Clamp.FREE, np.zeros((1, 3)), np.zeros((1, 3)), np.eye(3)[None], np.eye(3)[None])
found = []

done, started = Event(), Event()

def start():
    runtime.start()
    started.set()
    done.wait()  # an ended thread's identity may be given to the next

def run(function):
    thread = Thread(target=function)
    thread.start()
    thread.join()

Thread(target=start).start()
started.wait()
for precision in ("f64", "f32", "mixed"):
    run(lambda: found.append(relax(rods, Material(6e5, 8e5), clamps, precision=precision).converged.all()))
done.set()
print(found)
"""


@pytest.mark.thorough
def test_any_thread_may_start_and_any_other_use_the_kernels():
    done = subprocess.run([sys.executable, "-c", OTHER_THREADS], capture_output=True, text=True)
    assert done.stdout.strip() in ("[True, True, True]", "[np.True_, np.True_, np.True_]"), done.stderr


START = "from doo_ti.cli import main; import sys; sys.exit(main(['relax', 'absent.npz', '--bend', '1e5', '--out', 'F.npz']))"


@pytest.mark.sampled(1)
@pytest.mark.parametrize(("name", "value"), [("DOO_TI_ARCHITECTURE", "gpu"), ("DOO_TI_ARCHITECTURE", ""), ("TI_ARCH", "cuda"),
                                             ("TI_ARCH", "vulkan"), ("TI_ARCH", ""), ("TI_ARCH", "nothing")])
def test_where_to_run_is_said_once(tmp_path, name, value):
    done = subprocess.run([sys.executable, "-c", START], capture_output=True, text=True, env={**os.environ, name: value},
                          cwd=tmp_path)
    assert done.returncode == 2 and done.stderr.count("\n") == 1 and f"environment: {name}" in done.stderr


@pytest.mark.thorough
def test_cuda_without_a_device_is_refused(tmp_path):
    script = "import taichi as ti; print(ti.lang.misc.is_arch_supported(ti.cuda))"
    if "True" in subprocess.run([sys.executable, "-c", script], capture_output=True, text=True).stdout:
        pytest.skip("there is a device")
    for start in (START, "from doo_ti.system import runtime; runtime.start('cuda')"):
        done = subprocess.run([sys.executable, "-c", start], capture_output=True, text=True,
                              env={**os.environ, "DOO_TI_ARCHITECTURE": "cuda"}, cwd=tmp_path)
        assert "environment: DOO_TI_ARCHITECTURE" in done.stderr.splitlines()[-1]
        assert (done.returncode, done.stderr.count("\n")) == (2, 1) or start is not START


FORKED = """
import os
import signal
from doo_ti import InputError, Observations, distance, straight_rod
from doo_ti.system import runtime

rod = straight_rod(9.0, 3)
seen = Observations(rod.vertices)
runtime.start()
child = os.fork()
if child == 0:
    signal.alarm(20)  # ends it where it waits
    for use in (runtime.start, lambda: distance(rod, seen)):
        try:
            use()
        except InputError as error:
            print(error.field, flush=True)
    os._exit(0)
print(os.waitpid(child, 0)[1])
"""
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
@pytest.mark.parametrize(("script", "said"), [(FORKED, ["fork", "fork", "0"]), (FORKED_BEFORE, ["cpu", "cpu"])])
def test_a_fork_says_that_it_cannot_use_its_parents_kernels(script, said):
    done = subprocess.run([sys.executable, "-W", "ignore", "-c", script], capture_output=True, text=True)
    assert done.stdout.split() == said, done.stderr


def test_a_kernel_that_is_compiled_briefly_changes_no_setting():
    import taichi as ti

    runtime.start()
    settings = ti.lang.impl.current_cfg()
    seen = []

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
