"""Options of the command line: those that several commands share, and each option's text to a value, checked before any work.

Raises InputError naming the option, its value and the remedy.
"""

import os
from argparse import SUPPRESS, Action, ArgumentParser, Namespace, RawDescriptionHelpFormatter
from collections.abc import Callable, Iterable
from functools import partial
from pathlib import Path

import numpy as np

import doo_ti
from doo_ti.commands.help_text import FIRST, examples
from doo_ti.contact.obstacle_file import load_obstacles
from doo_ti.contact.surroundings import Surroundings
from doo_ti.io.arrays import number_in
from doo_ti.io.observation_files import checked_suffix
from doo_ti.io.scene import CLAMPS, PRECISIONS
from doo_ti.rod.grid import UNITS, Axis, Grid, parse_axes, parse_axis
from doo_ti.rod.material import bend_or_twist, force_in_newton, weight_per_length
from doo_ti.rod.types import LARGEST, Clamp, unit_up
from doo_ti.system.errors import InputError, require
from doo_ti.system.terminal import INSTALL_RECORDER, has_recorder

SOURCE = "command line"
MATERIAL = ("bend", "bend_1", "bend_2", "twist", "twist_ratio", "weight", "EI", "GJ")  # the options that state Θ
STIFFNESS_ONLY = "bend and twist stiffness are used; rest curvature, damping, drag and markers are ignored"
SHAPE_ONLY = "bend, twist and rest curvature are used; damping, drag and markers are ignored"
EVERYTHING = "bend, twist, rest curvature, damping, drag and markers are used"
CLAMP_DEFAULT = "frame where the file gives one, else tangent"
LONGEST_NAME = 200  # bytes in the name of a file: systems allow 255, and while the file is written it has a longer name


class _HelpAll(Action):
    def __call__(self, parser, namespace, values, option_string=None):
        parser.whole = True
        parser.print_help()
        parser.exit()


# --- declaring -----------------------------------------------------------------------------------------------------------


def command(add, name: str, run: Callable[[Namespace], int], meaning: str, *, json: bool = True) -> ArgumentParser:
    """The parser of a command, which ``run`` carries out; with ``--json`` unless it prints nothing for machines."""
    parser = add(name, allow_abbrev=False, help=meaning, description=f"{meaning[0].upper()}{meaning[1:]}.",
                 epilog=examples(name), formatter_class=RawDescriptionHelpFormatter)
    parser.add_argument("--help-all", action=_HelpAll, nargs=0, help="show all options" if name in FIRST else SUPPRESS)
    if json:
        parser.add_argument("--json", action="store_true", help="print one line of JSON instead of text")
    parser.set_defaults(run=run, parser=parser)
    return parser


def add_old_name(parser: ArgumentParser, old: str, argument: str) -> None:
    """Accept the ``old`` name of the option for ``argument``, without showing it."""
    kind = next(action.type for action in parser._actions if action.dest == argument)
    parser.add_argument(old, dest=argument, type=kind, default=SUPPRESS, help=SUPPRESS)


def add_material(parser: ArgumentParser, form: str, theta: str = STIFFNESS_ONLY, density: str = "for --EI and --GJ",
                 round_rod: bool = False) -> None:
    """``theta`` says what the command uses of ``--theta`` and what it ignores, ``density`` what it needs --linear-density for;
    with ``round_rod`` it takes rods only that are the same in all directions across them."""
    parser.set_defaults(theta_note=theta)
    group = parser.add_argument_group("material", form)
    others = "" if round_rod else " of a round rod, or the matrix of another one, A1,A2[,A12]"
    add(group, "--EI", "NM2", str, "bend stiffness of a round rod in N m²; needs --linear-density")
    add(group, "--GJ", "NM2", str, "twist stiffness in N m²; needs --linear-density")
    add(group, "--linear-density", "G_PER_M", positive("g/m"), f"mass per length of the rod in g/m, {density}")
    add(group, "--bend", "A", str, f"instead of --EI, bend stiffness α in mm³{others}")
    if round_rod:
        parser.set_defaults(bend_1=None, bend_2=None)
    else:
        add(group, "--bend-1", "A1", str, "stiffness against bending about m2")
        add(group, "--bend-2", "A2", str, "stiffness against bending about m1")
    add(group, "--twist", "B", str, "instead of --GJ, twist stiffness β in mm³")
    add(group, "--twist-ratio", "R", str, f"β divided by α{'' if round_rod else ', or by A1'} (default 1)")
    add(group, "--weight", "M", str, "half the weight per length, relative (default 1)")
    add(group, "--theta", "THETA.json", str, f"the rod as doo-ti identify wrote it: {theta}")


def add_clamps(parser: ArgumentParser, default: str = CLAMP_DEFAULT) -> None:
    for end in ("start", "end"):
        parser.add_argument(f"--clamp-{end}", choices=CLAMPS, help=f"constraint of the rod's {end} (default: {default})")


def add_up(parser: ArgumentParser, default: str = "the file's, else 0,0,1") -> None:
    add(parser, "--up", "X,Y,Z|AXIS", direction, "direction against gravity: three numbers, or x, y, z, -x, -y or "
        f"-z (default: {default})")


def add_frame_weight(parser: ArgumentParser, default: str) -> None:
    add(parser, "--frame-weight", "MM", FRAME_WEIGHT, f"weight w_m of material frames in Eq. 1 (default: {default})")


def add_relaxation(parser: ArgumentParser, precision: str | None) -> None:
    add_clamps(parser)
    add_frame_weight(parser, "0" if precision else "the scene's, else 0")
    add(parser, "--solver", None, ("newton", "descent"), "newton, or the paper's gradient descent", "newton")
    stated = precision or "the scene's, else mixed"
    parser.add_argument("--precision", choices=PRECISIONS, default=precision,
                        help=f"floating-point arithmetic (default: {stated})")


def add(parser, option: str, metavar: str | None, kind: Callable | tuple, meaning: str, default=None, **more) -> None:
    """An option with a value of that ``kind``, the ``type`` of argparse, or one of several words; its ``default`` is stated."""
    stated = "" if default is None else f" (default {default if isinstance(default, str) else f'{default:g}'})"
    taken = {"choices": kind} if isinstance(kind, tuple) else {"metavar": metavar, "type": kind}
    parser.add_argument(option, help=meaning + stated, default=default, **taken, **more)


def add_file(parser, option: str, metavar: str, meaning: str, **more) -> None:
    """An option of a file to write, whose suffix is one of those in ``metavar``."""
    suffixes = tuple(f".{name.rpartition('.')[2]}" for name in metavar.split("|"))
    parser.add_argument(option, metavar=metavar, type=partial(output_file, suffixes=suffixes), help=meaning, **more)


def add_out(parser: ArgumentParser, metavar: str, meaning: str = "file to write") -> None:
    add_file(parser, "--out", metavar, meaning, required=True)


def add_obstacles(parser: ArgumentParser, friction: str) -> None:
    """``friction`` says what the command makes of the friction of obstacles."""
    group = parser.add_argument_group("contact", f"obstacles that rods touch but do not enter (docs/obstacles.md); {friction}")
    add(group, "--obstacles", "FILE.toml", str, "[[obstacles]], each a plane, sphere, capsule, cylinder, ring, box, grid or "
        "the rod itself; in mm")
    add(group, "--radius", "MM", LENGTH, "radius of the rods, needed with --obstacles")


# --- reading -------------------------------------------------------------------------------------------------------------


def grid(options: Namespace, base: Grid | None = None) -> Grid:
    """The axes given, on top of those of ``base`` (a scene's grid) where there is one."""
    texts = {name: getattr(options, name) for name in UNITS if getattr(options, name) is not None}
    if (found := theta(options)) is not None:
        refuse(options, MATERIAL, "given beside --theta", "give one of the two")
        texts |= {"bend": repr(found.bend), "twist": repr(found.bend * found.twist_ratio)}
    axes, bend_12 = parse_axes(texts, SOURCE, "--")
    for physical, name, others in (("EI", "bend", ("bend", "bend_1", "bend_2", "weight")),
                                   ("GJ", "twist", ("twist", "twist_ratio", "weight"))):
        text = getattr(options, physical)
        if text is None:
            continue
        refuse(options, others, f"given beside --{physical}", "give one of the two")
        require(options.linear_density is not None, SOURCE, "--linear-density", f"missing beside --{physical}",
                "give the rod's in g/m")
        axis = parse_axis(f"--{physical}", text, SOURCE)  # in N m²: relative to a weight of 1
        axes.append(Axis(name, bend_or_twist(axis.values, weight_per_length(options.linear_density)), axis.log))
    if base is not None:
        return base.with_axes(tuple(axes), bend_12)
    if not any(axis.name in ("bend", "bend_1", "bend_2") for axis in axes):
        raise InputError(SOURCE, "--EI", "missing", "give --EI and --linear-density, or --bend, or --bend-1 and --bend-2")
    return Grid(tuple(axes), bend_12, SOURCE)


def theta(options: Namespace):
    """The MotionTheta of ``--theta``, or None."""
    if options.theta is None:
        return None
    return doo_ti.load_theta(options.theta)


def newtons(options: Namespace, weight) -> np.ndarray | None:
    """N in the unit of force of rods of ``weight`` (G,), by ``--linear-density``; None without it."""
    if options.linear_density is None or not np.all(np.asarray(weight) > 0):
        return None
    return force_in_newton(1.0, weight_per_length(options.linear_density), weight)


def single_cell(options: Namespace, remedy: str = "give one number") -> Grid:
    """The axes given, as :func:`grid` reads them. Raises InputError, with that remedy, where they are more than one Θ."""
    found = grid(options)
    if found.size > 1:
        name = found.varying[0].name
        physical = {"bend": "EI", "twist": "GJ"}.get(name)
        option = physical if physical and getattr(options, physical) is not None else name.replace("_", "-")
        raise InputError(SOURCE, f"--{option}", f"a grid of {found.size} cells", remedy)
    return found


def round_cell(options: Namespace, rods: str) -> Grid:
    """One Θ that is the same in all directions across the rod; ``rods`` says which rods must be so."""
    found = single_cell(options)
    require(found.is_isotropic, SOURCE, "--bend", "not the same in all directions", f"give --bend A: {rods} rods are round")
    return found


def world_up(options: Namespace, otherwise: np.ndarray | None = None) -> np.ndarray:
    """(3,) unit vector against gravity; without ``--up`` the one of a file, ``otherwise``, else z."""
    return next((found for found in (options.up, otherwise) if found is not None), np.array([0.0, 0.0, 1.0]))


def clamps(options: Namespace, otherwise: tuple[Clamp | None, ...] = (None, None)) -> tuple[Clamp | None, Clamp | None]:
    """The kinds of clamps at the start and at the end; what the options leave out is as in ``otherwise``."""
    names = options.clamp_start, options.clamp_end
    return tuple(own if name is None else Clamp[name.upper()] for name, own in zip(names, otherwise, strict=True))


def surroundings(options: Namespace) -> Surroundings:
    """What ``--obstacles`` and ``--radius`` give."""
    if options.obstacles is None:
        refuse(options, ("radius",), "given without --obstacles", "give both, or neither")
        return Surroundings()
    require(options.radius is not None, SOURCE, "--radius", "missing beside --obstacles", "give the radius of the rods in mm")
    if getattr(options, "solver", "newton") != "newton":
        raise InputError(SOURCE, "--solver", f"{options.solver} given beside --obstacles", "leave it out")
    return Surroundings(load_obstacles(options.obstacles), options.radius)


def scene_surroundings(options: Namespace, found: Surroundings) -> Surroundings:
    """Those of a scene, or of the options where the scene has none."""
    given = surroundings(options)
    refuse(options, ("obstacles",) if found else (), "given, but the scene has its own", "leave it out")
    return given or found


def refuse(options: Namespace, names: Iterable[str], problem: str, remedy: str) -> None:
    """Raise InputError, with that problem and remedy, for the first of the options ``names`` that is given."""
    for name in names:
        if (value := getattr(options, name, None)) is not None and value is not False:
            raise InputError(SOURCE, f"--{name.replace('_', '-')}", problem, remedy)


def require_recorder(name: str) -> None:
    """Raise InputError where rerun is missing, which the option or command ``name`` needs."""
    require(has_recorder(), SOURCE, name, "rerun is not installed", INSTALL_RECORDER)


# --- the texts of options ------------------------------------------------------------------------------------------------

Reader = Callable[[str, str], object]
"""The ``type`` of an option: makes a value of its text; it is given the option's name first, for what it refuses."""


def whole(minimum: int, most: int | None = None) -> Reader:
    """A whole number from ``minimum`` up, to ``most`` where that is given."""
    def read(option: str, text: str) -> int:
        value = number_in(text)
        if not np.isfinite(value) or value != round(value):
            raise InputError(SOURCE, option, f"{text!r} is not a whole number", f"give {minimum} or more")
        if value < minimum or most is not None and value > most:
            problem = f"{value:.0f} is {f'below {minimum}' if value < minimum else f'above {most}'}"
            raise InputError(SOURCE, option, problem, f"give {minimum} {'or more' if most is None else f'to {most}'}")
        return int(value)
    return read


def number(wanted: str, fits: Callable[[float], bool] = lambda value: True) -> Reader:
    """A finite number that ``fits``."""
    def read(option: str, text: str) -> float:
        value = number_in(text)
        require(np.isfinite(value) and fits(value), SOURCE, option, f"{text!r} is not {wanted}", f"give {wanted}")
        return value
    return read


def positive(unit: str = "") -> Reader:
    return number(f"a positive number{' of ' * bool(unit)}{unit}", lambda value: 0 < value)


def not_negative(unit: str = "") -> Reader:
    return number(f"a number{' of ' * bool(unit)}{unit} from zero up", lambda value: 0 <= value)


def numbers(form: str | None = None, each: Reader = number("a number, between commas")) -> Reader:
    """``30,54,78``: numbers between commas, as many as in the ``form``, such as X,Y,Z, where there is one."""
    def read(option: str, text: str) -> tuple[float, ...]:
        found = tuple(each(option, part) for part in text.split(","))
        require(form is None or len(found) == form.count(",") + 1, SOURCE, option, f"{len(found)} numbers", f"give {form}")
        return found
    return read


def rows(option: str, text: str | None, count: int) -> tuple[int, ...]:
    """``0,3,7``: different row numbers below ``count`` between commas; none without text."""
    found = () if text is None else tuple(whole(0, count - 1)(option, part) for part in text.split(","))
    require(len(set(found)) >= len(found), SOURCE, option, f"{text!r} names a row twice", "name each once")
    return found


def either(words: dict[str, object], otherwise: Reader) -> Reader:
    """What one of the ``words`` stands for, or what ``otherwise`` reads."""
    return lambda option, text: words[text] if text in words else otherwise(option, text)


def direction(option: str, text: str) -> np.ndarray:
    """(3,) unit vector of ``-y`` or ``0,-1,0``."""
    axis = text.lower().lstrip("+-")
    if axis in tuple("xyz"):
        return np.where(np.array(tuple("xyz")) == axis, -1.0 if text.startswith("-") else 1.0, 0.0)
    try:
        return unit_up(NUMBERS(option, text), SOURCE)
    except InputError as error:
        raise InputError(SOURCE, option, error.problem, "give a direction: x, y, z, -x, -y, -z, or three numbers") from None


def output_file(option: str, text: str | Path, suffixes: tuple[str, ...] = ()) -> Path:
    """The file to write, with one of these suffixes, or without any with that of a format of observations."""
    path = Path(text)
    if not suffixes:
        checked_suffix(path)
    elif path.suffix not in suffixes:
        raise InputError(SOURCE, option, f"suffix {path.suffix!r} of {path}",
                         f"name a file that ends in {' or '.join(suffixes)}")
    if option == "--recording":
        require_recorder(option)
    require(not os.path.isdir(path), SOURCE, option, f"{path} is a folder", "name a file")
    if len(os.fsencode(path.name)) > LONGEST_NAME:
        raise InputError(SOURCE, option, f"{path.name[:20]}… is too long a name", f"name a file in {LONGEST_NAME} bytes")
    _check_folder(path.parent, option)
    return path


def folder(option: str, text: str) -> Path:
    """The folder to write, which need not exist yet."""
    require(text.strip(), SOURCE, option, f"{text!r} is not a folder", "name one, such as . for the current one")
    _check_folder(Path(text), option)
    return Path(text)


def _check_folder(folder: Path, option: str) -> None:
    """Raise InputError unless files can be written in ``folder``, which may not exist yet."""
    existing = next(path for path in (folder, *folder.absolute().parents) if os.path.lexists(path))
    require(os.path.isdir(existing), SOURCE, option, f"{existing} is a file, not a folder", "name another folder")
    require(os.access(existing, os.W_OK | os.X_OK), SOURCE, option, f"{existing} is not writable", "name another folder")


LENGTH, COUNT, FROM_ZERO, NUMBERS = positive("mm"), whole(1), whole(0), numbers()
FRAME_WEIGHT = number(f"a number of mm from zero up to {LARGEST:g}", lambda weight: 0 <= weight <= LARGEST)
"""Those that several commands take."""
