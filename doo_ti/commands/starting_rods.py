"""Rods that start where observations show them, and are carried along by poses of grippers."""

from argparse import Namespace
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from doo_ti.commands import loading
from doo_ti.commands import options as given
from doo_ti.commands.moving_rods import curved, rubbed
from doo_ti.contact.surroundings import Surroundings
from doo_ti.io.motion_file import ClampPath
from doo_ti.io.observation_files import load_observations
from doo_ti.rod.observations import Observations
from doo_ti.rod.start import check_experiment, choose_hypothesis, observation_clamps, start_configuration, turn_hypotheses
from doo_ti.rod.types import Clamp, Clamps, Configuration, Material
from doo_ti.system.errors import InputError
from doo_ti.system.terminal import busy

if TYPE_CHECKING:
    from doo_ti.dynamics.grippers import Grippers
    from doo_ti.dynamics.parameters import Dynamics, Stepping

OF_MARKERS = ("fill_gaps", "smoothing", "columns")
"""Options of recordings."""


@dataclass(frozen=True)
class Moved:
    """What is to be simulated of R rods: arguments of :func:`doo_ti.dynamics.simulate.simulate`, and N in their unit of force,
    or None."""

    name: str
    names: list[str]
    start: Configuration
    material: Material
    grippers: "Grippers"
    dynamics: "Dynamics"
    stepping: "Stepping"
    up: np.ndarray
    pairs: tuple[np.ndarray, np.ndarray]
    surroundings: Surroundings
    newtons: np.ndarray | None


def from_observations(options: Namespace, out: Path, changes: dict) -> tuple[Moved, np.ndarray | float]:
    """The rods of ``--start``, at rest where the motion begins, and (R, V, 3) what they touch there."""
    from doo_ti.dynamics.parameters import Stepping
    from doo_ti.dynamics.theta import load_theta, simulated
    from doo_ti.motion.path import LARGEST_TURN
    from doo_ti.prediction.moving import grippers_along, rate_of
    from doo_ti.prediction.predict import begun
    from doo_ti.relaxation.newton import Newton

    wrong = next((name for name in OF_MARKERS if getattr(options, name)), None)
    if wrong is not None:
        raise InputError(given.SOURCE, f"--{wrong.replace('_', '-')}", "given, but the motion has no markers", "leave it out")
    for name in ("theta", "start"):
        if getattr(options, name) is None:
            raise InputError(given.SOURCE, f"--{name}", "missing, and the motion has no markers",
                             "give THETA.json of the rod, and observations from which it starts")
    for source in (options.source, options.start):
        given.refuse_overwriting(out, source)
    theta, surroundings = load_theta(options.theta), rubbed(options, given.surroundings(options))
    path, rate = loading.poses(options, options.source, options.unit), given.positive("--rate", options.rate, "per second")
    path = path if rate is None else path.resampled(rate)
    stepping = Stepping(rate_of(path), **changes)
    observations = with_frames(load_observations(options.start, given.up(options), options.unit), path)
    clamps = observation_clamps(observations, end=Clamp.FREE if options.free_end else None)
    whole, dynamics = simulated([theta])
    check_experiment(observations, clamps, float(np.max(whole.weight)), 0.0)
    material = curved(options, whole, observations.rest_length)
    with busy(f"relaxing {observations.count} rods (kernels are compiled once on a machine)"):
        start = settled(observations, clamps, material, surroundings.at(0))
        _, rows, (first, held, _) = begun(start, material, clamps, path, LARGEST_TURN, observations.up, Newton(), "f64",
                                          surroundings.at(0))
    failed = np.flatnonzero(~first.converged)
    if len(failed):
        raise InputError(options.start, "vertices_mm", f"observation {observations.labels[failed[0]]} has no equilibrium where "
                         "the motion begins", "let the motion begin where the rod is held, within its length")
    moved = Moved(observations.name, [f"observation {label}" for label in observations.labels], first.configuration, material,
                  grippers_along(path, held), dynamics, stepping, observations.up, (np.arange(observations.count), rows),
                  surroundings, given.newtons(options, material.weight))
    return moved, 0.0 if first.contact_force is None else first.contact_force


def with_frames(observations: Observations, path: ClampPath, relative: bool = False) -> Observations:
    """The observations with the frames of the path's first moment, where they have none of their own and the path has:
    the rods are held by them."""
    if path.tangents_only or relative:
        return observations
    frames = {name: np.broadcast_to(value[0], (observations.count, 3, 3)) for name, value in
              (("start_frame", path.start_frame), ("end_frame", path.end_frame))
              if value is not None and getattr(observations, name) is None and value.shape[1] in (1, observations.count)}
    return replace(observations, **frames)


def settled(observations: Observations, clamps: Clamps, materials: Material, surroundings: Surroundings) -> Configuration:
    """(G·N) the rods at the start, material by material: of several whole turns that fit, the one nearest to what was seen."""
    from doo_ti.relaxation.relax import relax
    from doo_ti.rod.metric import distance

    index, turns = turn_hypotheses(observations, clamps)
    starts = start_configuration(observations.take(index), clamps.take(index), turns)
    if len(index) == observations.count:
        return starts
    of_material, row = np.divmod(np.arange(materials.count * len(index)), len(index))
    solution = relax(starts, materials, clamps.take(index), up=observations.up, configuration_index=row,
                     material_index=of_material, **surroundings.arguments)
    score = distance(solution.configuration, observations, index[row])
    best = choose_hypothesis(of_material * observations.count + index[row], score, solution.converged & solution.stable)
    return starts.take(row[best])
