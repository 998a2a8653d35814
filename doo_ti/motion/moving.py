"""Prediction of fast motion: rods with inertia, damping and drag whose clamps move along a path (§III-D, docs/dynamics.md).

Axes: T moments, G materials, N motions, R = G·N rods, material by material.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike

from doo_ti.contact.moving import Moving
from doo_ti.contact.obstacles import Obstacle
from doo_ti.contact.surroundings import Surroundings, obstacle_list
from doo_ti.dynamics.grippers import Grippers
from doo_ti.dynamics.parameters import Dynamics, Stepping
from doo_ti.dynamics.paths import refined_within_reach
from doo_ti.dynamics.simulate import simulate
from doo_ti.io.motion_file import ClampPath
from doo_ti.motion.path import LARGEST_TURN, motion_between
from doo_ti.motion.predict import Prediction, begun, rotation_about_rod
from doo_ti.relaxation.newton import Newton
from doo_ti.relaxation.point_loads import PointLoads
from doo_ti.rod.frames import edge_frames
from doo_ti.rod.types import POSES, Clamps, Configuration, Material, Status, sticky
from doo_ti.system.arguments import typed
from doo_ti.system.errors import InputError

MOST_TURN = np.radians(170.0)  # of the far frame between two moments: its sense is taken from the shorter way
EVEN = 1e-3  # of an interval: by how much the intervals between moments may differ


@typed
def predict_moving(
    configuration: Configuration, material: Material, clamps: Clamps, path: ClampPath, dynamics: Dynamics, stepping: Stepping,
    *, between: int = 1, up: ArrayLike = (0.0, 0.0, 1.0), advance: Callable[[int], None] = lambda rods: None,
    obstacles: Sequence[Obstacle | Moving] = (), radius: ArrayLike | None = None, loads: PointLoads | None = None,
) -> Prediction:
    """As :func:`doo_ti.motion.predict.predict`, with inertia: rods at rest at the path's first moment, then carried along
    it at the speed that the rate gives it.

    dynamics  of G rows or one
    stepping  rate: moments of the path per second; the time steps are between the states that are returned. Quasi-static steps
              have friction without inertia
    between   number of returned states per interval of the path; clamps move between its moments on cubics
    obstacles, radius  as in :func:`doo_ti.dynamics.simulate.simulate`, with friction; a :class:`.Moving` has the instants of
              the states that are returned. On the way to the path's first moment there is no friction, and nothing moves
    loads     forces and masses at the vertices, of R rows or one

    In what is returned ``stable`` says that all steps have converged, since a rod in motion is at no minimum; ``energy`` is
    without the kinetic energy, and ``jumps`` are counted only on the way to the first moment. Raises InputError where numbers
    of rods and motions do not match, and for a far frame that turns by half a turn or more from one moment to the next.
    """
    even = path.states(between)
    _, rods, (first, held, jumps) = begun(configuration, material, clamps, path, LARGEST_TURN, up, Newton(), "f64",
                                         Surroundings(obstacle_list("predict_moving", obstacles, True), radius).at(0), loads)
    rows = np.arange(len(rods)) % len(clamps.start_position)
    lengths = configuration.rest_length if configuration.rest_length.ndim == 1 else configuration.rest_length[: rows.max() + 1]
    grippers = refined_within_reach(grippers_along(path, held), between, lengths)
    rate, done = stepping.rate * between, 0

    def progress(frames: int) -> None:
        nonlocal done
        advance((frames - done) * len(rods))
        done = frames

    found = simulate(first.configuration, material, grippers.take(rows), dynamics,
                     replace(stepping, rate=rate, detailed=True), up=up, pairs=(np.arange(len(rods)), rods), progress=progress,
                     obstacles=obstacles, radius=radius, loads=loads)
    energies = found.detail.energies
    stored = sum(energies[name] for name in ("bending", "twist", "gravity", "springs", "loads") if name in energies)
    status = sticky(first.status[:, None], found.status).T
    turned = [np.zeros(len(rows))]
    for k in range(grippers.instants - 1):
        turned.append(turned[-1] + rotation_about_rod(motion_between(grippers.at(k), grippers.at(k + 1)))[rows])

    time = even if stepping.quasi_static else np.arange(grippers.instants) / rate + path.time[0]

    def with_first(before, after):
        return np.concatenate([before[None], np.moveaxis(after, 1, 0)])

    return Prediction(
        time=time,
        start=with_first(first.configuration.vertices[:, 0], found.positions[:, :, 0]),
        quaternions=np.moveaxis(found.detail.quaternions, 1, 0), rest_length=configuration.rest_length.copy(),
        energy=first.energy + (stored - stored[:, :1]).T, residual=with_first(first.residual, found.residual),
        iterations=with_first(first.iterations, found.iterations), status=np.concatenate([first.status[None], status]),
        stable=np.concatenate([first.stable[None], status == Status.CONVERGED]),
        end_force=with_first(first.end_force, found.end_force),
        jumps=np.concatenate([jumps[None], np.zeros((grippers.instants - 1, len(rows)), dtype=jumps.dtype)]),
        end_rotation=np.stack(turned), material=rods, motion=rows,
        contact_force=None if found.contact_force is None else with_first(first.contact_force, found.contact_force),
        substeps=found.substeps, step_error=None if stepping.tolerance is None else found.error)


def rate_of(path: ClampPath) -> float:
    """Moments per second. Raises InputError where they are not equally far apart."""
    step = np.diff(path.time)
    if np.ptp(step) > EVEN * step.mean():
        raise InputError(path.source, "time_s", f"moments {step.min():.4g} to {step.max():.4g} s apart",
                         "give equal intervals for rods with inertia")
    return float(1.0 / step.mean())


def grippers_along(path: ClampPath, held: Clamps) -> Grippers:
    """The grippers of N motions at the moments of ``path``, ``held`` at the first."""
    turns = [path.rotation(k, len(held.start_position)) for k in range(path.moments - 1)]
    if turns[0] is not None and np.abs(turns).max() > MOST_TURN:
        raise InputError(path.source, "end_rotation", f"{np.degrees(np.abs(turns).max()):.0f} degrees between two moments",
                         f"give moments in between: at most {np.degrees(MOST_TURN):.0f} degrees for rods with inertia")
    clamps = [path.at(k, held) for k in range(path.moments)]
    found = {name: np.stack([getattr(one, name) for one in clamps], axis=1) for name in POSES}
    if path.tangents_only:
        for name in ("start_frame", "end_frame"):
            found[name] = edge_frames(found[name][..., 0], getattr(held, name)[..., 1])
    return Grippers(held.start, held.end, **found)
