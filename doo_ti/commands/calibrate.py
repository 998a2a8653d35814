"""A rig from boards (§V-A)."""

import json
from argparse import Namespace
from pathlib import Path

import numpy as np

from doo_ti.commands import options as given
from doo_ti.commands.arguments import add_json
from doo_ti.commands.printing import plain
from doo_ti.terminal import in_line, progress
from doo_ti.vision.cameras.board import FORMS, Board, parse_board
from doo_ti.vision.cameras.calibration import COEFFICIENTS, WORLDS, Calibration, CalibrationOptions, calibrate
from doo_ti.vision.cameras.rig import save_rig
from doo_ti.vision.cameras.views import Views, find_sightings, read_views


def declare(add) -> None:
    parser = add("calibrate", allow_abbrev=False, help="a rig from images of a board")
    parser.add_argument("views", metavar="VIEWS.csv", help="columns view,cam0,cam1,…: images relative to the file")
    parser.add_argument("--board", required=True, metavar="BOARD", help=FORMS)
    parser.add_argument("--out", required=True, metavar="RIG.yaml", help="file to write")
    parser.add_argument("--world", choices=WORLDS, default=WORLDS[0],
                        help="where the world's axes lie (default first-board: x along a row, y up the page, z out of it)")
    parser.add_argument("--distortion", type=int, choices=COEFFICIENTS, default=4,
                        help="how many of k1, k2, p1, p2, k3 to fit (default 4)")
    add_json(parser)
    parser.set_defaults(run=run)


def run(options: Namespace, words: list[str]) -> int:
    """Corners in all images, then intrinsics and extrinsics; writes the rig and prints how well each image agrees."""
    board, out = parse_board(options.board), given.output_file(options.out, ".yaml")
    views = read_views(Path(options.views))
    sightings, sizes = _searched(views, board)
    chosen = CalibrationOptions(world=options.world, distortion=options.distortion)
    calibration = calibrate(board.points, sightings, sizes, len(views.names), chosen, views.source)
    out.parent.mkdir(parents=True, exist_ok=True)
    save_rig(out, calibration.rig)
    summary = _summary(views, calibration, out)
    if options.json:
        print(json.dumps(plain(summary)))
    else:
        _tell(views, calibration, summary)
    return 0


def _searched(views: Views, board: Board):
    with progress() as bar:
        task = bar.add_task("corners", total=len(views.images), unit="images")
        return find_sightings(views, board, lambda: bar.advance(task))


def _summary(views: Views, calibration: Calibration, out: Path) -> dict:
    worst_view, worst_camera = calibration.worst
    cameras = [{
        "name": camera.name, "width": camera.width, "height": camera.height, "focal_px": camera.matrix[[0, 1], [0, 1]],
        "focal_sigma_px": calibration.focal_sigma[index], "principal_point_px": camera.matrix[:2, 2],
        "distortion": camera.distortion, "centre_mm": camera.centre, "centre_sigma_mm": calibration.centre_sigma[index],
        "rms_px": _rms(calibration, np.s_[:, index]),
    } for index, camera in enumerate(calibration.rig.cameras)]
    images = [{"view": views.names[view], "camera": views.cameras[camera], "corners": calibration.corners[view, camera],
               "rms_px": calibration.rms[view, camera]} for view, camera in sorted(views.images)]
    return {
        "views": len(views.names), "rms_px": calibration.overall_rms, "corner_sigma_px": calibration.sigma_px,
        "cameras": cameras,
        "worst": {"view": views.names[worst_view], "camera": views.cameras[worst_camera],
                  "rms_px": calibration.rms[worst_view, worst_camera]},
        "images": images, "without_board": [image for image in images if not image["corners"]], "out": str(out),
    }


def _rms(calibration: Calibration, part) -> float:
    """px, over the corners of some images."""
    corners = calibration.corners[part]
    return np.sqrt(np.nansum(calibration.rms[part] ** 2 * corners) / corners.sum())


def _tell(views: Views, calibration: Calibration, summary: dict) -> None:
    wide = max(8, *(len(name) for name in views.cameras))
    tall = max(4, *(len(name) for name in views.names))
    print(f"{len(views.cameras)} cameras, {len(views.names)} views, {calibration.corners.sum()} corners")
    print("reprojection, px: root mean square distance between corners seen and projected")
    print(f"  {'view':<{tall}} {' '.join(f'{name:>{wide}}' for name in views.cameras)}")
    for view, name in enumerate(views.names):
        cells = [f"{calibration.rms[view, camera]:.3f}" if calibration.corners[view, camera] else
                 "no board" if (view, camera) in views.images else "" for camera in range(len(views.cameras))]
        print(f"  {name:<{tall}} {' '.join(f'{cell:>{wide}}' for cell in cells)}")
    whole = " ".join(f"{camera['rms_px']:>{wide}.3f}" for camera in summary["cameras"])
    print(f"  {'all':<{tall}} {whole}")
    worst = summary["worst"]
    print(f"overall {summary['rms_px']:.3f} px; worst {worst['rms_px']:.3f} px, view {worst['view']} of {worst['camera']}")
    print("standard deviations, from independent errors of the corners:")
    for camera in summary["cameras"]:
        (x, y, z), off = camera["centre_mm"], np.linalg.norm(camera["centre_sigma_mm"])
        across, down = camera["focal_px"]
        print(f"  {camera['name']}: centre {x:.2f}, {y:.2f}, {z:.2f} mm ± {off:.3f}; focal length {across:.1f}, {down:.1f} px "
              f"± {camera['focal_sigma_px'].max():.2f}")
    if summary["without_board"]:
        print(f"no board found in {len(summary['without_board'])} of {len(summary['images'])} images")
    print(f"written to {in_line(summary['out'])}")
