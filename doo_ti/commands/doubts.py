"""What makes an input implausible, as warnings: units, the order of marks, lengths, the mesh."""

from argparse import Namespace

import numpy as np
from numpy.typing import ArrayLike

from doo_ti.contact.surroundings import Surroundings
from doo_ti.rod.frames import unit_vectors
from doo_ti.rod.material import density_doubt, likely_unit, stiffness_doubt
from doo_ti.rod.observations import Observations
from doo_ti.system import terminal
from doo_ti.system.arguments import counted
from doo_ti.system.terminal import in_line
from doo_ti.vision.cameras import Rig

DOUBTFUL = 1.05
"""Stated length of the rod over that of arcs through its marks, or the inverse; arcs are off by up to 2 % on rods of ten marks
or more."""
MOST_TURN = 60.0  # degrees at the median mark, of the line through the marks: they are on no curve in their order
MOST_UNEVEN = 20.0  # longest edge over the median one, above which the marks may be of several rods
MOST_APART, TOO_FAR = 1.8, 0.01
"""Distance of neighbouring marks over the length between them, and by how much of the rod's length they are farther apart: more
of both is no noise but a wrong mark."""
BOTH_AGREE = 1.7  # sum of the cosines between the frames of both ends and the edges there: 32° if both are off alike
EXCHANGED, SHORTER = 0.8, 0.7
"""Least share of the observations in which the line through the marks is shorter with two of them exchanged, and the most that
its length beside these two then is, over that before."""
TOO_LONG = 1.2  # length of the line beside two marks over the longest in other observations: 0 of 1100 in order, soft ropes too
FAR_OFF = 0.03  # of the rod's length, from its marks on average: more is no error of measurement
MOST_LOOKED_AT, MOST_PAIRS = 30, 4_000_000  # observations, and pairs of marks in all of them
MOST_NAMED = 5
ALIKE = 0.5  # of the distance that noise gives to two observations of one pose: they share errors


def warn(observations: Observations, surroundings: Surroundings | None = None, **material) -> None:
    """Print a warning where the rod is implausible, or too coarse for what is around it; ``material`` as
    :func:`doo_ti.commands.loading.stated`. To be called once everything is checked, so that wrong input is reported in one
    line."""
    say(observations.source, order_doubt(observations) or apart_doubt(observations), reverse_doubt(observations),
        length_doubt(observations), inside_doubt(observations, surroundings))
    warn_of_rod(observations.source, observations.rest_length, surroundings, **material)


def warn_of_rod(source, rest_length: np.ndarray, surroundings: Surroundings | None, weight: ArrayLike | None = None,
                stiffness: ArrayLike | None = None) -> None:
    """The same of a rod of ``source`` with edges of ``rest_length`` (E,)."""
    length = float(rest_length.sum())
    say(source, unit_doubt(length), mesh_doubt(rest_length, surroundings), density_doubt(length, weight),
        stiffness_doubt(stiffness, weight))


def warn_of_turns(observations: Observations, index: np.ndarray, turns: np.ndarray) -> None:
    """Print a warning where rods (N,) of the observations ``index`` (N,) are taken to be twisted by whole ``turns`` (N,) that
    their frames do not show."""
    twisted = np.unique(index[turns != 0])
    if len(twisted):
        say(observations.source, f"{counted(len(twisted), 'observation')}, first {observations.labels[twisted[0]]}: taken to "
            "be twisted by a turn more than the frames show, since the marks are twice as near then; give total_twist_deg")


def warn_of_distance(observations: Observations, distance: np.ndarray) -> None:
    """Print a warning where the ``distance`` (R,) mm of rods at rest from their marks (Eq. 1) is more than :data:`FAR_OFF` of
    their length. The rods are those of the observations, once for each of several materials."""
    length = observations.rest_length.sum()
    worst = int(np.argmax(np.nan_to_num(distance)))
    if distance[worst] > FAR_OFF * length:
        say(observations.source, f"at rest the rod of observation {observations.labels[worst % observations.count]} is "
            f"{distance[worst]:.3g} mm from its marks on average, {distance[worst] / length:.0%} of its length: check "
            f"the material and --up, or use shorter edges (doo-ti convert IN OUT --edges N): clamps hold a whole one, "
            f"{observations.rest_length.max():.3g} mm")


def say(source, *doubts: str | None) -> None:
    """Print as warnings about ``source`` those of the ``doubts`` that there are."""
    for doubt in doubts:
        if doubt is not None:
            terminal.warn(f"{in_line(source)}: {doubt}")


def unit_doubt(length: float, file: str = "file", option: str = "--unit", other: str = "the unit of the file") -> str | None:
    """Why the unit of a rod's ``length``, in mm, may be another one than the ``option`` says of the ``file``, or None."""
    likely = likely_unit(length)
    if likely == "":
        return None
    remedy = f"check {other}" if likely is None else f"if the {file} is in {likely}, give {option} {likely}"
    return f"a rod {length:.4g} mm long; {remedy}"


def mesh_doubt(rest_length: np.ndarray, surroundings: Surroundings | None) -> str | None:
    """Why a rod's edges (E,) may be too long for what is around it, or None: one is longer than the radii of the thinnest
    obstacle and of the rod together, the radius of a bend around it. Forces of a rod bent so are then 4 % too small."""
    if not surroundings:
        return None
    longest = rest_length.max()
    bodies = [getattr(body, "obstacle", body) for body in surroundings.bodies]
    thinnest = min((body.placed[3].min() for body in bodies), default=np.inf)
    radius = thinnest + np.min(surroundings.radius)
    if longest <= radius:
        return None
    return (f"edges of {longest:.3g} mm are too long to bend around an obstacle of {thinnest:.3g} mm radius: forces may come "
            f"out too small, and the rod slip off; give {np.ceil(rest_length.sum() / radius):.0f} edges (doo-ti convert IN OUT "
            "--edges N, or edges of a scene)")


def warn_of_axes(options: Namespace, rig: Rig) -> None:
    """Print a warning where ``--up`` is not given and the world has the axes of a camera, whose z is the way it looks."""
    axes = [camera.name for camera in rig.cameras if np.allclose(camera.rotation, np.eye(3)) and not camera.translation.any()]
    if options.up is None and axes:
        terminal.warn(f"{in_line(options.rig)}: the world has the axes of {in_line(axes[0])}, whose z, the way it looks, is "
                      "taken as up; give --up (-y if that camera is level)")


def inside_doubt(observations: Observations, surroundings: Surroundings | None) -> str | None:
    """That marks, or the lines between them, are inside an obstacle, or None: rods are moved out of it, to either side."""
    if not surroundings:
        return None
    around = Surroundings(surroundings.at(0).bodies, surroundings.radius)
    depth = -np.nan_to_num(around.smallest_gap(observations.vertices)) - surroundings.radius
    worst = int(depth.argmax())
    if depth[worst] <= 0:
        return None
    return (f"the axis of observation {observations.labels[worst]} is {depth[worst]:.3g} mm inside an obstacle: it is moved "
            "out first, on the nearer side, which need not be the right one; check the obstacle's place")


def order_doubt(observations: Observations) -> str | None:
    """Why the marks may not be those of one rod in their order, or None."""
    edges = unit_vectors(np.diff(np.where(observations.valid[..., None], observations.vertices, np.nan), axis=1))
    cosine = np.sum(edges[:, 1:] * edges[:, :-1], axis=-1)
    cosine = cosine[np.isfinite(cosine)]
    if len(cosine) and np.median(cosine) < np.cos(np.radians(MOST_TURN)):
        return (f"the line through the marks turns by {np.degrees(np.arccos(np.median(cosine))):.0f}° at half of them; are the "
                "columns observation and vertex swapped, or the marks not in their order along the rod?")
    exchanged = exchanged_marks(observations)
    if exchanged is not None:
        return (f"the line through the marks is far shorter with marks {exchanged[0]} and {exchanged[1]}, counted from 0, "
                f"exchanged, in {EXCHANGED:.0%} of the observations or more; check their labels")
    lengths = observations.rest_length
    longest, usual = lengths.max(), np.median(lengths)
    if longest <= MOST_UNEVEN * usual:
        return None
    return (f"mark {lengths.argmax() + 1} is {longest:.4g} mm from the mark before, the median is {usual:.4g} mm; if the file "
            "holds several rods, name the column that numbers them: --columns observation=NAME")


def reverse_doubt(observations: Observations) -> str | None:
    """That the frames of observations fit their marks in reverse order, or None."""
    frames = observations.start_frame, observations.end_frame
    if any(frame is None for frame in frames):
        return None
    start, end = (frame[..., 0] for frame in frames)
    edges = unit_vectors(np.diff(observations.vertices, axis=1))
    agree, reverse = ((start * first + end * last).sum(axis=-1) for first, last in (
        (edges[:, 0], edges[:, -1]), (-edges[:, -1], -edges[:, 0])))
    wrong = np.flatnonzero((agree < BOTH_AGREE) & (reverse > BOTH_AGREE))
    if not len(wrong):
        return None
    return (f"the marks of observation {observations.labels[wrong[0]]} look as if in reverse order: its end frames "
            f"agree with its edges only the other way round (such observations: {len(wrong)})")


def apart_doubt(observations: Observations) -> str | None:
    """That neighbouring marks are farther apart than the rod is long between them, or None."""
    apart = np.linalg.norm(np.diff(observations.vertices, axis=1), axis=-1)
    ratio = np.nan_to_num(apart / observations.rest_length)
    ratio[np.nan_to_num(apart) - observations.rest_length < TOO_FAR * observations.rest_length.sum()] = 0.0
    row, edge = np.unravel_index(ratio.argmax(), ratio.shape)
    if ratio[row, edge] < MOST_APART:
        return None
    return (f"marks {edge} and {edge + 1}, counted from 0, of observation {observations.labels[row]} are "
            f"{apart[row, edge]:.4g} mm apart, but {observations.rest_length[edge]:.4g} mm along the rod (such places: "
            f"{np.count_nonzero(ratio >= MOST_APART)}); leave marks that were not seen empty, and check labels")


def exchanged_marks(observations: Observations) -> tuple[int, int] | None:
    """The two marks, counted from 0, whose exchange makes the line through the marks far shorter in nearly all observations; of
    several pairs the one that shortens it most, and None where there is none."""
    looked_at = max(1, min(MOST_LOOKED_AT, MOST_PAIRS // observations.vertices.shape[1] ** 2))
    ratio = _with_two_exchanged(observations.vertices[:: -(-observations.count // looked_at)])
    seen = np.isfinite(ratio).sum(axis=0)
    often = (ratio < SHORTER).sum(axis=0) >= EXCHANGED * np.maximum(seen, 1)
    if not often.any():
        return None
    mean = np.where(often, np.nansum(ratio, axis=0) / np.maximum(seen, 1), np.inf)
    first, second = np.unravel_index(mean.argmin(), mean.shape)
    return int(first), int(second)


def _with_two_exchanged(vertices: np.ndarray) -> np.ndarray:
    """(D, V, V): length of the line through the marks (D, V, 3) beside two of them, the first before the second, if they are
    exchanged, over that as they are. NaN where marks are missing."""
    apart = np.linalg.norm(vertices[:, :, None] - vertices[:, None], axis=-1)
    beside = np.zeros_like(apart)  # (D, V, V): length of the line at place i with mark j there
    beside[:, 1:] += apart[:, :-1]
    beside[:, :-1] += apart[:, 1:]
    own, exchanged = np.einsum("dii->di", beside), beside + beside.swapaxes(1, 2)
    labelled, step = own[:, :, None] + own[:, None], np.arange(apart.shape[1] - 1)
    labelled[:, step, step + 1] -= 2 * apart[:, step, step + 1]  # of neighbours the edge between them stays
    with np.errstate(invalid="ignore", divide="ignore"):
        ratio = exchanged / labelled
    ratio[:, *np.tril_indices(ratio.shape[1])] = np.nan
    return ratio


def exchanged_doubt(observations: Observations, lengths: float | None = None) -> str | None:
    """That single observations have two marks exchanged, or None: between those the rod would be longer than it ever is in the
    others, or than the stated ``lengths`` between marks, and no longer so if they are exchanged."""
    rows: dict[tuple[int, ...], list[int]] = {}
    for row, marks in enumerate(observations.vertices):
        ratio = np.nan_to_num(_with_two_exchanged(marks[None])[0], nan=np.inf)
        if ratio.min() < SHORTER:
            rows.setdefault(tuple(map(int, np.unravel_index(ratio.argmin(), ratio.shape))), []).append(row)
    found = []
    for (first, second), own in rows.items():
        if lengths is None and observations.count - len(own) < 2:
            continue
        order = np.arange(observations.edges + 1)
        order[[first, second]] = second, first
        edges = np.setdiff1d([first - 1, first, second - 1, second], [-1, observations.edges, *[first] * (second == first + 1)])
        now, then = (np.linalg.norm(np.diff(places, axis=1)[:, edges], axis=-1)
                     for places in (observations.vertices, observations.vertices[:, order]))
        most = len(edges) * lengths if lengths is not None else np.nan_to_num(np.delete(now, own, axis=0)).max(axis=0).sum()
        wrong = (now.sum(axis=1) > TOO_LONG * most) & (then.sum(axis=1) < DOUBTFUL * most)
        found += [(row, first, second) for row in own if wrong[row]]
    if not found:
        return None
    places = "; ".join(f"{first} and {second} of observation {in_line(str(observations.labels[row]))}"
                       for row, first, second in sorted(found)[:MOST_NAMED])
    return (f"marks {places}{' …' * (len(found) > MOST_NAMED)} look exchanged: the rod would be longer there than it is in the "
            "others; check these labels in all cameras")


def length_doubt(observations: Observations) -> str | None:
    """Why the stated lengths between marks may be wrong, or None."""
    stated, arcs = float(observations.rest_length.sum()), float(observations.arcs.sum())
    if 1 / DOUBTFUL <= stated / arcs <= DOUBTFUL:
        return None
    return (f"rest_length_mm: the rod is stated to be {stated:.4g} mm long, but arcs through its marks are {arcs:.4g} mm; "
            "check the length from the first mark to the last along the rod and the --unit, or give no length"
            + "; noise lengthens arcs, too" * (stated < arcs))


def repeats_doubt(observations: Observations, noise: float) -> str | None:
    """That observations agree better than marks with independent ``noise``, mm per coordinate, could, or None. Errors that
    frames of one pose share count as often as there are frames, and intervals come out too narrow."""
    least = ALIKE * np.sqrt(6.0) * noise  # of the distance of marks that differ by independent noise alone
    alike = []
    for row in range(1, observations.count):
        squares = ((observations.vertices[:row] - observations.vertices[row]) ** 2).sum(axis=-1)
        both = np.isfinite(squares).sum(axis=1)
        if (np.nansum(squares, axis=1)[both > 0] < least**2 * both[both > 0]).any():
            alike.append(row)
    if not alike:
        return None
    return (f"{counted(len(alike), 'observation')} of {observations.count} agree with earlier ones to {least:.2g} mm, though "
            f"marks are off by {noise:.2g} mm: frames of the same pose share errors, and intervals are too narrow; keep one "
            "frame of each pose (doo-ti convert --select)")
