"""Cameras: a rig from images of a board, and observations from labelled marks (§V-A)."""

from argparse import Namespace
from dataclasses import replace
from itertools import combinations
from pathlib import Path

import numpy as np

from doo_ti.commands import doubts, given, image_options, results
from doo_ti.io.observation_files import save_observations
from doo_ti.rod.material import UNITS_IN_MM
from doo_ti.rod.observations import Observations
from doo_ti.system.arguments import counted
from doo_ti.system.errors import InputError, require
from doo_ti.system.terminal import in_line, progress, warn
from doo_ti.vision.board import FORMS, Views, find_sightings, parse_board, read_views
from doo_ti.vision.calibration import COEFFICIENTS, WORLDS, Calibration, calibrate
from doo_ti.vision.cameras import Rig
from doo_ti.vision.marks import Marks, observe, read_labels, read_marks
from doo_ti.vision.rig_files import save_rig
from doo_ti.vision.triangulation import WITHIN, MarkStatus, Points, TriangulationOptions, label_scatter, triangulate

MOST_LISTED = 20
SELDOM = 0.01  # share of sound data in which an observation or a mark is named
LEAST_SPACING_MM = 0.1  # median distance of neighbouring marks below which the rig's unit is doubted


def declare(add) -> None:
    parser = given.command(add, "calibrate", run_calibrate, "calibrate a rig of cameras from images of a board")
    parser.add_argument("views", metavar="VIEWS.csv", help="columns view,cam0,cam1,…: images, relative to the file")
    parser.add_argument("--board", required=True, metavar="BOARD", help=FORMS)
    given.add_out(parser, "RIG.yaml")
    parser.add_argument("--world", choices=WORLDS, default=WORLDS[0],
                        help="axes of the world (default first-board, those of the first view's board: x along a row, y up the "
                        "page, z out of it)")
    given.add(parser, "--distortion", None, COEFFICIENTS, "how many of k1, k2, p1, p2, k3 to fit", 4, type=int)
    image_options.add_orientation(parser, "ignore; RIG.yaml keeps it")
    parser = given.command(add, "triangulate", run_triangulate, "turn labelled marks in images into observations")
    parser.add_argument("marks", metavar="MARKS.csv",
                        help="columns observation,camera,mark,u_px,v_px; ribbons have marks 0L, 0R, 1L …")
    image_options.add_rig(parser)
    given.add(parser, "--out", "OBS", given.output_file, "file to write: .npz, .csv or .parquet", required=True)
    given.add(parser, "--labels", "LABELS.csv", str, "columns observation and any of end_distance_mm, end_rotation_deg, "
              "total_twist_deg")
    given.add(parser, "--rest-length", "MM", given.LENGTH, "length of rod from each mark to the next (default: the median "
              "observed)")
    parser.add_argument("--sigma-px", type=float, default=0.5, metavar="PX", help="standard deviation of a label (default 0.5)")
    parser.add_argument("--threshold", type=float, default=5.0, metavar="SIGMAS",
                        help="labels further from the others than this many standard deviations are outliers (default 5)")
    given.add_up(parser, "0,0,1 in the rig's world")


def run_calibrate(options: Namespace) -> int:
    """Corners in all images, then intrinsics and extrinsics; writes the rig and prints how well each image agrees."""
    board = parse_board(options.board)
    views = read_views(Path(options.views))
    turned = options.orientation == "apply"
    with progress() as bar:
        task = bar.add_task("corners", total=len(views.images), unit="images")
        sightings, sizes = find_sightings(views, board, lambda: bar.advance(task), turned)
    calibration = calibrate(board.points, sightings, sizes, len(views.names), options.world, options.distortion, views.source)
    save_rig(options.out, Rig(tuple(replace(camera, turned=turned) for camera in calibration.rig.cameras)))
    summary = _calibration_summary(views, calibration, options.out)
    summary["orientation"] = image_options.orientation_note(views.images.values(), turned)
    _doubt_calibration(views, calibration)
    results.report(options, summary, lambda: _calibration_lines(views, calibration, summary), indent="")
    return 0


FAR_OFF, LEAST_OFF_PX = 3.0, 0.2  # error of an image over the median of all, and px, from which on it is doubtful
APART, LEAST_APART_PX = 1.5, 0.1  # error of all cameras together over that of each alone, and px, from which on they disagree
LEAST_APART_MM = 0.1  # between two cameras
COVERED = 0.5  # share of an image that corners cover, below which its lens is guessed towards the border
SQUARE = 5e-3  # share by which the pixels of cameras differ from squares, at most


def _doubt_calibration(views: Views, calibration: Calibration) -> None:
    """Warn of images that fit far worse than the others, of cameras that agree less about the board than each with itself, or
    are at the same place, and of pixels that are no squares."""
    moved = calibration.moved
    if moved is not None and moved.shift > LEAST_APART_PX:
        names = " or ".join(in_line(views.cameras[camera]) for camera in moved.cameras)
        warn(f"{in_line(views.source)}: {names} moved before view {in_line(views.names[moved.view])}, by {moved.shift:.2g} px "
             "at the corners: give only the views before, or only those from there on")
        return
    limit = max(FAR_OFF * np.nanmedian(calibration.rms), LEAST_OFF_PX)
    for view in np.flatnonzero((calibration.rms > limit).any(axis=1)):
        warn(f"{in_line(views.source)}: view {in_line(views.names[view])}: {np.nanmax(calibration.rms[view]):.2g} px off, the "
             f"median image {np.nanmedian(calibration.rms):.2g}: blurred, or the board moved between cameras; leave it out")
    alone = float(np.sqrt(np.mean(calibration.alone**2)))
    if calibration.overall_rms > max(APART * alone, LEAST_APART_PX):
        warn(f"{in_line(views.source)}: corners are {calibration.overall_rms:.2g} px off, of a camera alone {alone:.2g} px: "
             "the board moved between cameras, is stretched, or an image is of another view")
    for name, covered in zip(views.cameras, calibration.covered, strict=True):
        if covered < COVERED:
            warn(f"{in_line(views.source)}: {in_line(name)}: the boards cover {100 * covered:.0f} % of its images, "
                 "outside its lens may be pixels off: add views near the border")
    centres = np.array([camera.centre for camera in calibration.rig.cameras])
    for one, other in zip(*np.triu_indices(len(centres), 1), strict=True):
        apart, sigma = np.linalg.norm(centres[one] - centres[other]), np.linalg.norm(calibration.centre_sigma[[one, other]])
        if apart < FAR_OFF * sigma + LEAST_APART_MM:
            warn(f"{in_line(views.source)}: {' and '.join(in_line(views.cameras[k]) for k in (one, other))} are {apart:.2g} mm "
                 "apart: are their images the same?")
    for camera, sigma in zip(calibration.rig.cameras, calibration.focal_sigma, strict=True):
        across, down = camera.matrix[[0, 1], [0, 1]]
        if abs(across - down) > SQUARE * down + FAR_OFF * np.hypot(*sigma):
            warn(f"{in_line(views.source)}: {in_line(camera.name)}: focal lengths across and down differ by "
                 f"{100 * abs(across / down - 1):.1f} %, those of cameras hardly do: measure the board's squares both ways; "
                 "leave out views in which it moved between cameras")


def _calibration_summary(views: Views, calibration: Calibration, out: Path) -> dict:
    (worst_view, worst_camera), corners = calibration.worst, calibration.corners
    cameras = [{
        "name": camera.name, "width": camera.width, "height": camera.height, "focal_px": camera.matrix[[0, 1], [0, 1]],
        "focal_sigma_px": calibration.focal_sigma[index], "principal_point_px": camera.matrix[:2, 2],
        "distortion": camera.distortion, "centre_mm": camera.centre, "centre_sigma_mm": calibration.centre_sigma[index],
        "covered": calibration.covered[index],
        "rms_px": np.sqrt(np.nansum(calibration.rms[:, index] ** 2 * corners[:, index]) / corners[:, index].sum()),
    } for index, camera in enumerate(calibration.rig.cameras)]
    images = [{"view": views.names[view], "camera": views.cameras[camera], "corners": corners[view, camera],
               "left_out": calibration.left_out[view, camera], "rms_px": calibration.rms[view, camera]}
              for view, camera in sorted(views.images)]
    return {
        "views": len(views.names), "rms_px": calibration.overall_rms, "corner_sigma_px": calibration.sigma_px,
        "cameras": cameras,
        "worst": {"view": views.names[worst_view], "camera": views.cameras[worst_camera],
                  "rms_px": calibration.rms[worst_view, worst_camera]},
        "images": images, "without_board": [image for image in images if not image["corners"]], "out": str(out),
    }


def _calibration_lines(views: Views, calibration: Calibration, summary: dict) -> list[str]:
    wide = max(8, *(len(name) for name in views.cameras))
    tall = max(4, *(len(name) for name in views.names))
    lines = [f"{len(views.cameras)} cameras, {len(views.names)} views, {calibration.corners.sum()} corners",
             "reprojection, px: root mean square distance between corners seen and projected",
             f"  {'view':<{tall}} {' '.join(f'{name:>{wide}}' for name in views.cameras)}"]
    for view, name in enumerate(views.names):
        cells = [f"{calibration.rms[view, camera]:.3f}" if calibration.corners[view, camera] else
                 "no board" if (view, camera) in views.images else "" for camera in range(len(views.cameras))]
        lines.append(f"  {name:<{tall}} {' '.join(f'{cell:>{wide}}' for cell in cells)}")
    whole = " ".join(f"{camera['rms_px']:>{wide}.3f}" for camera in summary["cameras"])
    lines.append(f"  {'all':<{tall}} {whole}")
    worst = summary["worst"]
    lines += [f"overall {summary['rms_px']:.3f} px; worst {worst['rms_px']:.3f} px, view {worst['view']} of {worst['camera']}",
              "standard deviations, from independent errors of the corners:"]
    for camera in summary["cameras"]:
        (x, y, z), off = camera["centre_mm"], np.linalg.norm(camera["centre_sigma_mm"])
        across, down = camera["focal_px"]
        lines.append(f"  {camera['name']}: centre {x:.2f}, {y:.2f}, {z:.2f} mm ± {off:.3f}; focal length {across:.1f}, "
                     f"{down:.1f} px ± {camera['focal_sigma_px'].max():.2f}; "
                     f"boards cover {100 * camera['covered']:.0f} %")
    lines += [f"left out: {counted(image['left_out'], 'corner')} of view {image['view']} of {image['camera']}, far off beside "
              "the others" for image in summary["images"] if image["left_out"]]
    if summary["without_board"]:
        lines.append(f"no board found in {len(summary['without_board'])} of {len(summary['images'])} images")
    if summary["orientation"]:
        lines.append(f"orientation: {summary['orientation']}")
    return lines


def run_triangulate(options: Namespace) -> int:
    """Triangulate all marks; writes observations and names the labels that contradict the others."""
    chosen = TriangulationOptions(options.sigma_px, options.threshold)
    results.refuse_overwriting(options.out, options.marks)
    rig = image_options.rig(options)
    require(len(rig.cameras) >= 2, options.rig, "cameras", "one camera", "triangulation needs two or more")
    marks = read_marks(options.marks, rig)
    labels = {} if options.labels is None else read_labels(options.labels, marks.names)
    if "total_twist" in labels:
        labels["total_twist"] = np.radians(labels["total_twist"])
    points = triangulate(rig, marks.pixels.reshape(len(rig.cameras), -1, 2), chosen)
    _check_reading(rig, marks, points, chosen)
    if not _doubt_rig(rig, marks, points, chosen) and not _doubt_cameras(rig, points):
        _doubt_labels(rig, marks, points)
    up = {} if options.up is None else {"up": options.up}
    observations, filled = observe(marks, points, options.rest_length, **up, name=options.out.stem, **labels)
    doubts.say(marks.source, doubts.order_doubt(observations) or doubts.exchanged_doubt(observations, options.rest_length))
    save_observations(options.out, observations)
    summary = _marks_summary(marks, rig, points, observations, filled, chosen, options.out)
    results.report(options, summary, lambda: _marks_lines(marks, summary))
    return 0


def _check_reading(rig: Rig, marks: Marks, points: Points, chosen: TriangulationOptions) -> None:
    """Raise InputError for a rig whose file is probably in another unit, or has poses of another kind."""
    rods = points.position.reshape(len(marks.names), -1, 3)
    spacing = np.linalg.norm(np.diff(rods, axis=1), axis=-1)
    spacing = float(np.median(spacing[np.isfinite(spacing)])) if np.isfinite(spacing).any() else np.nan
    in_m = rig.reading.unit is None and spacing < LEAST_SPACING_MM <= spacing * UNITS_IN_MM["m"]
    require(not in_m, rig.source, "cameras", f"marks are {spacing:.2g} mm apart, unless its lengths are in m",
            "give --rig-unit m, or --rig-unit mm where that is so")
    labelled = (np.isfinite(marks.pixels).all(axis=-1).sum(axis=0) > 1).sum()
    for other, assumed, option in rig.read_otherwise():
        if other.reading.poses is not None and 2 * points.valid.sum() < labelled:
            valid = triangulate(other, marks.pixels.reshape(len(rig.cameras), -1, 2), chosen).valid.sum()
            if valid > 0.9 * labelled:
                raise InputError(rig.source, "cameras", f"labels of {labelled - points.valid.sum()} of {labelled} marks "
                                 f"contradict each other, of {labelled - valid} if {assumed}", f"give {option}")


def _doubt_cameras(rig: Rig, points: Points) -> bool:
    """Warn of cameras whose labels disagree with the others' at most marks; whether there is one."""
    seen = points.valid & np.isfinite(points.residual)
    wrong, marks = np.sum(seen & ~points.used, axis=1), seen.sum(axis=1)
    for camera in np.flatnonzero(2 * wrong > marks):
        warn(f"{in_line(rig.source)}: {in_line(rig.names[camera])} disagrees with the others at {wrong[camera]} of "
             f"{marks[camera]} marks: it has moved, its images are others, or its labels coarser; calibrate it "
             "again, or leave it out")
    return bool((2 * wrong > marks).any())


SCALES = 2.0, 3.0, 4.0, 1.5, 4 / 3, 0.5, 0.75  # of images that were taken, or labelled, at another resolution
MOST_TRIED = 100  # marks


def _doubt_rig(rig: Rig, marks: Marks, points: Points, chosen: TriangulationOptions) -> bool:
    """Warn of labels that agree far better in a rig read otherwise, and of those that agree in none; whether it warned."""
    now = points.label_sigma
    if not now > chosen.sigma_px:
        return False
    pixels = marks.pixels.reshape(len(rig.cameras), -1, 2)
    pixels = pixels[:, :: -(-pixels.shape[1] // MOST_TRIED)]
    tried = [(label_scatter(rig, scale * pixels) / scale, f"images had {scale:.3g} times as many pixels a side",
              "label images as they were calibrated, or calibrate with images as they were labelled") for scale in SCALES]
    pairs = {pair: " and ".join(in_line(rig.names[camera]) for camera in pair) for pair in combinations(range(len(pixels)), 2)}
    for (one, other), names in pairs.items():
        order = np.arange(len(pixels))
        order[[one, other]] = other, one
        tried.append((label_scatter(rig, pixels[order]), f"{names} are exchanged", "correct the cameras' names"))
    best, assumed, remedy = min(tried)
    if FAR_OFF * best < now:
        warn(f"{in_line(rig.source)}: labels scatter by {now:.2g} px, but {best:.2g} px if {assumed}: {remedy}")
        return True
    if now > WITHIN * chosen.sigma_px:
        each = [f"{names} {label_scatter(rig.take(pair), pixels[list(pair)]):.2g}" for pair, names in pairs.items()]
        warn(f"{in_line(rig.source)}: labels scatter by {now:.2g} px, {chosen.sigma_px:g} px were stated (pairs of cameras: "
             f"{', '.join(each)}): calibrate with images as those labelled, neither cropped nor scaled; check labels; or give "
             "--sigma-px")
        return True
    return False


def _doubt_labels(rig: Rig, marks: Marks, points: Points) -> None:
    """Warn of observations, and of marks, of which more than half of the places contradict, more than by chance."""
    from scipy.special import bdtrc

    shape = marks.pixels.shape[:4]
    labelled = np.isfinite(marks.pixels).all(axis=-1)
    wrong = np.isin(points.status, (MarkStatus.OUTLIER_LEFT_OUT, MarkStatus.CONTRADICTORY)).reshape(shape[1:])
    left_out = wrong & labelled & points.valid.reshape(shape[1:]) & ~points.used.reshape(shape)
    for kind, axis, remedy in (("observation", 0, "an image is of another moment, or its marks are counted otherwise"),
                               ("mark", 1, "it was taken for another")):
        bad, of = (np.moveaxis(places, axis, 0).sum(axis=(1, 2)) for places in (wrong, labelled.sum(axis=0) > 1))
        chance = bdtrc(np.maximum(bad - 1, 0), of, bad.sum() / max(of.sum(), 1))  # of so many, if all were alike
        rows = np.flatnonzero((2 * bad > of) & (chance < SELDOM / len(bad)))
        if len(rows):
            names = [in_line(marks.names[row]) if kind == "observation" else str(row) for row in rows[: doubts.MOST_NAMED]]
            blamed = np.moveaxis(left_out, 1 + axis, 1)[:, rows].sum(axis=(1, 2, 3))
            most = f", most by {in_line(rig.names[blamed.argmax()])}" if blamed.any() else ""
            warn(f"{in_line(marks.source)}: {kind} {', '.join(names)}{' …' * (len(rows) > doubts.MOST_NAMED)}: labels "
                 f"contradict each other at {bad[rows].sum()} of {of[rows].sum()} places{most}: {remedy}")


def _marks_summary(marks: Marks, rig: Rig, points: Points, observations: Observations, filled: np.ndarray,
                   chosen: TriangulationOptions, out: Path) -> dict:
    counts = {status.name.lower(): int(np.sum(points.status == status)) for status in MarkStatus}
    return {
        "observations": observations.count, "names": marks.names, "vertices": observations.edges + 1, "ribbon": marks.is_ribbon,
        "marks": {name: count for name, count in counts.items() if count}, "valid_vertices": observations.valid.sum(),
        "median_sigma_mm": np.median(observations.sigma[observations.valid]),
        "sigma_px": chosen.sigma_px, "used_sigma_px": points.sigma_px, "label_sigma_px": points.label_sigma,
        "rms_px": {name: np.sqrt(np.mean(points.residual[camera, used] ** 2)) if used.any() else np.nan
                   for camera, (name, used) in enumerate(zip(rig.names, points.used, strict=True))},
        "outliers": _unused_labels(marks, rig, points, MarkStatus.OUTLIER_LEFT_OUT),
        "contradictory": _unused_labels(marks, rig, points, MarkStatus.CONTRADICTORY),
        "frames_filled": filled.sum(),
        "end_frames": [end for end in ("start_frame", "end_frame") if getattr(observations, end) is not None],
        "out": str(out),
    }


def _unused_labels(marks: Marks, rig: Rig, points: Points, status: MarkStatus) -> list[dict]:
    """The labels of marks with this status that were not used for a position."""
    unused = np.isfinite(points.residual) & ~points.used & (points.status == status)
    labels = []
    for point, camera in np.argwhere(unused.T):
        observation, vertex, side = np.unravel_index(point, marks.pixels.shape[1:4])
        labels.append({"observation": marks.names[observation], "mark": marks.mark(vertex, side), "camera": rig.names[camera],
                     "residual_px": points.residual[camera, point]})
    return labels


def _marks_lines(marks: Marks, summary: dict) -> list[str]:
    count, vertices = summary["observations"], summary["vertices"]
    rms = ", ".join(f"{name} {value:.2f}" for name, value in summary["rms_px"].items())
    few = np.isnan(summary["label_sigma_px"])
    learned = "too few to learn their scatter" if few else f"scatter by {summary['label_sigma_px']:.2g} px"
    lines = [f"{counted(count, 'observation')} of {vertices} vertices{', a ribbon' * marks.is_ribbon}",
             f"  marks       {results.status_text(summary['marks'])}; {summary['valid_vertices']} of {count * vertices} "
             "vertices valid",
             f"  residual    {rms} px (rms)",
             f"  labels      {learned}, {summary['sigma_px']:.2g} px were stated",
             f"  sigma       median {summary['median_sigma_mm']:.3g} mm, for {summary['used_sigma_px']:.2g} px"]
    for kind, label, verdict in (("outliers", "outlier", ", left out"), ("contradictory", "contradictory", "")):
        lines += results.shortened([
            f"  {label:<11} observation {entry['observation']}, mark {entry['mark']}, {entry['camera']}: "
            f"{entry['residual_px']:.1f} px off{verdict}" for entry in summary[kind]], MOST_LISTED,
            f"  {label:<11} and {{}} more, which --json lists")
    if marks.is_ribbon:
        lines.append(f"  frames      {summary['frames_filled']} carried over from their neighbours; measured in all "
                     f"observations at {' and '.join(summary['end_frames']) or 'neither end'}")
    return lines
