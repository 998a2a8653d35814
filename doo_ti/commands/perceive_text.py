"""What `doo-ti perceive` prints: a line for each set, and what became of all of them."""

from pathlib import Path

import numpy as np

from doo_ti.commands.perceive_task import Task
from doo_ti.commands.printing import counted
from doo_ti.learning.objective import status_counts
from doo_ti.terminal import in_line
from doo_ti.types import Status

MOST_TOLD = 60


def summary_of(task: Task, detected: list[list], found, written: list[Path]) -> dict:
    """What machines are told, and people read some of."""
    from doo_ti.perception.perceive import Verdict

    sets = [{
        "name": name, "status": Status(found.status[row]).name.lower(), "stable": found.stable[row],
        "energy_vis": found.energy_vis[row], "camera_error_px": found.camera_error[row], "gap_px": found.gap[row],
        "verdict": Verdict(found.verdict[row]).name.lower(), "unsupported_edges": found.unsupported[row].sum(),
        "mean_sigma_mm": found.sigma[row].mean() if found.sound[row] else None, **_errors(task, found, row),
    } for row, name in enumerate(task.sets.names)]
    return {
        "sets": sets, "cameras": task.sets.rig.names, "edges": len(task.rest_length),
        "detected_width_px": np.median([detection.width_px for line in detected for detection in line]),
        "status": status_counts(found.status),
        "stable": found.stable.sum(),
        "not_certified": (~found.sound).sum(),
        "verdicts": {verdict.name.lower(): (found.verdict == verdict).sum() for verdict in Verdict},
        "written": [str(path) for path in written],
    }


def _errors(task: Task, found, row: int) -> dict:
    """Distances to the true rod's marks, where it has as many."""
    if task.truth is None or task.truth.shape[1] != found.vertices.shape[1]:
        return {}
    error = np.linalg.norm(found.vertices[row] - task.truth[row], axis=-1)
    return {"mean_error_mm": error.mean(), "largest_error_mm": error.max()}


def verdict_text(found, row: int) -> str:
    """``clear, next best 0.31 px worse``."""
    from doo_ti.perception.perceive import Verdict

    rival = f"next best {found.gap[row]:.2g} px worse" if np.isfinite(found.gap[row]) else "no other rod"
    return f"{Verdict(found.verdict[row]).name.lower()}, {rival}"


def tell(summary: dict) -> None:
    sets = summary["sets"]
    width = max(len(entry["name"]) for entry in sets[:MOST_TOLD])
    print(f"{len(sets)} sets of {len(summary['cameras'])} images, rods of {summary['edges']} edges; thread "
          f"{summary['detected_width_px']:.1f} px wide")
    for entry in sets[:MOST_TOLD]:
        pixels = " ".join(f"{max(value, 0.0):.2f}" if np.isfinite(value) else "unseen" for value in entry["camera_error_px"])
        rival = f"gap {entry['gap_px']:.2g} px" if np.isfinite(entry["gap_px"]) else "no rival"
        parts = [f"E_vis {entry['energy_vis']:.3g}/mm", f"{pixels} px off", f"{entry['verdict']} ({rival})",
                 "σ unknown" if entry["mean_sigma_mm"] is None else f"σ {entry['mean_sigma_mm']:.2g} mm"]
        if entry["unsupported_edges"]:
            parts.append(f"{entry['unsupported_edges']} edges unseen")
        if entry["status"] != "converged" or not entry["stable"]:
            parts.append(f"{entry['status'].replace('_', ' ')}{', not certified' * (not entry['stable'])}")
        if "mean_error_mm" in entry:
            parts.append(f"error {entry['mean_error_mm']:.3f} mm, at most {entry['largest_error_mm']:.2f}")
        print(f"  {entry['name']:<{width}}  {'; '.join(parts)}")
    if len(sets) > MOST_TOLD:
        print(f"  and {len(sets) - MOST_TOLD} more, which --json lists")
    print(f"  status      {counted(summary['status'])}; {summary['stable']} certified stable")
    print(f"  certified   {len(sets) - summary['not_certified']} of {len(sets)} rods converged to certified minima; "
          f"{summary['not_certified']} did not")
    print(f"  verdicts    {counted(summary['verdicts'])} (docs/perception.md)")
    for path in summary["written"]:
        print(f"  written to  {in_line(path)}")
