"""Valid command lines over the corpus, each taking well under a second."""

import re
from dataclasses import dataclass

from tests.fuzz.corpus import BOARD, MATERIAL

MADE_OF = " ".join(MATERIAL)
SEEN = "--rig rig.yaml --rest-length 3:8"
PERCEIVE = f"perceive {SEEN} --sets images/sets.csv {MADE_OF} --hypotheses 4 --out out/F.npz"
SINGLE = (f"perceive {' '.join(f'images/silk_14mm_000deg_cam{camera}.jpg' for camera in range(3))} {SEEN} --seed-point 0,0,0 "
          f"--seed-direction 0.94,0,0.34 {MADE_OF} --hypotheses 4 --out out/F.npz --no-picture --no-recording")
PATHS = {"--out", "--images", "--picture", "--recording", "--animation"}
"""Options that name outputs."""
COMPANIONS = {"dynamic.toml": ("pairs.csv",), "file.toml": ("rods.npz",), "images/sets.csv": ("images",),
              "frames.csv": ("images",), "views.csv": ("boards",)}
"""What a file of the corpus names itself."""


@dataclass(frozen=True)
class Recipe:
    """A valid command line.

    held  folder of the corpus that lies at the last word of ``--out`` before the command begins
    """

    words: tuple[str, ...]
    held: str | None = None

    @property
    def names(self) -> tuple[str, ...]:
        """Files and folders of the corpus that the command reads."""
        found = [word.partition(":")[0] for option, word in zip(self.words, self.words[1:]) if option not in PATHS]
        found = [name for name in found if re.fullmatch(r"\w*run|[\w/]+\.[a-z]+", name) and not name.startswith("out/")]
        more = [name for each in found for name in COMPANIONS.get(each, ())]
        return tuple(dict.fromkeys([*found, *more, *([self.held] if self.held else [])]))


_RODS = "rods.npz", "rods.csv", "rods.parquet", "ribbons.npz", "labs.npz"
_LINES = (
    *(f"relax {name} {MADE_OF} --out out/F.npz" for name in _RODS),
    *(f"convert {name} out/F{suffix}" for name, suffix in zip(_RODS, (".csv", ".npz", ".npz", ".parquet"))),
    "sweep scene.toml --out out/run",
    "sweep file.toml --out out/run",
    "sweep dynamic.toml --out out/run",
    "sweep rods.npz --bend 2e5:8e5:2 --out out/run --json",
    "sweep labs.npz --bend 4e5 --clamp-end position --roll-hypotheses 2 --out out/run",
    "sweep rods.npz --bend 4e5 --objective dynamic --pairs pairs.csv --out out/run",
    "learn run",
    "learn dynamic_run --json",
    "learn run ribbon_run",
    "learn run --by end-distance --out out/tables",
    "refine run --starts 1 --no-models --rest-curvature none --parameters bend --edges 8",
    f"refine rods.npz {MADE_OF} --no-models --rest-curvature none --parameters bend --edges 8 --out out/F.json",
    f"refine rods.npz {MADE_OF} --no-models --rest-curvature none --parameters bend --folds 2 --groups "
    "groups.npz:group --edges 8 --json",
    f"predict rods.npz --motion path.npz --relative {MADE_OF} --sub-step 30 --out out/F.npz",
    f"predict rods.npz --motion path.csv {MADE_OF} --sub-step 30 --out out/F.npz --json",
    f"predict rods.npz --motion marks_path.npz {MADE_OF} --sub-step 30 --out out/F.npz",
    "predict loop.toml --sub-step 30 --out out/F.npz",
    "predict loop.toml --sub-step 30 --out out/F.npz --picture out/F.png --recording out/F.rrd",
    "group tied.toml --out out/F.npz",
    "group tied.toml --out out/F.npz --picture out/F.png --recording out/F.rrd --json",
    "simulate swing.toml --out out/F.npz",
    "simulate swing.toml --out out/F.npz --picture out/F.png --recording out/F.rrd --animation out/F.gif",
    "simulate recorded.npz --theta theta.json --out out/F.npz --json",
    "simulate recorded.npz --theta theta.json --out out/F.npz --substeps 2 --scheme euler --fill-gaps",
    "identify recorded.npz --modes 1 --bend 1e6 --out out/F.json",
    "identify recorded.npz --modes 0 --fit friction --bend 1e6 --smoothing 3 --obstacles table.toml --radius 1 "
    "--out out/F.json",
    "identify recorded.npz recorded.npz --modes 0 --fit drag --folds 2 --out out/F.json --json",
    "relax rods.npz --theta theta.json --out out/F.npz",
    f"twist rods.npz {MADE_OF} --out out/F.npz --picture out/F.png",
    f"twist perceived.npz {MADE_OF} --out out/F.npz --json",
    f"twist labs.npz {MADE_OF} --offsets offsets.npz --out out/F.npz",
    f"twist labs.npz {MADE_OF} --offsets offsets.csv --regrasp 2 --out out/F.npz",
    "figures run --out out/figures --cells 2",
    "figures dynamic_run --out out/figures",
    "figures ribbon_run --out out/figures",
    "plan scene.toml --picks 2",
    "plan rods.npz --bend 2e5:8e5:2 --picks 2 --out out/plan",
    "plan labs.npz --bend 4e5 --json",
    "view run",
    "view run/run.rrd",
    "synth scene.toml --out out/F.npz",
    "synth ribbon.toml --out out/F.csv",
    "synth scene.toml --images out/images --rig rig.yaml --render noise=2",
    "bench --rods 8 --rounds 0",
    f"calibrate views.csv --board {BOARD} --out out/rig.yaml",
    f"calibrate views.csv --board {BOARD} --out out/rig.yaml --json --distortion 2 --world camera",
    "triangulate marks.csv --rig rig.yaml --labels labels.csv --out out/F.npz",
    "triangulate marks.csv --rig rig.yaml --rest-length 3 --out out/F.csv --json",
    PERCEIVE,
    f"{PERCEIVE} --no-picture --no-recording --truth images/truth.npz --json",
    f"{PERCEIVE} --no-picture --no-recording --detector canny".replace("3:8", "lengths.npz"),
    SINGLE,
    f"track {SEEN} --frames frames.csv {MADE_OF} --out out/F.npz --no-recording",
    f"track {SEEN} --frames frames.csv {MADE_OF} --out out/F.npz".replace("3:8", "lengths.txt"),
)
RECIPES = (*(Recipe(tuple(line.split())) for line in _LINES), Recipe(tuple("sweep scene.toml --out out/run".split()), "run"),
           Recipe(tuple("sweep dynamic.toml --out out/run".split()), "dynamic_run"))
