"""What ``--theta`` and ``--dynamic`` give the commands: rest curvature, and friction, damping, drag and time steps of moving
rods."""

from argparse import Namespace
from dataclasses import replace

import numpy as np

from doo_ti.commands import options as given
from doo_ti.contact.surroundings import Surroundings
from doo_ti.rod.types import Material
from doo_ti.system.errors import InputError

LOSSES = {"bend_damping": "s", "twist_damping": "s", "drag": "1/s", "quadratic_drag": "1/mm"}
STEPS = ("rate", "substeps", "tolerance")
SUBSTEPS = 1
"""Of predictions, unless given."""
MOST_STRETCH = 0.1
"""By which the rod's length may differ from that of THETA.json."""


def add_dynamic(parser, rate: str) -> None:
    """The options of rods with inertia; ``rate`` says what --rate is the number of, and its default."""
    group = parser.add_argument_group("inertia", "for fast motion (docs/dynamics.md); the default is statics at every instant")
    group.add_argument("--dynamic", action="store_true", help="rods have inertia, and losses as --theta or these options say")
    group.add_argument("--rate", metavar="HZ", help=rate)
    group.add_argument("--substeps", metavar="N", help=f"time steps between the states that are returned (default {SUBSTEPS})")
    group.add_argument("--tolerance", metavar="MM", help="double them for each rod until the estimated error is below this")
    group.add_argument("--bend-damping", metavar="S", help="bending at the rate ω̇ is resisted by S B ω̇ (default 0)")
    group.add_argument("--twist-damping", metavar="S", help="the same of twist (default 0)")
    group.add_argument("--drag", metavar="C", help="force −C v on each unit of mass, 1/s (default 0)")
    group.add_argument("--quadratic-drag", metavar="C2", help="force −C2 |v| v, 1/mm (default 0)")


def is_dynamic(options: Namespace) -> bool:
    """Whether rods have inertia. Raises InputError where only options of such rods are given."""
    if not options.dynamic:
        for name in (*STEPS, *LOSSES):
            if getattr(options, name, None) is not None:
                raise InputError(given.SOURCE, f"--{name.replace('_', '-')}", "given without --dynamic", "give both")
    return options.dynamic


def stepping(options: Namespace, rate: float):
    """The time steps of a motion with ``rate`` returned states per second."""
    from doo_ti.dynamics.parameters import Stepping

    return Stepping(rate, given.whole("--substeps", options.substeps, 1, 1000) or SUBSTEPS,
                    tolerance=given.length("--tolerance", options.tolerance))


def step_summary(names: list[str], substeps: np.ndarray, error: np.ndarray, tolerance: float) -> dict:
    """What the summaries say of the time steps (R,) of rods whose ``error`` (R,) was estimated."""
    used, rods = np.unique(substeps, return_counts=True)
    return {"substeps": {str(n): int(rod) for n, rod in zip(used, rods, strict=True)},
            "above_tolerance": int((~(error <= tolerance)).sum()), "step_error_mm": dict(zip(names, error, strict=True))}


def step_lines(summary: dict, between: str) -> list[str]:
    """:func:`step_summary` as text; ``between`` says from where to where the steps are counted. Nothing without an estimate."""
    if "step_error_mm" not in summary:
        return []
    error = np.array(list(summary["step_error_mm"].values()))
    steps = ", ".join(f"{n} for {rods}" for n, rods in summary["substeps"].items())
    return [f"  time steps  {steps} rods {between}; estimated error: median {np.median(error):.3g}, largest "
            f"{error.max():.3g} mm, above the tolerance in {summary['above_tolerance']} rods"]


def losses(options: Namespace):
    """Damping, drag and the mass of markers, of ``--theta`` but for what the options give."""
    from doo_ti.dynamics.parameters import Dynamics
    from doo_ti.dynamics.theta import load_theta, simulated

    found = Dynamics()
    if options.theta is not None:
        found = simulated([load_theta(options.theta)])[1]
    own = {name: given.not_negative(f"--{name.replace('_', '-')}", getattr(options, name), unit)
           for name, unit in LOSSES.items() if getattr(options, name) is not None}
    return replace(found, **own)


def rubbed(options: Namespace, surroundings: Surroundings) -> Surroundings:
    """The surroundings with the friction that ``--theta`` states, if it does."""
    if options.theta is None:
        return surroundings
    from doo_ti.dynamics.theta import load_theta

    friction = load_theta(options.theta).friction
    if friction is None:
        return surroundings
    use = "that of all obstacles" if surroundings.bodies else "ignored without obstacles"
    options.friction_note = f"; its friction of {friction:.3g} is {use}"
    return surroundings.rubbing(friction)


def require_length(source, theta, length: float) -> None:
    """Raise InputError, naming the file ``source`` of ``theta``, where that is of a rod of another ``length``, mm."""
    own = float(np.sum(theta.rest_length))
    if abs(length - own) > MOST_STRETCH * own:
        raise InputError(source, "rest_length_mm", f"{own:.4g} mm in all, the rods are {length:.4g} mm long",
                         "give the theta of this rod, or the unit of the lengths")


def curved(options: Namespace, material: Material, rest_length: np.ndarray, moving: bool = False) -> Material:
    """The material with what ``--theta`` says of its rest curvature, at the joints of rods of ``rest_length`` (E,), and of rods
    that move of its own weight, that of markers apart. Raises InputError where the rod has another length."""
    if options.theta is None:
        return material
    from doo_ti.dynamics.theta import load_theta

    theta = load_theta(options.theta)
    require_length(options.theta, theta, float(np.sum(rest_length)))
    weight = material.weight * (1.0 - theta.marker_share) if moving else material.weight
    rest = theta.rest_curvature_at(rest_length) if theta.rest.any() else None
    return Material(material.bend, material.twist, weight, None if rest is None else rest[None])
