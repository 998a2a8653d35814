"""Options of the command line, from text to values, each checked before any work starts.

Raises InputError naming the option, what was given and what would do.
"""

import os
from argparse import Namespace
from pathlib import Path

import numpy as np

from doo_ti.errors import InputError
from doo_ti.grid import UNITS, Axis, Grid, parse_axis, parse_bend
from doo_ti.io.observations import checked_suffix
from doo_ti.physical_units import bend_or_twist, weight_per_length
from doo_ti.types import LARGEST, Clamp

SOURCE = "command line"
MOST_BENCH_RODS = 1 << 22
"""Four times as many are relaxed at once to see what memory they need: some 20 GB."""
LONGEST_NAME = 200
"""Bytes of the name of a file: the system takes 255, and while it is written it has a longer one."""


def grid(options: Namespace, base: Grid | None = None) -> Grid:
    """The axes given, on top of those of ``base`` (a scene's grid) where there is one."""
    axes: list[Axis] = []
    bend_12 = 0.0
    for name in UNITS:
        text = getattr(options, name)
        if text is None:
            continue
        if name == "bend":
            found, bend_12 = parse_bend(text, "--bend", SOURCE)
            axes += found
        else:
            axes.append(parse_axis(f"--{name.replace('_', '-')}", text, SOURCE))
    axes += _physical_axes(options)
    if base is not None:
        return base.with_axes(tuple(axes), bend_12)
    if not any(axis.name in ("bend", "bend_1", "bend_2") for axis in axes):
        raise InputError(SOURCE, "--bend", "missing", "give --bend, or --bend-1 and --bend-2")
    return Grid(tuple(axes), bend_12, SOURCE)


def _physical_axes(options: Namespace) -> list[Axis]:
    """The axes that ``--EI`` and ``--GJ`` give in N m², as bend and twist relative to a weight of 1."""
    axes = []
    for physical, name, others in (("EI", "bend", ("bend", "bend_1", "bend_2", "weight")),
                                   ("GJ", "twist", ("twist", "twist_ratio", "weight"))):
        text = getattr(options, physical)
        if text is None:
            continue
        for other in others:
            if getattr(options, other) is not None:
                option = f"--{other.replace('_', '-')}"
                raise InputError(SOURCE, f"--{physical}", f"given beside {option}", f"give one of --{physical} and {option}")
        density = positive("--linear-density", options.linear_density, "g/m")
        if density is None:
            raise InputError(SOURCE, "--linear-density", f"missing beside --{physical}", "give the rod's in g/m")
        axis = parse_axis(f"--{physical}", text, SOURCE)
        axes.append(Axis(name, bend_or_twist(axis.values, weight_per_length(density)), axis.log))
    return axes


def single_cell(options: Namespace, remedy: str = "give one number") -> Grid:
    """The axes given, as :func:`grid` reads them. Raises InputError, with that remedy, where they are more than one Θ."""
    found = grid(options)
    if found.size > 1:
        option = f"--{found.varying[0].name.replace('_', '-')}"
        raise InputError(SOURCE, option, f"a grid of {found.size} cells", remedy)
    return found


def round_cell(options: Namespace, rods: str) -> Grid:
    """One Θ that is the same in all directions across the rod; ``rods`` says of which rods that is asked."""
    found = single_cell(options)
    if not found.is_isotropic:
        raise InputError(SOURCE, "--bend", "not the same in all directions", f"give --bend A: {rods} rods are round")
    return found


def frame_weight(options: Namespace, default: float = 0.0) -> float:
    """w_m of Eq. 1, mm."""
    if options.frame_weight is None:
        return default
    wanted = f"zero or a positive number of mm up to {LARGEST:g}"
    value = _decimal("--frame-weight", options.frame_weight, wanted, minimum=0.0)
    if value > LARGEST:
        raise InputError(SOURCE, "--frame-weight", f"{value:g} is out of range", f"give {wanted}")
    return value


def up(options: Namespace) -> np.ndarray | None:
    """(3,) direction against gravity, or None."""
    if options.up is None:
        return None
    direction = np.array([_decimal("--up", part, "three numbers X,Y,Z") for part in options.up.split(",")])
    if direction.shape != (3,) or not (np.abs(direction) <= LARGEST).all() or not np.linalg.norm(direction) > 0:
        raise InputError(SOURCE, "--up", f"{options.up!r} is no direction", "give X,Y,Z, such as 0,0,1")
    return direction


def world_up(options: Namespace) -> np.ndarray:
    """(3,) unit vector against gravity, by default z."""
    direction = up(options)
    return np.array([0.0, 0.0, 1.0]) if direction is None else direction / np.linalg.norm(direction)


def clamp(name: str | None) -> Clamp | None:
    return None if name is None else Clamp[name.upper()]


def solver(name: str):
    """Newton() or Descent()."""
    from doo_ti.relaxation.relax import Descent, Newton

    return {"newton": Newton, "descent": Descent}[name]()


def whole(option: str, text: str | None, minimum: int, most: int | None = None) -> int | None:
    """A whole number from ``minimum`` up, to ``most`` where that is given, or None."""
    if text is None:
        return None
    try:
        value = int(text)
    except ValueError:
        raise InputError(SOURCE, option, f"{text!r} is not a whole number", f"give {minimum} or more") from None
    if value < minimum:
        raise InputError(SOURCE, option, f"{value} is below {minimum}", f"give {minimum} or more")
    if most is not None and value > most:
        raise InputError(SOURCE, option, f"{value} is above {most}", f"give {most} or less")
    return value


def positive(option: str, text: str | None, unit: str = "") -> float | None:
    """A positive number, or None."""
    if text is None:
        return None
    wanted = f"a positive number{' of ' * bool(unit)}{unit}"
    value = _decimal(option, text, wanted, minimum=0.0)
    if value == 0:
        raise InputError(SOURCE, option, f"{text!r} is not positive", f"give {wanted}")
    return value


def length(option: str, text: str | None) -> float | None:
    """A positive number of mm, or None."""
    return positive(option, text, "mm")


def numbers(option: str, text: str | None) -> tuple[float, ...]:
    """``30,54,78``: numbers between commas; none without text."""
    return () if text is None else tuple(_decimal(option, part, "numbers between commas") for part in text.split(","))


def rows(option: str, text: str | None, count: int) -> tuple[int, ...]:
    """``0,3,7``: different row numbers below ``count`` between commas; none without text."""
    found = () if text is None else tuple(whole(option, part, 0, count - 1) for part in text.split(","))
    if len(set(found)) < len(found):
        raise InputError(SOURCE, option, f"{text!r} names a row twice", "name each once")
    return found


def bench_rods(text: str | None, default: int) -> int:
    """Rods in the large batches of the benchmark."""
    return whole("--rods", text, 1, MOST_BENCH_RODS) or default


def threads(text: str | None) -> int | None:
    """Threads of the kernels, at most one per processor, or None."""
    return whole("--threads", text, 1, os.cpu_count() or 1)


def output_file(text: str | Path, suffix: str | None = None, option: str = "--out") -> Path:
    """The file to write: of the format ``suffix``, or of observations, where a file can lie."""
    path = Path(text)
    if suffix is None:
        checked_suffix(path)
    elif path.suffix != suffix:
        raise InputError(SOURCE, option, f"suffix {path.suffix!r} of {path}", f"name a file that ends in {suffix}")
    if path.is_dir():
        raise InputError(SOURCE, option, f"{path} is a folder", "name a file")
    if len(os.fsencode(path.name)) > LONGEST_NAME:
        raise InputError(SOURCE, option, f"{path.name[:20]}… is too long a name", f"name a file in {LONGEST_NAME} bytes")
    _check_folder(path.parent, option)
    return path


def refuse_overwriting(out: Path, source: str, option: str = "--out") -> None:
    """Raise InputError where the file to write is the one that is read."""
    if out.exists() and Path(source).exists() and out.samefile(source):
        raise InputError(SOURCE, option, f"{out} is the input itself", "name another file")


def output_folder(text: str, option: str = "--out") -> Path:
    """The folder to write, which need not exist yet."""
    if not text.strip():
        raise InputError(SOURCE, option, f"{text!r} names no folder", "name one; . is the present one")
    _check_folder(Path(text), option)
    return Path(text)


def _decimal(option: str, text: str, wanted: str, minimum: float = -np.inf) -> float:
    try:
        value = float(text)
    except ValueError:
        raise InputError(SOURCE, option, f"{text!r} is not a number", f"give {wanted}") from None
    if not (np.isfinite(value) and value >= minimum):
        raise InputError(SOURCE, option, f"{text!r} is out of range", f"give {wanted}")
    return value


def _check_folder(folder: Path, option: str = "--out") -> None:
    """Raise InputError unless ``folder`` is one that can be written in, or can be made."""
    existing = next(path for path in (folder, *folder.absolute().parents) if os.path.lexists(path))
    if not existing.is_dir():
        raise InputError(SOURCE, option, f"{existing} is a file, nothing can lie below it", "name another folder")
    if not os.access(existing, os.W_OK | os.X_OK):
        raise InputError(SOURCE, option, f"{existing} is not writable", "name another folder")
