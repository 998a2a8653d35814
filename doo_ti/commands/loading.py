"""Observations of a command: the options that say how a file states them and the lengths between marks, and what was loaded.

    loaded      60 observations of 34 marks; the rod is 99 mm long, its ends 30 to 78 mm apart; up 0,0,1
"""

import os
import re
from argparse import ArgumentParser, Namespace
from dataclasses import replace
from pathlib import Path

import numpy as np

from doo_ti.commands import given
from doo_ti.dynamics.recorded import RecordedMotion
from doo_ti.io.arrays import checked_arrays, decoded, read_npz
from doo_ti.io.observation_files import ambiguous_rods, load_observations
from doo_ti.io.scene import Scene, Synthesis
from doo_ti.rod.grid import parse_axis
from doo_ti.rod.material import NEAR, UNITS_IN_MM, shares_of_rod, weight_per_length
from doo_ti.rod.observations import Observations
from doo_ti.rod.start import observation_clamps, reachable
from doo_ti.rod.types import Clamp, Material, unit_up
from doo_ti.system import terminal
from doo_ti.system.arguments import counted, span_text
from doo_ti.system.errors import InputError, require
from doo_ti.system.files import MOST_TEXT_BYTES, read_content
from doo_ti.system.terminal import in_line

FEW = 0.25  # share of observations that may be left out; of more a file or an option is wrong
MEASURED = 0.02  # relative error of a length between marks that somebody measured
MOST_OFF = 1.5
"""Stated length of the rod over that of arcs through its marks, or the inverse, above which one of both is wrong."""
MOST_STRETCH = 2.0  # distance of a target's vertices over that along the rod, or the inverse: the unit is another one
OF_FILES = ("unit", "columns")  # options that only files of marks have a use for
OF_OBSERVATIONS = (*OF_FILES, "rest_length")  # options that only files of observations have a use for
RECORDINGS = ".npz (positions_mm, rate_hz), .csv of OptiTrack or Vicon, a table"
FORMATS = ".npz, .csv, .parquet; or curves as .csv of OptiTrack or Vicon, .xml (MuJoCo), .usd, .txt"


def add_loading(parser: ArgumentParser, of: str = "OBS") -> None:
    """How the files ``of`` some arguments state the marks, and the direction of gravity."""
    group = parser.add_argument_group("your own files", "docs/observations.md")
    add_files(group, of)
    add_rest_length(group)
    given.add_up(group)


def add_rest_length(group) -> None:
    given.add(group, "--rest-length", "MM|FILE", str, "length of the rod from the first mark to the last, along it; or a .npz "
              "with rest_length_mm, or a text file, of the lengths between the marks (default: as the file states, else arcs "
              "through the marks)")


def add_files(group, of: str) -> None:
    """How the files ``of`` some option or argument state the marks."""
    given.add(group, "--unit", None, tuple(UNITS_IN_MM), f"unit of all lengths in {of} (default: as the file states, else mm)")
    given.add(group, "--columns", "x=NAME,…|A,B,C", _columns, "columns of a table that hold x, y, z, observation, "
              "vertex; of other files, names of markers or curves in their order along the rod")


def add_recordings(parser: ArgumentParser, default_up: str) -> None:
    """How files state recorded motion, and what is done where markers were not seen."""
    group = parser.add_argument_group("your own files", "docs/observations.md")
    add_files(group, "MOTION")
    add_rate(group)
    given.add_up(group, default_up)
    group.add_argument("--fill-gaps", action="store_true",
                       help="take markers that were not seen from lines between the frames around")
    parser.add_argument("--free-end", action="store_true", help="no gripper holds the last edge of a recording")
    given.add(parser, "--smoothing", "FRAMES", _smoothing, "odd number of frames through which parabolas are "
              "fitted for the start and the grippers; 1: as recorded (default: 1, among obstacles those of 0.09 s)")


def _smoothing(option: str, text: str) -> int:
    from doo_ti.dynamics.rollouts import require_smoothing

    frames = given.whole(1, 999)(option, text)
    require_smoothing(given.SOURCE, option, frames)
    return frames


def add_rate(parser) -> None:
    """``--rate`` of a recording."""
    given.add(parser, "--rate", "HZ", given.positive("frames per second"), "frames per second of a recording (default: as the "
              "file states; tables do not)")


def recordings(options: Namespace, sources: list[str]) -> list[RecordedMotion]:
    """The recorded motion of each of the files."""
    return [RecordedMotion.load(path, options.fill_gaps, options.unit, options.columns, options.rate, options.free_end)
            for path in sources]


def _columns(option: str, text: str) -> dict[str, str] | list[str]:
    """Columns by name, or names in order."""
    parts = [part.strip() for part in text.split(",")]
    pairs = [part.partition("=") for part in parts]
    if not all(parts) or len({bool(sign) for _, sign, _ in pairs}) > 1:
        raise InputError(given.SOURCE, option, f"{text!r}", "give NAME=COLUMN,… or names between commas")
    return {name: column for name, _, column in pairs} if pairs[0][1] else parts


def load(options: Namespace, source: str, without_lost: bool = False) -> Observations:
    """The observations of ``source``, all or without those of one mark or none."""
    observations = load_observations(source, options.up, options.unit, options.columns, without_lost)
    if not without_lost and (unsure := np.flatnonzero(ambiguous_rods(source, observations.count))).size:
        terminal.warn(f"{in_line(source)}: {counted(len(unsure), 'rod')}, first {observations.labels[unsure[0]]}: ambiguous in "
                      "the images; leave them out (doo-ti convert --complete)")
    return observations if options.rest_length is None else _measured(observations, options.rest_length)


def _measured(observations: Observations, text: str) -> Observations:
    """``observations`` with the lengths of ``--rest-length``: of a number the marks share the rod as they were."""
    if Path(text).suffix in (".npz", ".txt", ".csv"):
        lengths = read_rest_length(text)
    else:
        lengths = observations.rest_length * (given.LENGTH("--rest-length", text) / observations.rest_length.sum())
    measured, arcs = replace(observations, rest_length=lengths, spacing_error=MEASURED), observations.arcs.sum()
    if not 1 / MOST_OFF < lengths.sum() / arcs < MOST_OFF:
        raise InputError(given.SOURCE, "--rest-length", f"{lengths.sum():.4g} mm, but arcs through the marks are {arcs:.4g} mm "
                         "long", "give the length from the first mark to the last along the rod in mm, and the --unit of the "
                         "marks; those of noisy marks in rest_length_mm of the file")
    return measured


def target(options: Namespace, observations: Observations) -> np.ndarray:
    """(1, V, 3) mm, where ``--target`` says that the vertices shall be; NaN where it asks nothing."""
    path = Path(options.target)
    require(path.suffix == ".npz", path, "file", f"suffix {path.suffix!r}", "name a .npz file with vertices_mm")
    arrays = read_npz(path, read_content(path), ("vertices_mm", "up"))
    require("vertices_mm" in arrays, path, "vertices_mm", "missing", "give (1, V, 3) mm, NaN where nothing is asked")
    places = arrays["vertices_mm"]
    missing = np.isnan(places) if places.dtype.kind == "f" else np.zeros(places.shape, dtype=bool)
    places = checked_arrays(path, {"vertices_mm": np.where(missing, 0, places) if missing.any() else places})["vertices_mm"]
    wanted = (1, observations.edges + 1, 3)
    require(places.shape == wanted, path, "vertices_mm", f"shape {places.shape}", f"give {wanted}, as START has vertices")
    places = np.where(missing, np.nan, places)
    require(np.isfinite(places).all(axis=-1).any(), path, "vertices_mm", "NaN everywhere", "give at least one vertex a place")
    if "up" in arrays and np.abs(unit_up(arrays["up"], str(path)) - observations.up).max() > 1e-6:
        raise InputError(path, "up", f"{_up_text(arrays['up'])}, but START has {_up_text(observations.up)}",
                         "give both in the same axes")
    places = places if options.unit is None else places * UNITS_IN_MM[options.unit]
    share, edges = shares_of_rod(places, observations.rest_length)
    if len(share) and not (1 / MOST_STRETCH if (edges == 1).all() else NEAR) <= np.median(share) <= MOST_STRETCH:
        raise InputError(path, "vertices_mm", f"they are {np.median(share):.3g} times as far apart as along the rod",
                         "check the unit, as --unit m")
    return places


def of_scene(options: Namespace, scene: Scene) -> Observations:
    """A scene's observations, loaded or synthesised, under the scene's name."""
    if not isinstance(scene.observations, Synthesis):
        return replace(load(options, scene.observations), name=scene.name)
    from doo_ti.lab.synthesis import synthesise

    given.refuse(options, OF_OBSERVATIONS, "given, but the scene is simulated", "leave it out")
    observations = synthesise(scene.observations)
    up = observations.up if options.up is None else options.up
    return replace(observations, name=scene.name, sha256=scene.sha256, up=up)


def with_ends_in_reach(observations: Observations, start: Clamp | None, end: Clamp | None, whole_edges: bool = True
                       ) -> Observations:
    """``observations`` without the few whose ends are further apart than the rod is long, of which a warning is printed: marks
    in reverse order, or two that are swapped, do that. All where these are more than :data:`FEW`. ``whole_edges`` as in
    :func:`doo_ti.rod.start.reachable`."""
    clamps = observation_clamps(observations, start, end)
    within = reachable(observations, clamps, whole_edges)
    if within.all() or (~within).sum() > FEW * len(within):
        return observations
    backwards = replace(observations, vertices=observations.vertices[:, ::-1], valid=observations.valid[:, ::-1],
                        rest_length=observations.rest_length[::-1])
    turned = reachable(backwards, observation_clamps(backwards, start, end), whole_edges)
    by_frames = reachable(observations, clamps, whole_edges=False)
    for row in np.flatnonzero(~within):
        why = "its ends are further apart than the rod is long"
        if by_frames[row]:
            why = "its frames hold the whole outer edges, between which the rod is too short"
        if turned[row]:
            why += "; its marks are in reverse order"
        terminal.warn(f"{in_line(observations.source)}: observation {observations.labels[row]} is left out: {why}")
    return observations.take(np.flatnonzero(within))


def stated(options: Namespace) -> dict[str, float | None]:
    """The ``weight`` in N/m and ``stiffness`` EI in N m², of a range the least, that options state."""
    density, stiff = options.linear_density, options.EI
    return {"weight": None if density is None else weight_per_length(density),
            "stiffness": None if stiff is None else parse_axis("--EI", stiff, given.SOURCE).values[0]}


def stated_in_scene(material: Material, newtons: np.ndarray | None) -> dict[str, np.ndarray]:
    """The same of the materials (G) of a scene whose unit of force is ``newtons`` (G,) N."""
    return {} if newtons is None else {"weight": 2e3 * material.weight * newtons,
                                       "stiffness": 1e-6 * material.bend[:, 0].max(axis=(1, 2)) * newtons}


def up_text(other: dict | None) -> str | None:
    """That another axis fits far better than the given direction, ``other_up`` of a summary, as text."""
    from doo_ti.learning.up_axes import OtherUp

    return None if other is None else OtherUp(**other).text


def rod_line(observations: Observations) -> str:
    """What was loaded, as a line of text."""
    seen = observations.valid[:, [0, -1]].all(axis=1)
    ends = np.linalg.norm(observations.vertices[:, -1] - observations.vertices[:, 0], axis=-1)[seen]
    missing = int((~observations.valid).sum())
    span = "" if not len(ends) else f", its ends {span_text(ends, 'mm')} apart"
    return (f"  loaded      {counted(observations.count, 'observation')} of {observations.edges + 1} marks"
            f"{f' ({missing} missing)' if missing else ''}; the rod is {observations.rest_length.sum():.4g} mm long{span}; "
            f"up {_up_text(observations.up)}")


def _up_text(up: np.ndarray) -> str:
    return ",".join(f"{value + 0:.3g}" for value in up)


MOST_EDGES = 2000
LEAST_MM, MOST_MM = 1e-3, 1e4  # of an edge


def read_rest_length(text: str) -> np.ndarray:
    """(E,) mm, from ``3:33`` or a file."""
    option, remedy = "--rest-length", "give MM:COUNT, such as 3:33, a file of lengths in mm, or the whole as --length"
    length, _, count = text.partition(":")
    if count and not os.path.exists(text):
        edges, each = given.whole(2, MOST_EDGES)(option, count), given.LENGTH(option, length)
        if not LEAST_MM <= each <= MOST_MM:
            raise InputError(given.SOURCE, option, f"edges of {each:g} mm", f"give {LEAST_MM:g} to {MOST_MM:g} mm")
        return np.full(edges, each)
    path = Path(text)
    try:
        content = read_content(path, MOST_TEXT_BYTES, remedy)
    except InputError as error:
        raise InputError(given.SOURCE, option, f"{text!r}: {error.problem}", remedy) from None
    try:
        values = read_npz(path, content, ("rest_length_mm",)).get("rest_length_mm") if path.suffix == ".npz" else \
            np.array(_words(path, decoded(content)), dtype=np.float64)
    except ValueError as error:
        if isinstance(error, InputError):
            raise
        raise InputError(path, "file", "holds something that is not a number", remedy) from None
    if values is None or values.dtype.kind not in "fiu" or values.ndim != 1 or not 2 <= len(values) <= MOST_EDGES \
            or not ((values >= LEAST_MM) & (values <= MOST_MM)).all():
        raise InputError(path, "rest_length_mm", f"missing, or not 2 or more numbers from {LEAST_MM:g} to {MOST_MM:g}",
                         "give one for each edge, in mm")
    return values.astype(np.float64)


def _words(path: Path, text: str) -> list[str]:
    """The numbers of a text, between commas, semicolons or spaces. Raises InputError where commas may also be in them."""
    words = text.replace(";", " ").split()
    if len(words) > 1 and all(re.fullmatch(r"\d+,\d+", word) for word in words):
        raise InputError(path, "rest_length_mm", f"{words[0]!r} is one number, or two", "write decimals behind a point, and "
                         "numbers between spaces")
    return " ".join(words).replace(",", " ").split()
