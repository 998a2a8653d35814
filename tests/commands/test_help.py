"""The help: every command with two valid examples, wrong words name the right one, the defaults are those of the code."""

import re
import shlex

import numpy as np
import pytest

from doo_ti.commands.cli import _parser
from doo_ti.commands.help_text import EXAMPLES, FIRST, GROUPS, OTHER_WORDS
from tests.commands.calls import ended, refused, succeeded
from tests.processes import ROOT

COMMANDS = _parser().meanings


def test_every_command_is_in_one_group():
    grouped = [name for names in GROUPS.values() for name in names]
    assert sorted(grouped) == sorted(COMMANDS) and set(EXAMPLES) == set(COMMANDS) >= set(OTHER_WORDS.values())


@pytest.mark.parametrize("argv", [[], ["help"], ["--help"]])
def test_the_program_alone_shows_its_commands(argv, capsys):
    assert succeeded(capsys, "--version").startswith("doo-ti ")
    out, err = ended(capsys, argv)
    assert not err and all(f"\n  {name} " in out for name in COMMANDS) and all(f"\n{title}:" in out for title in GROUPS)


@pytest.mark.parametrize("command", COMMANDS)
def test_help_shows_valid_examples_and_what_matters_and_help_all_the_rest(command, capsys):
    page, lines, out = f"commands/{command}.md", EXAMPLES[command], {}
    assert (ROOT / "docs" / page).exists() and len(lines) == 2
    for line, _ in lines:
        assert _parser().parse_args(shlex.split(line)).command == command
    for words in (f"help {command}", f"{command} --help", f"{command} --help-all"):
        out[words] = succeeded(capsys, words)
        assert all(f"\n  doo-ti {line}\n" in out[words] for line, _ in lines) and out[words].endswith(f"More in docs/{page}\n")
    names = {action.option_strings[-1]: action.required for action in _parser().commands[command]._actions
             if action.option_strings and action.help != "==SUPPRESS=="}
    assert set(FIRST.get(command, names)) <= set(names)
    shown = {words.split()[-1]: re.findall(r"^  (?:-h, )?(--[\w-]+)", text, re.MULTILINE) for words, text in out.items()}
    assert set(shown["--help-all"]) - {"--help-all"} == set(names) - {"--help-all"}
    assert {name for name, required in names.items() if required} <= set(shown["--help"]) and len(shown["--help"]) <= 18


@pytest.mark.parametrize(("argv", "meant"), [
    ("swep", "did you mean sweep?"), ("render", "did you mean synth?"), ("xyzzy", "see doo-ti help"),
    ("relax a.npz --out b.npz --bendd 1", "did you mean --bend?"), ("help relex", "did you mean relax?"),
    ("relax a.npz --bend 1 --outt b.npz", "doo-ti: relax: --outt: unknown option; did you mean --out?")])
def test_wrong_words_name_the_right_one(argv, meant, tmp_path, capsys):
    refused(capsys, tmp_path, argv, meant)


def defaults() -> dict[tuple[str, str], float]:
    """The numbers that commands take where an option is absent, by where the code has them."""
    from doo_ti.commands import machine, moving_rods, plan, refine, runs, steer, synth
    from doo_ti.commands.image_options import RECORDED
    from doo_ti.dynamics.identify import IdentifyOptions
    from doo_ti.dynamics.parameters import Dynamics, Stepping
    from doo_ti.learning.experiment import SweepOptions
    from doo_ti.manipulation.plan import PlanOptions
    from doo_ti.motion.path import LARGEST_TURN
    from doo_ti.perception.search import PerceptionOptions
    from doo_ti.perception.virtual_lab import DIAMETER_MM
    from doo_ti.rod.types import Material
    from doo_ti.vision.render import RenderOptions

    found = {("simulate", "--most-substeps"): Stepping.most_substeps, ("simulate", "--substeps"): Stepping.substeps,
             ("predict", "--sub-step"): np.degrees(LARGEST_TURN), ("predict", "--steps-between"): 1,
             ("identify", "--modes"): IdentifyOptions.modes, ("identify", "--robust"): IdentifyOptions.delta,
             ("identify", "--substeps"): IdentifyOptions.substeps, ("perceive", "--nu"): PerceptionOptions.nu,
             ("perceive", "--hypotheses"): PerceptionOptions.hypotheses, ("perceive", "--recorded-sets"): RECORDED,
             ("refine", "--starts"): refine.STARTS, ("plan", "--picks"): plan.PICKS, ("synth", "--diameter"): synth.DIAMETER_MM,
             ("figures", "--cells"): runs.MOST_CELLS, ("bench", "--rods"): machine.RODS, ("bench", "--rounds"): machine.ROUNDS,
             ("sweep", "--roll-hypotheses"): SweepOptions.spins, ("relax", "--frame-weight"): SweepOptions.frame_weight,
             ("steer", "--reached"): steer.PLANNED, ("steer", "--seconds"): PlanOptions.seconds,
             ("servo", "--reached"): steer.REACHED, ("servo", "--steps"): steer.STEPS, ("servo", "--diameter"): DIAMETER_MM,
             ("servo", "--noise"): RenderOptions.noise, ("twist", "--observations"): 1, ("simulate", "--smoothing"): 1,
             ("identify", "--smoothing"): 1}
    for command in COMMANDS:
        found |= {(command, "--weight"): Material.weight, (command, "--twist-ratio"): 1}
        found |= {(command, f"--{name.replace('_', '-')}"): getattr(Dynamics, name) for name in moving_rods.LOSSES}
    return found


def test_the_defaults_in_the_help_are_those_of_the_code():
    known, wrong = defaults(), []
    for command in COMMANDS:
        for action in _parser().commands[command]._actions:
            option = (action.option_strings or [action.dest])[-1]
            stated = re.search(r"\(default:? (?:at most )?([-+\w.]+)", action.help or "")
            number = stated and re.fullmatch(r"\d[\d.e+]*", stated[1].rstrip("."))
            if action.default in (None, False, "==SUPPRESS==", []):
                right = not number or known.get((command, option), 0) == float(stated[1])
            elif option == "--fit":
                right = "(default: the first four)" in action.help
            elif number:
                right = float(stated[1]) == float(action.default)
            else:
                right = re.search(rf"default:? {action.default}\b|{action.default}: [^;:]*\(default\)", action.help)
            if not right:
                wrong.append((command, option, stated and stated[1], action.default))
    assert not wrong
