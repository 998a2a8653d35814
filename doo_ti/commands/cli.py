"""The command line ``doo-ti``: options to text, commands to exit codes.

0 done; 1 failed while running, finished results are kept; 2 wrong input: one line that names file or option, field and
remedy, and nothing written.
"""

import argparse
import logging
import os
import re
import sys
from collections.abc import Sequence
from contextlib import redirect_stdout
from typing import NoReturn

from doo_ti import __version__
from doo_ti.commands import (
    cameras,
    group,
    identify,
    machine,
    perceive,
    plan,
    predict,
    refine,
    relax,
    runs,
    simulate,
    steer,
    sweep,
    synth,
    track,
    twist,
)
from doo_ti.commands.help_text import ALWAYS, FIRST, nearest, overview
from doo_ti.io.toml_file import scene_file
from doo_ti.system.errors import InputError, InterruptedRunError
from doo_ti.system.runtime import check_architecture
from doo_ti.system.terminal import VisibleStream, visible

DECLARING = (relax, twist, sweep, plan, runs, refine, predict, steer, simulate, group, identify, synth, machine, cameras,
             perceive, track)
"""The modules of the commands, in the order of their declaration."""


class _Parser(argparse.ArgumentParser):
    """Reports what argparse finds wrong as an InputError naming the option, and names arguments of the library as options."""

    whole = False
    commands: dict[str, "_Parser"]  # of the program, by name
    meanings: dict[str, str]  # of these, in the order of their declaration

    def error(self, message: str) -> NoReturn:
        found = re.match(r"argument (?P<option>[^:]+): (?P<problem>.*)", message, re.DOTALL)
        missing = re.match(r"the following arguments are required: (?P<option>[^,]+)", message)
        option = (found or missing)["option"].split("/")[0] if found or missing else "arguments"
        problem = found["problem"] if found else "missing" if missing else message
        raise InputError(self.prog, option, problem, f"see {self.prog} --help")

    def _get_value(self, action: argparse.Action, text: str):
        if action.type in (None, str, int, float, scene_file):
            return super()._get_value(action, text)
        first = next(other for other in self._actions if other.dest == action.dest)  # of an old name the new one
        return action.type((first.option_strings or [first.metavar])[0], text)

    def in_options(self, error: InputError) -> InputError:
        """``error`` with the options of this command in place of the library's arguments: as its field, where its source is no
        file, and in backticks."""
        names = {action.dest: action.option_strings[0] for action in self._actions
                 if action.option_strings and action.help != argparse.SUPPRESS}
        problem, remedy = (re.sub(r"`(\w+)`", lambda found: names.get(found[1], found[0]), text)
                           for text in (error.problem, error.remedy))
        if error.field in names and not os.path.lexists(error.source):
            return InputError("command line", names[error.field], problem, remedy)
        return InputError(error.source, error.field, problem, remedy)

    def format_help(self) -> str:
        """The help, of a command with many options with those that matter most, unless ``whole`` has been set."""
        optional = [action for action in self._actions if action.option_strings and not action.required]
        names = [action.option_strings[-1] for action in optional if action.help != argparse.SUPPRESS]
        first = FIRST.get(self.prog.split()[-1])
        left_out = [] if self.whole or first is None else [name for name in names if name not in (*ALWAYS, *first)]
        kept, groups, epilog = [action.help for action in optional], self._action_groups, self.epilog
        for action in optional:
            if action.option_strings[-1] in left_out:
                action.help = argparse.SUPPRESS
        self._action_groups = [group for group in groups
                               if any(action.help != argparse.SUPPRESS for action in group._group_actions)]
        if left_out:
            self.epilog = f"{len(left_out)} more options: {self.prog} --help-all\n\n{epilog}"
        try:
            return super().format_help()
        finally:
            self._action_groups, self.epilog = groups, epilog
            for action, text in zip(optional, kept, strict=True):
                action.help = text


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command that ``argv`` (without the program's name) spells out; returns the exit code."""
    argv = list(sys.argv[1:] if argv is None else argv)
    for stream in (sys.stdout, sys.stderr):
        if hasattr(stream, "reconfigure"):  # a console without Θ shows a question mark
            stream.reconfigure(errors="replace")
    # Taichi takes a standard output that is not the process's own for a notebook, reports that, and prints through it.
    os.environ.setdefault("TI_ENABLE_PYBUF", "0")
    try:
        with redirect_stdout(VisibleStream(sys.stdout)):
            return _run(argv)
    except InputError as error:
        return _report(error, 2)
    except BrokenPipeError:  # the reading program, such as head, has ended
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 0
    except InterruptedRunError as error:
        return _report(error, 1)
    except (KeyboardInterrupt, OSError, MemoryError, RuntimeError) as error:
        reason = "interrupted" if isinstance(error, KeyboardInterrupt) else str(error) or type(error).__name__
        # Only a sweep stores results before all of them are computed.
        again = "resumes with the unfinished cells" if argv[:1] == ["sweep"] else "starts from the beginning"
        return _report(f"{reason}; the same command {again}", 1)


def _run(argv: list[str]) -> int:
    logging.getLogger("matplotlib").setLevel(logging.ERROR)  # it warns where it cannot store its fonts
    parser = _parser()
    if argv[:1] == ["help"] and len(argv) > 1 and argv[1] != "help":
        argv = [argv[1], "--help"]
    if not argv or argv[0] in ("help", "-h", "--help"):
        print(overview(parser.meanings))
        return 0
    if not argv[0].startswith("-") and argv[0] not in parser.meanings:
        meant = nearest(argv[0], parser.meanings)
        remedy = f"did you mean {meant}? See doo-ti help" if meant else "see doo-ti help"
        raise InputError("doo-ti", argv[0], "unknown command", remedy)
    words = _joined(argv)
    try:
        options, unknown = parser.parse_known_args(words)
    except SystemExit as stop:  # --help
        return int(stop.code or 0)
    except InputError as error:
        if error.problem == "missing" and argv[0] in parser.meanings:  # it may only be misspelt
            command = parser.commands[argv[0]]
            names = [word.split("=")[0] for word in words if word.startswith("--")]
            if wrong := next((name for name in names if name not in command._option_string_actions), None):
                raise _unexpected(command, wrong) from None
        raise
    if unknown:
        raise _unexpected(options.parser, next((word for word in unknown if word.startswith("-")), unknown[0]))
    check_architecture()
    options.words = ["doo-ti", *argv]
    try:
        return options.run(options)
    except InputError as error:
        raise options.parser.in_options(error) from None


def _unexpected(command: _Parser, word: str) -> InputError:
    """The error for a ``word`` that the command does not take."""
    kind, name = "unknown option" if word.startswith("-") else "unexpected argument", word.split("=")[0]
    options = [option for action in command._actions for option in action.option_strings if action.help != argparse.SUPPRESS]
    meant = nearest(name, options) if name.startswith("--") else None
    help_line = f"see {command.prog} --help"
    return InputError(command.prog, name, kind, f"did you mean {meant}? S{help_line[1:]}" if meant else help_line)


def _report(problem: object, code: int) -> int:
    # One line whatever the message holds.
    text = " ".join((str(problem) or type(problem).__name__).split())
    print(visible(f"doo-ti: {text.removeprefix('doo-ti:').removeprefix('doo-ti ').lstrip()}"), file=sys.stderr)
    return code


def _joined(argv: list[str]) -> list[str]:
    """``--up -1,0,0`` and ``--up -z`` with an equals sign: argparse takes a value that starts with a minus for an option."""
    words: list[str] = []
    for word in argv:
        if re.match(r"-([\d.]|[xyzXYZ](,|$))", word) and words and re.fullmatch(r"--[\w-]+", words[-1]):
            words[-1] += f"={word}"
        else:
            words.append(word)
    return words


def _parser() -> _Parser:
    parser = _Parser(prog="doo-ti", allow_abbrev=False,
                     description="Fit discrete elastic rods to observed shapes (Javdani et al., ICRA 2011).")
    parser.add_argument("--version", action="version", version=f"doo-ti {__version__}")
    commands = parser.add_subparsers(dest="command", required=True, metavar="COMMAND")
    for module in DECLARING:
        module.declare(commands.add_parser)
    parser.commands = commands.choices
    parser.meanings = {choice.dest: choice.help for choice in commands._choices_actions}
    return parser
