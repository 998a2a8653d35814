"""What ``doo-ti refine`` tells: a summary for machines, and lines made of it for a person."""

from dataclasses import asdict
from itertools import combinations

import numpy as np

from doo_ti.commands.printing import counted
from doo_ti.dataset import Observations
from doo_ti.refinement.linear_density import weight_per_length

LISTED = 4  # unknowns named one by one, directions left open, observations on other branches
JOINTS = "rest_curvature_per_joint"


def summary_of(observations: Observations, found: tuple, held_out, density: float | None) -> dict:
    """The best of the refinements ``found`` with its intervals, and the others in short, as JSON holds it.

    held_out  a :class:`doo_ti.refinement.folds.HeldOut`, or None
    density   of the rod in g/m, or None
    """
    best, estimate = found[0], found[0].estimate
    few = [name for name in estimate.names if not name.startswith(JOINTS)]
    return {
        "material": observations.name, "source": observations.source, "observations": observations.count,
        "theta": _theta(best.theta), "parameters": [asdict(parameter) for parameter in estimate.parameters],
        "unknowns": estimate.names, "covariance": estimate.covariance, "correlation": estimate.correlation,
        "degrees_of_freedom": best.degrees, "chi_square": best.chi_square, "reduced_chi_square": best.reduced_chi_square,
        "tilt_deg": float(np.degrees(np.arccos(np.clip(np.dot(best.theta.up, observations.up), -1.0, 1.0)))),
        "sigma_mm": best.sigma, "reaches_noise": best.reaches_noise, "neighbour_correlation": best.neighbours,
        "verdict": best.verdict, "not_determined": estimate.left_open, "stiffness": _stiffness(best, density),
        "mean_distance_mm": best.mean_distance, "start_mean_distance_mm": best.start_mean_distance,
        "distance_mm": best.distance, "rods_used": int(best.used.sum()), "left_out": best.left_out,
        "misfits": np.flatnonzero(best.misfits),
        "other_branch": np.flatnonzero(best.other_branch), "converged": best.converged, "iterations": best.iterations,
        "regions": [{"parameters": pair, "outline": estimate.region(*pair)} for pair in combinations(few, 2)],
        "other_starts": [{**_theta(other.theta), "mean_distance_mm": other.mean_distance, "rods_used": int(other.used.sum()),
                          "converged": other.converged} for other in found[1:]],
        "held_out": None if held_out is None else {
            "fold": held_out.fold, "distance_mm": held_out.distance, "mean_distance_mm": held_out.mean_distance,
            "standard_error_mm": held_out.standard_error, "sound": int(held_out.sound.sum()),
            "theta": [_theta(one.theta) for one in held_out.refinements]},
    }


def _theta(theta) -> dict:
    return {"bend_1": theta.bend[0, 0], "bend_2": theta.bend[1, 1], "bend_12": theta.bend[0, 1], "twist": theta.twist,
            "weight": theta.weight, "rest_curvature": theta.rest_curvature, "up": theta.up}


def _stiffness(best, density: float | None) -> dict:
    """Learned stiffness over weight per length in mm³, and with a linear density in N m²: value, low, high."""
    bend = best.theta.bend
    names = {"EI": "bend_1", "GJ": "twist"} if bend[0, 0] == bend[1, 1] else {"EI_1": "bend_1", "EI_2": "bend_2", "GJ": "twist"}
    names |= {"EI": "bend"} if "bend" in best.estimate.names else {}
    names = {name: parameter for name, parameter in names.items() if parameter in best.estimate.names}
    result = {}
    for name, parameter in names.items():
        over_weight = best.estimate.over_weight(parameter)
        result[f"{name}_over_weight_mm3"] = over_weight
        if density is not None:
            result[f"{name}_Nm2"] = [value * weight_per_length(density) * 1e-9 for value in over_weight]
    return result


def tell(summary: dict) -> None:
    """Lines for a person."""
    steps = f"{summary['iterations']} steps{'' if summary['converged'] else ', NOT at the least: stopped'}"
    print(f"{summary['material']}: {summary['rods_used']} of {summary['observations']} observations, {steps}")
    for parameter in summary["parameters"]:
        if not parameter["name"].startswith((JOINTS, "up[")):
            print(f"  {parameter['name']:<18} {_interval(parameter['value'], parameter['low'], parameter['high'])} "
                  f"{parameter['unit']}".rstrip())
    if any(parameter["name"].startswith(JOINTS) for parameter in summary["parameters"]):
        rest = np.asarray(summary["theta"]["rest_curvature"])
        size = float(np.sqrt((rest**2).sum(axis=-1).mean()))
        print(f"  {'rest curvature':<18} {size:.3g} 1/mm, root mean square over {len(rest)} joints")
    print("                     (95 % intervals" + ("" if summary["reaches_noise"] else
                                                    " of noise alone: the model lacks something, and may be off by more") + ")")
    if "up[0]" in summary["unknowns"]:
        x, y, z = summary["theta"]["up"]
        print(f"  {'up':<18} ({x:.4f}, {y:.4f}, {z:.4f}), tilted by {summary['tilt_deg']:.2g}° from what was given")
    for name, values in summary["stiffness"].items():
        what, unit = (name.removesuffix("_Nm2"), "N m²") if name.endswith("_Nm2") else (
            f"{name.removesuffix('_over_weight_mm3')} over weight", "mm³")
        print(f"  {what:<18} {_interval(*values)} {unit}")
    print(f"  distance           mean {summary['mean_distance_mm']:.4g} mm, {summary['start_mean_distance_mm']:.4g} mm where "
          "it began (Eq. 1; least squares need not make it least)")
    print(f"  residuals          {summary['verdict']}")
    _tell_doubts(summary)
    for other in summary["other_starts"]:
        print(f"  another start      bend {other['bend_1']:.4g}, twist {other['twist']:.4g} mm³: mean "
              f"{other['mean_distance_mm']:.4g} mm, {other['rods_used']} rods")
    if summary["held_out"] is not None:
        held = summary["held_out"]
        print(f"  held out           mean {held['mean_distance_mm']:.4g} ± {held['standard_error_mm']:.2g} mm over "
              f"{held['sound']} rods in {len(held['theta'])} folds (Eq. 1)")


def _tell_doubts(summary: dict) -> None:
    """What is correlated, not determined, left out, or elsewhere."""
    names, correlation = summary["unknowns"], summary["correlation"]
    for first, second in combinations(range(min(len(names), LISTED)), 2):
        if abs(correlation[first, second]) > 0.9:
            print(f"  correlation        {correlation[first, second]:.3f} of {names[first]} and {names[second]}")
    open_directions = summary["not_determined"]
    for direction in open_directions[:LISTED]:
        print(f"  not determined     {direction}")
    if len(open_directions) > LISTED:
        print(f"                     and {len(open_directions) - LISTED} more directions")
    if summary["left_out"]:
        print(f"  left out           {counted(summary['left_out'])}")
    for label, problem, rows in (("misfits", "fit far worse than the others", summary["misfits"]),
                                 ("other branch", "than the observation leads to", summary["other_branch"])):
        if len(rows):
            more = f" and {len(rows) - LISTED} more" * (len(rows) > LISTED)
            print(f"  {label:<18} {problem}: {', '.join(map(str, rows[:LISTED]))}{more}")


def _interval(value: float, low: float, high: float) -> str:
    return f"{value:.4g} ({low:.3g} .. {high:.3g})"
