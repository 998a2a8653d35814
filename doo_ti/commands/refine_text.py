"""The output of ``doo-ti refine``: a summary as JSON, and lines of text made of it."""

from dataclasses import asdict
from functools import partial

import numpy as np

from doo_ti.commands import results
from doo_ti.commands.loading import up_text
from doo_ti.contact.obstacle_file import described
from doo_ti.contact.surroundings import Surroundings
from doo_ti.rod.material import relative_stiffness, stiffness
from doo_ti.rod.observations import Observations
from doo_ti.system.terminal import in_line

LISTED = 6  # observations named individually
CLEAR_ODDS = 1.0  # ln of the odds, about 3 to 1: models closer than that predict as well
DECISIVE = 30.0  # rise of twice the log evidence
STRAIGHT = 1e-6  # 1/mm: a radius of a kilometre
_rows = partial(results.rows, width=19)
SYMBOLS = {"bend": "EI", "bend_1": "EI_1", "bend_2": "EI_2", "twist": "GJ"}
MODELS = {"straight": "straight at rest", "curved": "curved at rest",
          "ribbon": "as fitted, bend stiffness different about m1 and m2"}


def summary_of(observations: Observations, surroundings: Surroundings, found, held_out, density: float | None,
               loaded: bool = False) -> dict:
    """A :class:`doo_ti.refinement.refine.Refinement` as JSON holds it.

    held_out  a :class:`doo_ti.refinement.folds.HeldOut`, or None
    density   of the rod in g/m, or None
    loaded    whether bodies of known mass hang at the marks: then ``density`` is that of the weight one
    """
    estimate, scales = found.estimate, found.estimate.scales
    names, rest, along = estimate.names, found.theta.rest_curvature, estimate.stiffness_along
    pairs = [(first, second) for k, first in enumerate(names) for second in names[k + 1 :]
             if not (first.startswith("up") or second.startswith("up"))]
    constant = estimate.values.constant.reshape(2, 2, 3)
    densities = None if density is None else [density] * 3
    if density is not None and loaded and "weight" in names:  # with its interval, learned
        densities = [None if end is None else density * end for end in _ends(estimate.parameter("weight"))]
    outer = {"clip_start": observations.rest_length[:2], "clip_end": observations.rest_length[-2:]}
    summary = {
        "material": observations.name, "source": observations.source, "observations": observations.count,
        "theta": _theta(found.theta), "parameters": [asdict(parameter) for parameter in estimate.parameters],
        "unknowns": names, "covariance": estimate.covariance, "correlation": estimate.correlation,
        "degrees_of_freedom": estimate.degrees, "not_determined": estimate.left_open,
        "long_clips": [one.name for one in estimate.parameters if one.name in outer and one.value > outer[one.name].sum()],
        "stiffness": _stiffness(estimate, density, loaded), "loaded": loaded,
        "linear_density_g_per_m": densities,
        "rest_curvature_per_mm": {"spread": scales["curvature"], "range_mm": scales["range"],
                                  "root_mean_square": 0.0 if rest is None else float(np.sqrt((np.asarray(rest) ** 2).mean()))},
        "stiffness_along": {"factor": along, "root_mean_square": float(np.sqrt((np.log(along) ** 2).mean()))},
        "clamp_errors": {"turn_deg": np.degrees(np.linalg.norm(constant, axis=-1)).max(axis=0),
                         "turn_scatter_deg": float(np.degrees(scales["turn_scatter"]))},
        "tilt_deg": float(np.degrees(np.arccos(np.clip(np.dot(found.theta.up, observations.up), -1.0, 1.0)))),
        "sigma_mm": found.adequacy.noise, "sigma_stated": found.adequacy.stated, "excess": found.adequacy.excess,
        "gap_mm": found.adequacy.gap, "neighbour_correlation": found.adequacy.correlation,
        "reaches_noise": found.adequacy.reaches_noise,
        "turns_open": all((observations.total_twist is None, observations.start_frame is not None,
                           observations.end_frame is not None, observations.frames is None)),
        "advice": [asdict(one) | {"option": "--" + one.option.replace("_", "-").replace("=", " ")}
                   for one in found.adequacy.advice],
        "sensitive": [{"observation": observations.labels[one.observation], "parameter": one.parameter, "factor": one.factor}
                      for one in found.adequacy.influences],
        "models": [asdict(score) for score in found.scores],
        "obstacles": described(surroundings) if surroundings else None, "mesh_edges": found.mesh_edges,
        "mesh_correction_mm": found.mesh_error,
        "mean_distance_mm": found.mean_distance, "distance_mm": found.distance, "rods_used": int(found.used.sum()),
        "left_out": found.reasons, "misfits": observations.labels[np.flatnonzero(found.misfits)],
        "mislabelled": [{"observation": observations.labels[one.observation], "why": one.text} for one in found.mislabelled],
        "swivels": found.swivels, "turns_ignored": found.turns_ignored,
        "roll_kept_deg": found.roll_kept and np.degrees(found.roll_kept),
        "rivals": [_theta(theta) for theta in estimate.rivals], "converged": found.converged,
        "iterations": found.steps,
        "regions": [{"parameters": pair, "outline": estimate.region(*pair)} for pair in pairs],
        "held_out": None if held_out is None else {
            "fold": held_out.fold, "distance_mm": held_out.distance, "mean_distance_mm": held_out.mean_distance,
            "standard_error_mm": held_out.standard_error, "sound": int(held_out.sound.sum()),
            "theta": [_theta(one.theta) for one in held_out.refinements]},
    }
    return summary | {"cautions": cautions(summary)}


def cautions(summary: dict) -> list[str]:
    """What to beware of in a result, from the other entries of its summary."""
    found, touched = [], summary["obstacles"] is not None
    if summary.get("turns_ignored"):
        found.append("total_twist_deg was left out: other whole turns fit better; check it")
    if _curved(summary) and "twist" not in summary["unknowns"]:
        found.append("bend stiffness of a curved rod depends on twist stiffness, which was not learned: give --parameters "
                     "bend,twist")
    found += [f"{name} ends beyond two more marks: if nothing holds them, check {'the obstacles and --radius' * touched}"
              f"{'the clamps' * (not touched)}, or give --clip MM" for name in summary.get("long_clips", ())]
    if any(one["name"] == "bend" and one["high"] is None for one in summary["parameters"]):
        found.append("as fitted, its weight hardly bends the rod: check --up, or hang it so that it sags")
    return found


def _theta(theta) -> dict:
    return {"bend_1": theta.bend[0, 0], "bend_2": theta.bend[1, 1], "bend_12": theta.bend[0, 1], "twist": theta.twist,
            "weight": theta.weight, "rest_curvature": theta.rest_curvature, "up": theta.up}


def _stiffness(estimate, density: float | None, loaded: bool) -> dict:
    """Stiffness over weight per length in mm³, and with a linear density in N m²: value, low, high, None where open."""
    result = {}
    for parameter in estimate.over_weight:
        symbol = SYMBOLS[parameter.name]
        result[f"{symbol}_over_weight_mm3"] = _ends(parameter)
        if density is not None:
            own = _ends(parameter)
            if loaded:  # forces are known, whatever the rod weighs
                own = [None if end is None else float(relative_stiffness(end, 1.0))
                       for end in _ends(estimate.parameter(parameter.name))]
            result[f"{symbol}_Nm2"] = [None if end is None else stiffness(end, density) for end in own]
    return result


def _ends(parameter) -> list[float | None]:
    return [parameter.value, parameter.low, parameter.high]


def summary_lines(summary: dict) -> list[str]:
    """The summary as lines of text."""
    from doo_ti.refinement.adequacy import UNROUND

    curvature, errors = summary["rest_curvature_per_mm"], summary["clamp_errors"]
    touched, held, varied = summary["obstacles"], summary["held_out"], summary["stiffness_along"]
    factor = varied["factor"]
    low, high = int(np.argmin(factor)), int(np.argmax(factor))
    (x, y, z), (start, end) = summary["theta"]["up"], errors["turn_deg"]
    own, *bends = (f"{theta['bend_1']:.3g}" for theta in (summary["theta"], *summary["rivals"]))
    rivals = ", ".join(bend for bend in dict.fromkeys(bends) if bend != own)
    curved = _curved(summary)
    unround = next((one["option"] for one in summary["advice"] if one["meaning"] == UNROUND and one["gain"] > DECISIVE), None)
    interval = partial(interval_text, summary["converged"])
    elsewhere = "at more cells (--starts N)" if summary["of_run"] else "at the run of a sweep (doo-ti sweep first)"
    elsewhere = "from other values (sweeps know no --mass)" if summary["loaded"] else elsewhere
    return [
        f"{in_line(summary['material'])}: {summary['rods_used']} of {summary['observations']} observations, "
        f"{summary['iterations']} steps{'' if summary['converged'] else ', NOT converged: stopped'}", *_rows(
            ("stopped", not summary["converged"] and
             f"before its optimum: values and intervals may be far off. Begin {elsewhere}, or with fewer unknowns (--clip MM, "
             "--clamps exact, --rest-curvature none, fewer --parameters)"),
            ("WARNING", up_text(summary["other_up"])), ("WARNING", unround and f"{UNROUND} explains the marks "
             f"far better; the intervals are those of a round rod: give {unround}"),
            *((one["name"], interval(one["value"], one["low"], one["high"], one["unit"])
               + "  (negative: outside the outer mark)" * (one["name"].startswith("clip") and one["value"] < 0))
              for one in summary["parameters"] if not one["name"].startswith("up[")),
            ("up", "up[0]" in summary["unknowns"] and
             f"({x:.4f}, {y:.4f}, {z:.4f}), tilted by {summary['tilt_deg']:.2g}° from the given direction"),
            *((name.removesuffix("_Nm2"), interval(*ends, "N m²")) if name.endswith("_Nm2") else
              (f"{name.removesuffix('_over_weight_mm3')} over weight", interval(*ends, "mm³"))
              for name, ends in summary["stiffness"].items()),
            ("linear density", "weight" in summary["unknowns"] and summary["linear_density_g_per_m"] and
             interval(*summary["linear_density_g_per_m"], "g/m")),
            ("", summary["converged"] and "95 % intervals, with everything else fitted again"),
            ("as probable", rivals and f"other fits of the same marks, with bend {rivals} mm³: the intervals contain them"),
            ("rest curvature", curvature["root_mean_square"] and (
                f"{curvature['root_mean_square']:.3g} 1/mm (root mean square), over a range of {curvature['range_mm']:.3g} mm"
                if curved else "none: straight at rest")),
            ("along the rod", varied["root_mean_square"] and
             f"bend stiffness varies by {varied['root_mean_square']:.0%} (root mean square), from {factor[low]:.3g} times the "
             f"value above at mark {low} to {factor[high]:.3g} times at mark {high}, counted from 0"),
            *(("caution", text) for text in cautions(summary)),
            ("ends", summary["swivels"] and
             "fit best as free to roll in what holds them; if clips held them, give their frames"),
            ("ends", summary["roll_kept_deg"] and f"fit best as held at one roll in all observations, within "
                                                  f"{summary['roll_kept_deg']:.2g}°"),
            ("frames", max(start, end) > 0 and f"off by {start:.2g}° (start) and {end:.2g}° (end); "
                                               f"{errors['turn_scatter_deg']:.2g}° between observations"),
            ("obstacles", touched and f"{', '.join(touched['kinds'])}; rods of radius {touched['radius_mm']:g} mm"),
            ("distance", f"mean {summary['mean_distance_mm']:.4g} mm (Eq. 1)")),
        *_adequacy_lines(summary), *_rods_lines(summary), *_models_lines(summary), *_rows(
            ("held out", held and f"mean {held['mean_distance_mm']:.4g} ± {held['standard_error_mm']:.2g} mm over "
                                  f"{held['sound']} rods in {len(held['theta'])} folds (Eq. 1)"))]


def _curved(summary: dict) -> bool:
    """Whether the rod was found to be curved at rest."""
    return summary["rest_curvature_per_mm"]["root_mean_square"] >= STRAIGHT


def interval_text(converged: bool, value: float, low: float | None, high: float | None, unit: str) -> str:
    """A value with its interval; bounded on one side only that bound; else that it is not determined. Where a fit has stopped
    the value alone: its interval would be that of another place."""
    from doo_ti.refinement.estimate import WIDE_FACTOR

    if not converged:
        return f"{value:.4g} {unit}".rstrip() + "  (no interval: not converged)"
    if low is None and high is None:
        return "not determined"
    if high is None:
        return f"at least {low:.3g} {unit}".rstrip()
    if low is None:
        return f"at most {high:.3g} {unit}".rstrip()
    wide = f"  (wide: more than a factor of {WIDE_FACTOR:g})" if low > 0 and high > WIDE_FACTOR * low else ""
    return f"{value:.4g} ({low:.4g} .. {high:.4g}) {unit}".rstrip() + wide


def _adequacy_lines(summary: dict) -> list[str]:
    from doo_ti.refinement.adequacy import EXCESS, TOGETHER

    source = "stated" if summary["sigma_stated"] else "learned"
    if summary["reaches_noise"] and summary["neighbour_correlation"] > TOGETHER:
        left = ("no larger than the noise, but neighbouring marks are off together (correlation "
                f"{summary['neighbour_correlation']:.2g}), for instance by an error of calibration; intervals leave that out")
    elif summary["reaches_noise"]:
        left = "only noise is left"
    elif summary["sigma_stated"] and summary["excess"] > EXCESS:
        left = f"{summary['excess']:.3g} times the stated noise: it is larger, or the model lacks something"
    else:
        left = (f"besides the noise the model is off by {summary['gap_mm']:.3g} mm, smoothly along the rod; intervals are "
                "wider by that, as if it were independent in each observation")
    helpless = not summary["reaches_noise"] and not summary["advice"] and summary["other_up"] is None
    turns = ", total_twist_deg of rods that may be twisted by whole turns" * summary["turns_open"]
    return _rows(
        ("noise", f"{summary['sigma_mm']:.3g} mm per coordinate ({source})"), ("residuals", summary["converged"] and left),
        *(("try", f"{one['option']} ({one['meaning']}: twice the log evidence rises by {one['gain']:.3g})")
          for one in summary["advice"][:2]),
        ("try", helpless and "nothing that refine can learn besides explains it alone: state less (--clip, --frames, "
                             f"--spacing-error), check the misfits, --up, --sigma{turns}, and how the marks were made"))


def _rods_lines(summary: dict) -> list[str]:
    """The observations that were left out, those that do not fit, and those that a result rests on."""
    misfits = results.listed(summary["misfits"], LISTED)
    return _rows(
        ("left out", results.status_text(summary["left_out"])),
        ("misfits", misfits and f"observation {misfits}: far from every equilibrium that was tried"),
        *(("mislabelled", f"observation {one['observation']}: {one['why']}") for one in summary["mislabelled"]),
        *(("sensitive", f"without observation {one['observation']} {one['parameter']} would be {one['factor']:.3g} times as "
                        "large: more than two standard errors away") for one in summary["sensitive"][:LISTED]))


def _models_lines(summary: dict) -> list[str]:
    verdicts = []
    for score in summary["models"]:
        if score["model"] == "straight" and not _curved(summary):
            continue  # as fitted
        clear = abs(score["difference"]) > max(2 * score["error"], CLEAR_ODDS)
        verdict = "predicts as well" if not clear else "predicts better" if score["difference"] > 0 else "predicts worse"
        verdicts.append(f"{verdict}: {MODELS[score['model']]} ({score['difference']:+.3g} ± {score['error']:.2g}, "
                        "leave-one-out log score)")
    return _rows(*zip(["other models"] + [""] * len(verdicts), verdicts))
