"""Kernels compiled before they are needed: each command that has any is run on a small input, in a process of its own, whose
kernels Taichi keeps for the next ones."""

import os
import subprocess
import sys
import time
from argparse import Namespace
from dataclasses import dataclass, field
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from doo_ti.commands import options as given
from doo_ti.commands.results import report
from doo_ti.system.errors import InputError
from doo_ti.system.files import write_text
from doo_ti.system.interruption import ended, kept_from_children
from doo_ti.system.terminal import in_line, progress

AT_ONCE = 2
"""Processes. Taichi compiles in one thread, and what two compile at the same time both compile."""
POLL_SECONDS = 0.1
MATERIAL = "--bend 4e5 --twist 4e5"
LAB, SEEN = "synth lab.toml --out lab.npz", f"--rig images/rig.yaml --rest-length 3:33 {MATERIAL} --no-recording"
IMAGES = "synth seen.toml --images images --rig rig.yaml"
STEPS = {
    "relax": (LAB, f"relax lab.npz {MATERIAL} --out many.npz", "convert lab.npz one.npz --select 0:1",
              f"relax one.npz {MATERIAL} --out one_relaxed.npz"),
    "perceive": (IMAGES, f"perceive {SEEN} --sets images/sets.csv --no-picture --out rods.npz"),
    "sweep": (LAB, "sweep lab.npz --bend 2e5:8e5:3 --out run"),
    "group": ("group group.toml --out group.npz",),
    "refine": (LAB, f"refine lab.npz {MATERIAL} --rest-curvature none --clip 1.5 --clamps exact --no-models"),
    "simulate": ("simulate moving.toml --out moved.npz",),
    "track": (IMAGES, f"track {SEEN} --frames frames.csv --out video.npz"),
    "identify": ("simulate moving.toml --out moved.npz", "identify moved.npz --bend 1e6 --modes 1 --fit drag --out theta.json"),
    "predict": (LAB, f"predict lab.npz --motion motion.csv --relative {MATERIAL} --out predicted.npz"),
    "twist": (LAB, f"twist lab.npz {MATERIAL} --out phi.npz"),
    "plan": ("plan lab.toml --twist 4e5",),
}
"""Of each command with kernels the commands that compile them, those first that take longest."""
INPUTS = {
    "lab.toml": """clamp_start = "frame"
clamp_end = "frame"
[synthesis]
bend = 4e5
twist = 4e5
end_distances_mm = [54.0, 66.0, 78.0]
end_rotations_deg = [30.0, 60.0, 90.0, 120.0]
[grid]
bend = "2e5:8e5:3"
""",
    "seen.toml": """[synthesis]
bend = 4e5
twist = 4e5
end_distances_mm = [66.0]
end_rotations_deg = [60.0]
[grid]
bend = "2e5:8e5:3"
""",
    "moving.toml": """rate_hz = 50
duration_s = 0.4
[rod]
length_mm = 500.0
edges = 12
[materials.rope]
bend = 1e6
drag_per_s = 0.2
[clamps]
start = "frame"
end = "frame"
[[moments]]
time_s = 0.0
end_position_mm = [400.0, 0.0, 0.0]
[[moments]]
time_s = 0.4
end_position_mm = [420.0, 0.0, 0.0]
""",
    "group.toml": """radius_mm = 2.0
rate_hz = 5
duration_s = 0.4
[materials.rope]
bend = 4e4
twist = 3e4
[rods.one]
edges = 16
points_mm = [[-80, 0, 0], [0, 0, 10], [80, 0, 0]]
start = "tangent"
end = "tangent"
[rods.other]
edges = 16
points_mm = [[0, -80, 20], [0, 0, 30], [0, 80, 20]]
start = "tangent"
end = "tangent"
[[obstacles]]
kind = "itself"
""",
    "frames.csv": """frame,top,side,seed_x,seed_y,seed_z,dir_x,dir_y,dir_z
1,images/seen_66mm_060deg_top.jpg,images/seen_66mm_060deg_side.jpg,0,0,0,0.94,0,0.34
2,images/seen_66mm_060deg_top.jpg,images/seen_66mm_060deg_side.jpg,,,,,,
""",
    "motion.csv": "time_s,end_x,end_y,end_z\n0,0,0,0\n1,1,0,0\n",
}


def declare(add) -> None:
    parser = given.command(add, "warm", run, "compile the kernels of commands now, so that their first use does not wait")
    parser.add_argument("commands", nargs="*", metavar="COMMAND",
                        help=f"those whose kernels to compile: {', '.join(STEPS)} (default: all); those of obstacles depend "
                        "on their kinds and are compiled at their first use")


@dataclass
class _Job:
    """A command whose kernels are being compiled: the steps left, in a folder of its own, and the process of the present."""

    name: str
    folder: Path
    left: list[str] = field(default_factory=list)
    process: subprocess.Popen | None = None
    began: float = 0.0
    seconds: float = 0.0
    problem: str | None = None

    def go_on(self) -> bool:
        """Start the next step where one has ended; False once all have."""
        if self.process is not None:
            if self.process.poll() is None:
                return True
            if self.process.returncode:
                lines = (self.folder / "log.txt").read_text(errors="replace").splitlines()
                self.problem, self.left = lines[-1] if lines else f"exit code {self.process.returncode}", []
        self.seconds = time.monotonic() - self.began
        if not self.left:
            return False
        with (self.folder / "log.txt").open("w") as log, kept_from_children():
            self.process = subprocess.Popen([sys.executable, "-m", "doo_ti", *self.left.pop(0).split()], cwd=self.folder,
                                            stdout=log, stderr=log, env=os.environ | {"PYTHONPATH": os.pathsep.join(sys.path)})
        return True


def run(options: Namespace) -> int:
    if unknown := next((name for name in options.commands if name not in STEPS), None):
        raise InputError(given.SOURCE, "COMMAND", f"{unknown!r} has no kernels", f"give some of {', '.join(STEPS)}")
    names = [name for name in STEPS if not options.commands or name in options.commands]
    with TemporaryDirectory(ignore_cleanup_errors=True) as folder:
        jobs = [_prepared(name, Path(folder) / name) for name in names]
        _done(jobs)
    failed = {job.name: job.problem for job in jobs if job.problem is not None}
    summary = {"seconds": {job.name: job.seconds for job in jobs}, "failed": failed}
    report(options, summary, lambda: [
        f"  {job.name:<11} {job.seconds:.1f} s{'' if job.problem is None else f', FAILED: {in_line(job.problem)}'}"
        for job in jobs])
    return 1 if failed else 0


def _done(jobs: list[_Job]) -> None:
    """Run the jobs, some at once."""
    waiting, running = list(jobs), []
    with progress() as bar:
        task = bar.add_task("compiling", total=len(jobs), unit="commands")
        try:
            while waiting or running:
                while waiting and len(running) < AT_ONCE:
                    running.append(waiting.pop(0))
                    running[-1].began = time.monotonic()
                    bar.update(task, description=f"compiling for {', '.join(job.name for job in running)}")
                for job in [job for job in running if not job.go_on()]:
                    running.remove(job)
                    bar.advance(task, 1)
                time.sleep(POLL_SECONDS)
        finally:
            for job in running:
                if job.process is not None:
                    ended(job.process)


def _prepared(name: str, folder: Path) -> _Job:
    """The job of a command, its input in ``folder``."""
    from doo_ti.vision.cameras import Camera, Rig
    from doo_ti.vision.rig_files import save_rig

    folder.mkdir()
    for file, text in INPUTS.items():
        write_text(folder / file, text)
    matrix, none = [[900.0, 0.0, 320.0], [0.0, 900.0, 240.0], [0.0, 0.0, 1.0]], np.zeros(5)
    beside = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])
    cameras = [Camera(camera, 640, 480, matrix, none, turn, [-33.0, 0.0, 300.0])
               for camera, turn in (("top", np.eye(3)), ("side", beside))]
    save_rig(folder / "rig.yaml", Rig(tuple(cameras)))
    return _Job(name, folder, list(STEPS[name]))
