"""Labelled marks in images to observations (§V-A)."""

import json
from argparse import Namespace
from pathlib import Path

import numpy as np

from doo_ti.commands import options as given
from doo_ti.commands.arguments import add_json
from doo_ti.commands.printing import counted, plain
from doo_ti.errors import InputError
from doo_ti.io.marks import Marks, read_labels, read_marks
from doo_ti.io.observations import save_observations
from doo_ti.terminal import in_line
from doo_ti.vision.cameras.rig import Rig, load_rig
from doo_ti.vision.reprojection.marks import MarkedRods, observe
from doo_ti.vision.reprojection.triangulation import MarkStatus, Points, TriangulationOptions, triangulate

MOST_TOLD = 20


def declare(add) -> None:
    parser = add("triangulate", allow_abbrev=False, help="labelled marks in images to observations")
    parser.add_argument("marks", metavar="MARKS.csv",
                        help="columns observation,camera,mark,u_px,v_px; of ribbons marks 0L, 0R, 1L …")
    parser.add_argument("--rig", required=True, metavar="RIG.yaml", help="the calibrated cameras")
    parser.add_argument("--out", required=True, metavar="OBS", help="file to write: .npz, .csv or .parquet")
    parser.add_argument("--labels", metavar="LABELS.csv",
                        help="columns observation and any of end_distance_mm, end_rotation_deg, total_twist_deg")
    parser.add_argument("--rest-length", metavar="MM",
                        help="from each mark to the next along the rod (default: the median observed)")
    parser.add_argument("--sigma-px", type=float, default=0.5, metavar="PX", help="uncertainty of a label (default 0.5)")
    parser.add_argument("--threshold", type=float, default=5.0, metavar="SIGMAS",
                        help="labels that contradict each other by more are outliers (default 5)")
    parser.add_argument("--up", metavar="X,Y,Z", help="direction against gravity in the rig's world (default 0,0,1)")
    add_json(parser)
    parser.set_defaults(run=run)


def run(options: Namespace, words: list[str]) -> int:
    """Triangulate all marks; writes observations and names the labels that contradict the others."""
    chosen = TriangulationOptions(options.sigma_px, options.threshold)
    rest_length, up, out = given.length("--rest-length", options.rest_length), given.up(options), given.output_file(options.out)
    given.refuse_overwriting(out, options.marks)
    rig = load_rig(options.rig)
    if len(rig.cameras) < 2:
        raise InputError(options.rig, "cameras", "one camera", "triangulation needs two or more")
    marks = read_marks(options.marks, rig)
    labels = {} if options.labels is None else read_labels(options.labels, marks.names)
    if "total_twist" in labels:
        labels["total_twist"] = np.radians(labels["total_twist"])
    points = triangulate(rig, marks.pixels.reshape(len(rig.cameras), -1, 2), chosen)
    rods = observe(marks, points, rest_length, **({} if up is None else {"up": up}), name=out.stem, **labels)
    out.parent.mkdir(parents=True, exist_ok=True)
    save_observations(out, rods.observations)
    summary = _summary(marks, rig, points, rods, chosen, out)
    if options.json:
        print(json.dumps(plain(summary)))
    else:
        _tell(marks, summary)
    return 0


def _summary(marks: Marks, rig: Rig, points: Points, rods: MarkedRods, chosen: TriangulationOptions, out: Path) -> dict:
    observations = rods.observations
    counts = {status.name.lower(): int(np.sum(points.status == status)) for status in MarkStatus}
    return {
        "observations": observations.count, "names": marks.names, "vertices": observations.edges + 1, "ribbon": marks.is_ribbon,
        "marks": {name: count for name, count in counts.items() if count}, "valid_vertices": observations.valid.sum(),
        "median_sigma_mm": np.median(observations.sigma[observations.valid]),
        "sigma_px": chosen.sigma_px, "label_sigma_px": points.label_sigma,
        "rms_px": {name: _rms(points.residual[camera, points.used[camera]]) for camera, name in enumerate(rig.names)},
        "outliers": _doubted(marks, rig, points, MarkStatus.OUTLIER_LEFT_OUT),
        "contradictory": _doubted(marks, rig, points, MarkStatus.CONTRADICTORY),
        "frames_filled": rods.frames_filled.sum(),
        "end_frames": [end for end in ("start_frame", "end_frame") if getattr(observations, end) is not None],
        "out": str(out),
    }


def _rms(residual: np.ndarray) -> float:
    return np.sqrt(np.mean(residual**2)) if len(residual) else np.nan


def _doubted(marks: Marks, rig: Rig, points: Points, status: MarkStatus) -> list[dict]:
    """The labels of marks with this status that no position rests on."""
    unused = np.isfinite(points.residual) & ~points.used & (points.status == status)
    told = []
    for point, camera in np.argwhere(unused.T):
        observation, vertex, side = np.unravel_index(point, marks.pixels.shape[1:4])
        told.append({"observation": marks.names[observation], "mark": marks.mark(vertex, side), "camera": rig.names[camera],
                     "residual_px": points.residual[camera, point]})
    return told


def _tell(marks: Marks, summary: dict) -> None:
    count, vertices = summary["observations"], summary["vertices"]
    print(f"{count} observations of {vertices} vertices{', a ribbon' * marks.is_ribbon}")
    print(f"  marks       {counted(summary['marks'])}; {summary['valid_vertices']} of {count * vertices} vertices valid")
    rms = ", ".join(f"{name} {value:.2f}" for name, value in summary["rms_px"].items())
    print(f"  residual    {rms} px (rms)")
    print(f"  labels      uncertain by {summary['label_sigma_px']:.2g} px as they agree, by {summary['sigma_px']:.2g} px as "
          "assumed")
    print(f"  sigma       median {summary['median_sigma_mm']:.3g} mm")
    for kind, label, verdict in (("outliers", "outlier", ", left out"), ("contradictory", "contradictory", "")):
        for entry in summary[kind][:MOST_TOLD]:
            print(f"  {label:<11} observation {entry['observation']}, mark {entry['mark']}, {entry['camera']}: "
                  f"{entry['residual_px']:.1f} px off{verdict}")
        if len(summary[kind]) > MOST_TOLD:
            print(f"  {label:<11} and {len(summary[kind]) - MOST_TOLD} more, which --json lists")
    if marks.is_ribbon:
        print(f"  frames      {summary['frames_filled']} carried over from their neighbours; whole at "
              f"{' and '.join(summary['end_frames']) or 'neither end'} of all observations")
    print(f"  written to {in_line(summary['out'])}")
