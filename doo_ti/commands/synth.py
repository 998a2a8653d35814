"""Observations to files: from the virtual lab (§V-A), with images of its rods if wanted, and from one format to another."""

from argparse import Namespace
from dataclasses import fields, replace
from pathlib import Path

import numpy as np

from doo_ti.commands import doubts, given, loading, results
from doo_ti.io.observation_files import ambiguous_rods, read_recording, rows_with_marks, save_observations
from doo_ti.io.scene import Scene, Synthesis, load_scene
from doo_ti.io.toml_file import scene_file
from doo_ti.rod.observations import Observations
from doo_ti.rod.start import on_equal_edges
from doo_ti.system.arguments import counted
from doo_ti.system.errors import InputError, require
from doo_ti.system.terminal import in_line, progress
from doo_ti.vision.rig_files import load_rig

DIAMETER_MM = 0.5


def declare(add) -> None:
    parser = given.command(add, "convert", run_convert, "convert observations from one file format to another", json=False)
    parser.add_argument("observations", metavar="IN", help=loading.FORMATS)
    given.add(parser, "out", "OUT", given.output_file, ".npz, .csv or .parquet")
    loading.add_loading(parser)
    given.add(parser, "--select", "FROM:TO[:STEP]|N,N,…", str, "only these observations, numbered from 0 as in the file "
              "(default: all)")
    given.add(parser, "--marks", "FROM:TO[:STEP]", str, "only these marks of each, numbered from 0, or from the end where "
              "negative: 2:-2 leaves out two at either end (default: all)")
    given.add(parser, "--edges", "N", given.whole(2), "the curves through the marks on N equal edges: a finer mesh for relax, "
              "predict, simulate, steer, for instance past thin obstacles")
    parser.add_argument("--complete", action="store_true", help="leave out observations with a missing mark, "
                        "and rods that perceive or track calls ambiguous")
    parser.add_argument("--motion", action="store_true", help="write a recording as one motion, positions_mm and rate_hz, with "
                        "the frames that --select names")
    loading.add_rate(parser)
    parser = given.command(add, "synth", run, "simulate a scene's observations, or render images of its rods (the virtual lab)",
                           json=False)
    parser.set_defaults(up=None, unit=None, columns=None, rest_length=None)  # as the scene says
    parser.add_argument("scene", metavar="SCENE.toml", type=scene_file, help="a scene with [synthesis]")
    given.add(parser, "--out", "OBS", given.output_file, "file for the observations: .npz, .csv or .parquet")
    images = parser.add_argument_group("images", "rendered images of the rods; label noise has no effect on them")
    given.add(images, "--images", "FOLDER", given.folder, "folder for the images, sets.csv, rig.yaml and truth.npz")
    given.add(images, "--rig", "RIG", scene_file, "the cameras: OpenCV FileStorage YAML, such as scenes/rig.yaml")
    given.add(images, "--diameter", "MM", given.LENGTH, f"diameter of the thread (default {DIAMETER_MM:g})")
    given.add(images, "--seed", "N", given.FROM_ZERO, "seed of all random numbers for the images (default 0)")
    images.add_argument("--render", metavar="NAME=VALUE", action="append",
                        help="a property of the images, may be repeated: clutter=3, occluders=2, noise=5, jpeg_quality=none …")


def run_convert(options: Namespace) -> int:
    """Observations from one format to another; keys that observations do not have are dropped."""
    out, edges = options.out, options.edges
    results.refuse_overwriting(out, options.observations, option="OUT")
    if options.motion:
        given.refuse(options, ("edges", "complete", "rest_length"), "given with --motion", "leave one out")
        return _convert_motion(options, out)
    given.refuse(options, ("rate",), "given without --motion", "give both")
    observations = loading.load(options, options.observations, options.complete)
    kept = _selected(options.marks, observations.edges + 1, "--marks")
    if options.marks is not None:
        observations = observations.of_marks(kept)
    if options.complete:  # numbers stay those of the file, where some have no marks
        there = rows_with_marks(options.observations, options.columns)
        rows, unsure = _rows(options.select, len(there)), ambiguous_rods(options.observations, len(there)) & there
        loaded = np.cumsum(there) - 1
        left_out, rows = loaded[rows[unsure[rows]]], loaded[rows[there[rows] & ~unsure[rows]]]
        rows = rows[observations.valid[rows].all(axis=1)]
    else:
        rows, left_out = _rows(options.select, observations.count), []
    require(len(rows), options.observations, "observations", "none is left", "select others, or leave --complete out")
    doubts.warn(observations)
    print(" ".join(loading.rod_line(observations).split()))
    if len(left_out):
        print(f"left out    ambiguous in the images: {', '.join(map(str, observations.labels[left_out]))}")
    observations = observations.take(rows)
    _save(out, observations if edges is None else on_equal_edges(observations, edges))
    return 0


def _save(out: Path, observations: Observations) -> None:
    """Write observations, and print how many."""
    save_observations(out, observations)
    print(f"{counted(observations.count, 'observation')} of {observations.edges + 1} vertices written to {in_line(out)}")


def _convert_motion(options: Namespace, out: Path) -> int:
    """Curves at the frames of a recording, or of several, to positions_mm (T, V, 3) or (R, T, V, 3) and rate_hz."""
    require(out.suffix == ".npz", given.SOURCE, "OUT", f"suffix {out.suffix!r}", "name a .npz file: a motion has a third axis")
    source = Path(options.observations)
    found = read_recording(source, options.unit, options.columns, options.rate)
    up = given.world_up(options, found.up)
    frames = _selected(options.select, found.positions.shape[-3])
    positions = found.positions[..., frames, _selected(options.marks, found.positions.shape[-2], "--marks"), :]
    require(positions.size, source, "positions_mm", "none is left", "select others")
    rate = found.rate / (frames.step or 1)
    names = {} if found.names is None else {"recording": np.array(found.names)}
    results.save_arrays(out, {"positions_mm": positions, "rate_hz": np.float64(rate), "up": up} | names)
    gaps = int((~np.isfinite(positions)).any(axis=-1).sum())
    several = f"{counted(len(positions), 'recording')} of " if positions.ndim == 4 else ""
    print(f"{several}{positions.shape[-3]} frames of {positions.shape[-2]} markers at {rate:g}/s, {gaps} positions missing, "
          f"written to {in_line(out)}; up is {','.join(f'{value:g}' for value in up)}")
    return 0


def _rows(text: str | None, count: int) -> np.ndarray:
    """The numbers, of ``count``, that --select names one by one or as a range."""
    numbers = np.arange(count)
    if text is None or "," not in text:
        return numbers[_selected(text, count)]
    if unknown := [part for part in text.split(",") if part.strip() not in map(str, numbers)]:
        raise InputError(given.SOURCE, "--select", f"{unknown[0]!r} in {text!r}", f"give numbers from 0 to {count - 1}")
    return np.array([int(part) for part in text.split(",")])


def _selected(text: str | None, count: int, option: str = "--select") -> slice:
    """The rows that ``option`` names, of ``count``; a step takes every so many-th."""
    parts = [] if text is None else text.split(":")
    try:
        first, last, step = [int(part) if part else None for part in [*parts, "", "", ""][:3]]
    except ValueError:
        first, last, step = 0, 0, 0
    if text is not None and len(parts) not in (2, 3) or step is not None and step < 1:
        raise InputError(given.SOURCE, option, f"{text!r}", "give FROM:TO or FROM:TO:STEP, whole numbers")
    if last is not None and last > count or first is not None and first >= count > 0:
        raise InputError(given.SOURCE, option, f"{text!r}, there are {count}", f"give numbers from 0 up to {count}")
    return slice(first, last, step)


def run(options: Namespace) -> int:
    if options.out is None and options.images is None:
        raise InputError(given.SOURCE, "--out", "missing", "give --out OBS, or --images FOLDER --rig RIG, or both")
    if options.images is None:
        given.refuse(options, ("rig", "diameter", "seed", "render"), "given without --images",
                     "give --images FOLDER too, or leave it out")
    scene = load_scene(options.scene)
    if options.images is not None:
        _photograph(options, scene)
    if options.out is not None:
        _save(options.out, loading.of_scene(options, scene))
    return 0


def _photograph(options: Namespace, scene: Scene) -> None:
    """Render images; options are checked before the first rod is computed, views before the first image is written."""
    from doo_ti.vision.render import RIG_FILE

    folder, look, seed = options.images, _look(options.render or []), options.seed or 0
    require(options.rig is not None, given.SOURCE, "--rig", "missing", "name the cameras' file, such as scenes/rig.yaml")
    results.refuse_overwriting(folder / RIG_FILE, options.rig, option="--images")
    rig, diameter = load_rig(options.rig), options.diameter or DIAMETER_MM
    require(isinstance(scene.observations, Synthesis), scene.source, "observations",
            "a file, which does not say how the rods lie between their marks", "give a scene with [synthesis]")
    from doo_ti.perception.virtual_lab import lab_rods, save_truth
    from doo_ti.vision.render import Photographs, check_diameter, save_photographs

    check_diameter(diameter, given.SOURCE, "--diameter")
    rods = lab_rods(scene.observations)
    photographs = Photographs(rods.names, rods.curve, rods.point, rods.direction, diameter, rig, look, seed)
    save_truth(folder / "truth.npz", rods, diameter)
    with progress() as bar:
        shown = bar.add_task("photographs", total=len(rods.names), unit="sets")
        save_photographs(folder, photographs, on_set=lambda: bar.advance(shown))
    print(f"{len(rods.names)} sets of {len(rig.cameras)} images of {scene.name} written to {in_line(folder)}, seed {seed}")


def _look(words: list[str]):
    """RenderOptions from words NAME=VALUE."""
    from doo_ti.vision.render import RenderOptions

    look = RenderOptions()
    known = {field.name: getattr(look, field.name) for field in fields(look)}
    changes = {}
    for word in words:
        name, _, text = word.partition("=")
        if name not in known or not text:
            raise InputError(given.SOURCE, "--render", f"{word!r}", f"give NAME=VALUE, NAME one of {', '.join(known)}")
        changes[name] = _value(word, text, known[name], name == "jpeg_quality")
    return replace(look, **changes)


def _value(word: str, text: str, default, may_be_none: bool):
    """A value like its default: a whole number, a number, numbers between commas, or none."""
    if may_be_none and text == "none":
        return None
    try:
        if isinstance(default, tuple):
            return tuple(float(part) for part in text.split(","))
        return int(text) if isinstance(default, int) else float(text)
    except ValueError:
        form = "X,Y,Z" if isinstance(default, tuple) else "a whole number" if isinstance(default, int) else "a number"
        raise InputError(given.SOURCE, "--render", f"{word!r} is no value for it", f"give {form}") from None
