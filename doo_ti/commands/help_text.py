"""Help: commands by what they are for, examples of each, and which command a wrong word means."""

from difflib import get_close_matches
from textwrap import indent

GROUPS = {
    "Fit a rod to observed shapes": ("sweep", "refine", "learn", "plan", "figures"),
    "Predict shapes": ("relax", "group", "predict", "twist"),
    "Images": ("calibrate", "triangulate", "perceive", "track"),
    "Motion": ("simulate", "identify", "steer", "servo"),
    "Utilities": ("synth", "convert", "view", "bench", "warm"),
}
"""Commands by what they are for, in the order of their use."""
EXAMPLES: dict[str, list[tuple[str, str]]] = {}
"""Of each command two examples with their meaning."""
for _line in """
sweep scenes/vicryl.toml --out runs/vicryl  # the virtual lab, 37 500 rods
sweep rope.npz --EI 1e-5:1e-3:25 --linear-density 50 --out runs/rope  # own marks, in N m² and g/m
refine runs/vicryl  # parameters with 95 % intervals, from the best cell of a sweep
refine runs/rope --linear-density 50 --json  # the same in N m², as JSON
learn runs/nylon runs/vicryl runs/silk --by material  # leave-one-out tables
learn runs/vicryl --by end-distance --out tables  # as text, CSV and Markdown
plan scenes/vicryl.toml --out plan  # which configurations to measure next
plan rope.npz --bend 4e5:8e5:5 --twist 6e5 --out plan  # of own observations
figures runs/nylon runs/vicryl --out figures  # landscapes, and a recording of all cells
figures runs/vicryl --by end-distance --out figures  # a landscape for each end distance
relax suture.npz --bend 6e5 --twist 8e5 --out relaxed.npz  # each observation as relaxed
relax rope.csv --EI 1e-4 --linear-density 50 --out relaxed.npz  # in physical units
group scenes/groups/wire_harness.toml --out harness.npz --picture harness.png  # a harness
group scenes/groups/reef_knot.toml --out knot.npz --recording knot.rrd  # two ropes that are knotted
predict suture.npz --motion path.csv --bend 6e5 --twist 8e5 --out moved.npz  # poses in the world
predict scenes/motion/loop_pop_out.toml --out loop.npz --picture loop.png  # a scene of motion
twist suture.npz --bend 6e5 --twist 8e5 --out phi.npz --picture phi.png  # a twist angle each
twist rods.npz --bend 6e5 --twist 8e5 --observations 6 --out phi.npz  # six share one unknown angle
calibrate views.csv --board charuco:10x7:10:7 --out rig.yaml  # cameras from images of a board
calibrate views.csv --board chessboard:9x6:25 --out rig.yaml  # the same from a chessboard
triangulate marks.csv --rig rig.yaml --out suture.npz  # labelled marks to observations
triangulate marks.csv --rig rig.yaml --out suture.npz --json  # counts and outliers as JSON
perceive --rig rig.yaml --sets sets.csv --rest-length 3:33 --bend 6e5 --twist 8e5 --out rods.npz  # many sets
perceive left.png right.png --rig rig.yaml --seed-pixel left:412,300 --out rod.npz  # one set, from a click
track --rig rig.yaml --frames video.csv --rest-length 3:33 --bend 6e5 --twist 8e5 --out video.npz  # from a video
track --rig rig.yaml --frames video.csv --seed-pixel left:412,300 --out video.npz  # from a click in the first frame
steer rope.npz --target goal.npz --EI 1e-4 --GJ 1e-4 --linear-density 50 --out path.csv  # both grippers' motion
steer rope.npz --target goal.npz --bend 6e5 --obstacles table.toml --radius 1 --out path.csv  # past obstacles
servo rope.npz --target goal.npz --rig rig.yaml --bend 6e5 --out run  # with a true rod as the model says
servo rope.npz --target goal.npz --rig rig.yaml --EI 1e-4 --linear-density 50 --true-EI 1.3e-4 --out run  # a stiffer one
simulate scenes/motion/hanging_cables.toml --out hanging.npz --animation hanging.gif  # eight cables
simulate marks.npz --motion poses.csv --theta theta.json --out moved.npz  # observed rods that grippers move
identify motion.npz --out theta.json  # a rod from recorded motion
identify motion.npz --obstacles table.toml --radius 2 --fit friction,bend_damping --out theta.json  # one on a table
synth scenes/vicryl.toml --out vicryl.npz  # simulated observations
synth scenes/vicryl.toml --images lab --rig scenes/rig.yaml  # rendered images, and the true rods
convert marks.csv marks.npz  # from a table to arrays
convert suture.npz suture.parquet  # to a table for other programs
view runs/vicryl  # a recording in the viewer's window
view runs/vicryl --screenshot run.png  # as a picture, without a display
warm perceive track  # before the first images
warm  # for all commands, in minutes
bench  # throughput and accuracy on this machine, as a table
bench --out bench  # and as files
""".strip().splitlines():
    EXAMPLES.setdefault(_line.split()[0], []).append(tuple(_line.split("  # ")))
ALWAYS = ("-h", "--help", "--help-all", "--json")
_MATERIAL, _FILES = ("--EI", "--GJ", "--linear-density"), ("--unit", "--columns", "--up")
FIRST = {
    "sweep": (*_MATERIAL, *_FILES, "--rest-length", "--clamp-start", "--clamp-end", "--workers"),
    "refine": ("--parameters", "--linear-density", "--frames", "--clip", "--rest-length", "--spacing-error", "--rest-curvature",
               *_FILES, "--out"),
    "relax": (*_MATERIAL, *_FILES, "--clamp-start", "--clamp-end", "--obstacles", "--radius"),
    "predict": ("--motion", *_MATERIAL, *_FILES, "--obstacles", "--radius", "--picture", "--recording"),
    "steer": (*_MATERIAL, *_FILES, "--clamp-start", "--clamp-end", "--obstacles", "--radius", "--seconds"),
    "servo": (*_MATERIAL, *_FILES, "--true-EI", "--true-GJ", "--noise", "--occlude", "--steps", "--reached"),
    "simulate": ("--motion", "--theta", *_MATERIAL, "--tolerance", "--obstacles", "--radius", "--unit", "--rate", "--picture",
                 "--recording", "--animation"),
    "perceive": ("--sets", "--seed-pixel", "--edge", "--length", "--rest-length", *_MATERIAL, "--masks", "--colour"),
    "track": ("--seed-pixel", "--rest-length", "--motion", *_MATERIAL, "--colour", "--masks", "--width", "--no-recording"),
    "identify": ("--fit", "--still", "--obstacles", "--radius", *_FILES, "--rate", "--picture"),
    "plan": (*_MATERIAL, *_FILES, "--sigma", "--picks", "--measured"),
    "twist": (*_MATERIAL, *_FILES, "--observations", "--picture"),
}
"""Of commands with many options those that ``--help`` shows, besides the ones that must be given; of others it shows all."""
OTHER_WORDS = {
    "fit": "sweep", "search": "sweep", "estimate": "refine", "train": "learn", "forward": "relax", "solve": "relax",
    "render": "synth", "generate": "synth", "detect": "perceive", "rollout": "simulate", "import": "convert",
    "shape": "steer", "manipulate": "steer", "harness": "group", "net": "group",
    "export": "convert", "open": "view", "show": "view", "plot": "figures", "benchmark": "bench",
}
"""Words that other programs use."""


def overview(meanings: dict[str, str]) -> str:
    """The help of the program, from the meaning of every command."""
    lines = ["usage: doo-ti COMMAND ...", "",
             "Discrete elastic rods for suture, rope, cable and ribbon (Javdani et al., ICRA 2011).", ""]
    for title, names in GROUPS.items():
        lines += [f"{title}:", *(f"  {name:<12} {meanings[name]}" for name in names), ""]
    return "\n".join([*lines, "doo-ti help COMMAND shows options and examples. Begin with:", "",
                      f"  doo-ti {EXAMPLES['sweep'][1][0]}", ""])


def examples(command: str) -> str:
    """The end of a command's help."""
    text = "\n".join(f"doo-ti {line}\n    {meaning}" for line, meaning in EXAMPLES[command])
    return f"examples:\n{indent(text, '  ')}\n\nMore in docs/commands/{command}.md"


def nearest(word: str, known) -> str | None:
    """What was probably meant by ``word``."""
    close = get_close_matches(word, list(known), 1, 0.6)
    return OTHER_WORDS.get(word) or (close[0] if close else None)
