"""Rods at rest that are nearest to targets, and the grippers' poses that hold them there. Axes: B rods, K guesses of each."""

from dataclasses import dataclass, replace

import numpy as np

from doo_ti.manipulation.dense_kernels import damped_steps, normal_equations
from doo_ti.manipulation.model import Model, drawn_to
from doo_ti.manipulation.poses import finite_rods, held, moved, put_rods, put_rows, slack
from doo_ti.manipulation.targets import ServoOptions, Targets
from doo_ti.relaxation.sensitivity import GRIPPERS, sensitivity
from doo_ti.rod.frames import (
    bishop_frames,
    matrix_from_quaternion,
    quaternion_about,
    quaternion_from_matrix,
    quaternion_product,
    smallest_rotation,
    tangent_from_quaternion,
    total_twist,
)
from doo_ti.rod.types import Clamp, Clamps, Configuration, Solution

TWISTS = np.radians([0.0, 90.0, -90.0, 180.0, -180.0, 270.0, -270.0, 360.0, -360.0])
"""By which guesses are twisted more than the rod is. Marks do not show twist; the fit finds it within a quarter turn."""
GUESSES = 1 + len(TWISTS)
"""Of each rod: itself as it is, and drawn to its target under each twist."""
ITERATIONS = 20
"""Of the fit of the grippers' poses."""
LONGEST = 40.0
"""mm, of a step of that fit, shifts in mm and turns times the lever."""
SHRINK, GROW = 0.3, 2.0
"""Of a step's length after it has been refused, and taken."""


@dataclass(frozen=True)
class DampedSteps:
    """Steps u of damped least squares (Levenberg, Marquardt): min |e − J u|² + λ |u|², λ so large that |u| ≤ a given length.

    normal    (B, K, K) JᵀJ
    gradient  (B, K) Jᵀe
    """

    normal: np.ndarray
    gradient: np.ndarray

    @classmethod
    def towards(cls, targets: Targets, shapes: np.ndarray, columns: np.ndarray, first: int, options: ServoOptions
                ) -> "DampedSteps":
        """Steps of the grippers, in mm, that bring ``shapes`` (B, V, 3) to their targets; the twelve ``columns`` (B, V, 3, C)
        from ``first`` on are the derivatives of the shapes by the grippers' coordinates."""
        normal, gradient = normal_equations(columns, first, len(options.scale), targets.shares, targets.places - shapes)
        unit = options.moves / options.scale
        return cls(normal * np.outer(unit, unit), gradient * unit)

    def within(self, length: np.ndarray) -> np.ndarray:
        """(B, K) the steps of at most ``length`` (B,), zero where that is."""
        return damped_steps(self.normal, self.gradient, length, np.zeros_like(self.gradient), np.zeros_like(length))

    def below(self, length: np.ndarray, across: np.ndarray, room: np.ndarray) -> np.ndarray:
        """(B, K) the steps of at most ``length`` (B,) whose product with ``across`` (B, K) is at most ``room`` (B,): where that
        of :meth:`within` is more, the best of those that have just that (one active constraint)."""
        return damped_steps(self.normal, self.gradient, length, across, room)


@dataclass(frozen=True)
class Goal:
    """B rods at certified rest near their targets.

    rods      B
    clamps    the grippers' poses, B
    distance  (B,) mm, weighted root mean square; infinite where no guess has come to rest
    """

    rods: Configuration
    clamps: Clamps
    distance: np.ndarray

    def take(self, rods: np.ndarray) -> "Goal":
        """The goals of the rods named by ``rods``."""
        return Goal(self.rods.take(rods), self.clamps.take(rods), self.distance[rods])


def nearest_goal(rods: Configuration, clamps: Clamps, model: Model, targets: Targets, options: ServoOptions) -> Goal:
    """The rods' goals: of several guesses, each drawn to its target and fitted, those that come nearest."""
    fitted = _fitted_guesses(rods, clamps, model, targets, options)
    best = np.argmin(fitted.distance.reshape(GUESSES, rods.count), axis=0)
    return fitted.take(best * rods.count + np.arange(rods.count))


def all_goals(rods: Configuration, clamps: Clamps, model: Model, targets: Targets, options: ServoOptions) -> Goal:
    """The goals of one rod that all guesses lead to, the nearest first."""
    fitted = _fitted_guesses(rods, clamps, model, targets, options)
    return fitted.take(np.argsort(fitted.distance, kind="stable"))


def _fitted_guesses(rods: Configuration, clamps: Clamps, model: Model, targets: Targets, options: ServoOptions) -> Goal:
    """The goals (K·B) that all guesses lead to."""
    drawn, grippers = _guesses(rods, clamps, model, targets, options)
    rows = np.tile(np.arange(rods.count), GUESSES)
    return fit(drawn, grippers, model.take(rows), targets.take(rows), options)


def fit(rods: Configuration, clamps: Clamps, model: Model, targets: Targets, options: ServoOptions) -> Goal:
    """The rods that are nearest to their targets, from these on, by damped least squares in the grippers' poses
    (Levenberg, Marquardt); every one is certified."""
    solution = model.relaxed(rods, clamps)
    rods, distance = finite_rods(solution.configuration, rods), _distance(solution, targets)
    length, reach = np.full(rods.count, LONGEST), (rods.rest_length.sum(), rods.rest_length[0])
    for _ in range(ITERATIONS):
        rows = np.flatnonzero(length >= options.reached_mm * SHRINK)  # others have come as near as they can
        if not len(rows):
            break
        own, here, asked = model.take(rows), clamps.take(rows), targets.take(rows)
        solution = own.relaxed(rods.take(rows), here)
        columns = np.nan_to_num(sensitivity(solution, GRIPPERS, rotations=False, loads=False).vertices)
        vertices = solution.configuration.vertices
        shapes = np.where(np.isfinite(vertices), vertices, asked.places)
        step = DampedSteps.towards(asked, shapes, columns, 0, options).within(length[rows])
        there = moved(here, step / options.scale)
        tried = own.relaxed(rods.take(rows), there)
        nearer = _distance(tried, asked)
        loose = slack(there, *reach) >= np.minimum(slack(here, *reach), options.slack * reach[0])
        good = (nearer < distance[rows]) & loose
        length[rows] = np.where(good, np.minimum(GROW * length[rows], LONGEST),
                                SHRINK * np.minimum(length[rows], np.linalg.norm(step, axis=1)))
        taken, good = rows[good], np.flatnonzero(good)
        rods, clamps = put_rods(rods, taken, tried.configuration.take(good)), put_rows(clamps, taken, there.take(good))
        distance[taken] = nearer[good]
    solution = model.relaxed(rods, clamps)
    return Goal(finite_rods(solution.configuration, rods), clamps, _distance(solution, targets))


def _guesses(rods: Configuration, clamps: Clamps, model: Model, targets: Targets, options: ServoOptions
             ) -> tuple[Configuration, Clamps]:
    """(K·B) rods: as they are, then drawn to their targets by springs, twist by twist; and grippers that hold them so. A
    gripper that is not free to shift and turn stays."""
    starts, ends = ({f"{end}_shift", f"{end}_turn"} <= set(options.free) for end in ("start", "end"))
    loose = replace(held(clamps, model.clip), start=Clamp.FREE if starts else clamps.start,
                    end=Clamp.FREE if ends else clamps.end)
    shapes = drawn_to(rods, model.material, loose, targets.places, targets.shares > 0, model.up)
    first, tangents = clamps.start_frame, tangent_from_quaternion(shapes.quaternions)
    if starts:
        first = matrix_from_quaternion(smallest_rotation(first[..., 0], tangents[:, 0])) @ first
    frames = quaternion_from_matrix(bishop_frames(tangents, first[..., 1]))
    place, twist = np.linspace(0.0, 1.0, rods.edges), total_twist(rods.quaternions)
    own = np.broadcast_to([1.0, 0.0, 0.0], (rods.count, rods.edges, 3))
    every = [quaternion_product(frames, quaternion_about(own, (twist + more)[:, None] * place)) for more in TWISTS]
    rows = np.tile(np.arange(rods.count), len(TWISTS))
    guessed = Configuration(shapes.start[rows], np.concatenate(every), rods.rest_length)
    grippers = clamps.take(rows)
    matrices, vertices = guessed.frames, guessed.vertices
    if starts:
        grippers = replace(grippers, start_position=vertices[:, 0].copy(), start_frame=matrices[:, 0].copy())
    if ends:
        grippers = replace(grippers, end_position=vertices[:, -1].copy(), end_frame=matrices[:, -1].copy())
    return Configuration.concatenate([rods, guessed]), Clamps.concatenate([clamps, grippers])


def _distance(solution: Solution, targets: Targets) -> np.ndarray:
    """(B,) mm, infinite for rods that are not at certified rest."""
    sound = solution.converged & solution.stable
    return np.where(sound, targets.distance(np.nan_to_num(solution.configuration.vertices)), np.inf)
