"""Valid command lines over the corpus, each taking well under a second."""

import re
from dataclasses import dataclass

from tests.fuzz.corpus import BOARD, MATERIAL

MADE_OF = " ".join(MATERIAL)
SEEN = "--rig rig.yaml --rest-length 3:8"
PERCEIVE = f"perceive {SEEN} --sets images/sets.csv {MADE_OF} --hypotheses 4 --out out/F.npz"
SINGLE = (
    "perceive images/silk_14mm_000deg_cam0.jpg images/silk_14mm_000deg_cam1.jpg images/silk_14mm_000deg_cam2.jpg "
    f"{SEEN} --seed-point 0,0,0 --seed-direction 0.94,0,0.34 {MADE_OF} --hypotheses 4 --out out/F.npz --no-picture "
    "--no-recording"
)
PATHS = {"--out", "--images", "--picture", "--recording", "--animation"}
"""Options that name outputs."""
COMPANIONS = {
    "dynamic.toml": ("pairs.csv",),
    "file.toml": ("rods.npz",),
    "images/sets.csv": ("images",),
    "frames.csv": ("images",),
    "views.csv": ("boards",),
}
"""What a file of the corpus names itself."""


@dataclass(frozen=True)
class Recipe:
    """A valid command line, and its relative frequency.

    held  folder of the corpus that lies at the last word of ``--out`` before the command begins
    """

    words: tuple[str, ...]
    weight: float
    held: str | None = None

    @property
    def names(self) -> tuple[str, ...]:
        """Files and folders of the corpus that the command reads."""
        found = [word.partition(":")[0] for option, word in zip(self.words, self.words[1:]) if option not in PATHS]
        found = [name for name in found if re.fullmatch(r"\w*run|[\w/]+\.[a-z]+", name) and not name.startswith("out/")]
        more = [name for each in found for name in COMPANIONS.get(each, ())]
        return tuple(dict.fromkeys([*found, *more, *([self.held] if self.held else [])]))


def _recipes() -> tuple[Recipe, ...]:
    lines = [
        (f"relax {name} {MADE_OF} --out out/F.npz", 3)
        for name in ("rods.npz", "rods.csv", "rods.parquet", "ribbons.npz", "labs.npz")
    ]
    lines += [
        (f"convert {name} out/F{suffix}", 3)
        for name, suffix in (("rods.npz", ".csv"), ("rods.csv", ".npz"), ("rods.parquet", ".npz"), ("ribbons.npz", ".parquet"))
    ]
    lines += [
        ("sweep scene.toml --out out/run", 1),
        ("sweep file.toml --out out/run", 1),
        ("sweep dynamic.toml --out out/run", 1),
        ("sweep rods.npz --bend 2e5:8e5:2 --out out/run --json", 1),
        ("sweep labs.npz --bend 4e5 --clamp-end position --roll-hypotheses 2 --out out/run", 0.5),
        ("sweep rods.npz --bend 4e5 --objective dynamic --pairs pairs.csv --out out/run", 1),
        ("learn run", 4),
        ("learn dynamic_run --json", 3),
        ("learn run ribbon_run", 1),
        ("learn run --by end-distance --out out/tables", 2),
        ("refine run --starts 1 --no-models --rest-curvature none --parameters bend --edges 8", 1),
        (f"refine rods.npz {MADE_OF} --no-models --rest-curvature none --parameters bend --edges 8 --out out/F.json", 1),
        (
            f"refine rods.npz {MADE_OF} --no-models --rest-curvature none --parameters bend --folds 2 --groups "
            "groups.npz:group --edges 8 --json",
            0.5,
        ),
        (f"predict rods.npz --motion path.npz --relative {MADE_OF} --sub-step 30 --out out/F.npz", 2),
        (f"predict rods.npz --motion path.csv {MADE_OF} --sub-step 30 --out out/F.npz --json", 2),
        (f"predict rods.npz --motion marks_path.npz {MADE_OF} --sub-step 30 --out out/F.npz", 2),
        ("predict loop.toml --sub-step 30 --out out/F.npz", 3),
        ("predict loop.toml --sub-step 30 --out out/F.npz --picture out/F.png --recording out/F.rrd", 0.5),
        ("group tied.toml --out out/F.npz", 2),
        ("group tied.toml --out out/F.npz --picture out/F.png --recording out/F.rrd --json", 0.5),
        ("simulate swing.toml --out out/F.npz", 3),
        ("simulate swing.toml --out out/F.npz --picture out/F.png --recording out/F.rrd --animation out/F.gif", 0.5),
        ("simulate recorded.npz --theta theta.json --out out/F.npz --json", 4),
        ("simulate recorded.npz --theta theta.json --out out/F.npz --substeps 2 --scheme euler --fill-gaps", 1),
        ("identify recorded.npz --modes 1 --bend 1e6 --out out/F.json", 1),
        ("identify recorded.npz --modes 0 --fit friction --bend 1e6 --smoothing 3 --obstacles table.toml --radius 1 "
         "--out out/F.json", 0.5),
        ("identify recorded.npz recorded.npz --modes 0 --fit drag --folds 2 --out out/F.json --json", 0.5),
        ("relax rods.npz --theta theta.json --out out/F.npz", 1),
        (f"twist rods.npz {MADE_OF} --out out/F.npz --picture out/F.png", 0.5),
        (f"twist perceived.npz {MADE_OF} --out out/F.npz --json", 2),
        (f"twist labs.npz {MADE_OF} --offsets offsets.npz --out out/F.npz", 2),
        (f"twist labs.npz {MADE_OF} --offsets offsets.csv --regrasp 2 --out out/F.npz", 2),
        ("figures run --out out/figures --cells 2", 0.7),
        ("figures dynamic_run --out out/figures", 0.7),
        ("figures ribbon_run --out out/figures", 0.7),
        ("plan scene.toml --picks 2", 2),
        ("plan rods.npz --bend 2e5:8e5:2 --picks 2 --out out/plan", 1),
        ("plan labs.npz --bend 4e5 --json", 1),
        ("view run", 1),
        ("view run/run.rrd", 0.5),
        ("synth scene.toml --out out/F.npz", 2),
        ("synth ribbon.toml --out out/F.csv", 1),
        ("synth scene.toml --images out/images --rig rig.yaml --render noise=2", 1),
        ("bench --rods 8 --rounds 0", 0.3),
        (f"calibrate views.csv --board {BOARD} --out out/rig.yaml", 3),
        (f"calibrate views.csv --board {BOARD} --out out/rig.yaml --json --distortion 2 --world camera", 2),
        ("triangulate marks.csv --rig rig.yaml --labels labels.csv --out out/F.npz", 5),
        ("triangulate marks.csv --rig rig.yaml --rest-length 3 --out out/F.csv --json", 3),
        (PERCEIVE, 0.7),
        (f"{PERCEIVE} --no-picture --no-recording --truth images/truth.npz --json", 3),
        (f"{PERCEIVE} --no-picture --no-recording --detector canny".replace("3:8", "lengths.npz"), 2),
        (SINGLE, 3),
        (f"track {SEEN} --frames frames.csv {MADE_OF} --out out/F.npz --no-recording", 3),
        (f"track {SEEN} --frames frames.csv {MADE_OF} --out out/F.npz".replace("3:8", "lengths.txt"), 1),
    ]
    resumed = (("sweep scene.toml --out out/run", 3, "run"), ("sweep dynamic.toml --out out/run", 2, "dynamic_run"))
    return tuple(
        [Recipe(tuple(line.split()), weight) for line, weight in lines]
        + [Recipe(tuple(line.split()), weight, held) for line, weight, held in resumed]
    )


RECIPES = _recipes()
COMMANDS = sorted({recipe.words[0] for recipe in RECIPES})
