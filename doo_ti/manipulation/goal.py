"""Rods at rest that are nearest to targets, and the grippers' poses that hold them there. Axes: B rods, K guesses of each."""

from dataclasses import dataclass, replace

import numpy as np

from doo_ti.contact.surroundings import Surroundings
from doo_ti.manipulation.damped_step import DampedSteps
from doo_ti.manipulation.poses import finite_rods, held, joined, moved, put_rods, put_rows, slack
from doo_ti.manipulation.resynchronise import stiffness_of
from doo_ti.manipulation.targets import ServoOptions, Targets
from doo_ti.relaxation.external import Springs
from doo_ti.relaxation.newton import Newton
from doo_ti.relaxation.relax import relax
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
from doo_ti.rod.types import Clamp, Clamps, Configuration, Material, Solution

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
class Model:
    """Models of B rods: what they are made of, how clips hold them (:func:`.poses.held`), and what surrounds them."""

    material: Material
    clip: np.ndarray
    up: np.ndarray
    surroundings: Surroundings

    def relaxed(self, rods: Configuration, clamps: Clamps) -> Solution:
        """The rods at rest under the grippers' poses."""
        return relax(rods, self.material, held(clamps, self.clip), Newton.careful(), up=self.up, **self.surroundings.arguments)

    def take(self, rods: np.ndarray) -> "Model":
        """Those of the rods named by ``rods``."""
        return Model(self.material.take(rods), self.clip[rods], self.up, self.surroundings.take(rods))


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
        """Those of the rods named by ``rods``."""
        return Goal(self.rods.take(rods), self.clamps.take(rods), self.distance[rods])


def nearest_goal(rods: Configuration, clamps: Clamps, model: Model, targets: Targets, options: ServoOptions) -> Goal:
    """The rods' goals: of several guesses, each drawn to its target and fitted, those that come nearest."""
    count = rods.count
    drawn, grippers = _guesses(rods, clamps, model, targets, options)
    rows = np.tile(np.arange(count), GUESSES)
    fitted = fit(drawn, grippers, model.take(rows), targets.take(rows), options)
    best = np.argmin(fitted.distance.reshape(GUESSES, count), axis=0) * count + np.arange(count)
    return fitted.take(best)


def all_goals(rods: Configuration, clamps: Clamps, model: Model, targets: Targets, options: ServoOptions) -> Goal:
    """The goals of one rod that all guesses lead to, the nearest first."""
    drawn, grippers = _guesses(rods, clamps, model, targets, options)
    rows = np.zeros(GUESSES, dtype=np.int64)
    fitted = fit(drawn, grippers, model.take(rows), targets.take(rows), options)
    return fitted.take(np.argsort(fitted.distance, kind="stable"))


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
        columns = sensitivity(solution, GRIPPERS, rotations=False, loads=False).vertices
        columns = np.nan_to_num(columns)
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
    count = rods.count
    starts, ends = ({f"{end}_shift", f"{end}_turn"} <= set(options.free) for end in ("start", "end"))
    loose = replace(held(clamps, model.clip), start=Clamp.FREE if starts else clamps.start,
                    end=Clamp.FREE if ends else clamps.end)
    seen = targets.shares > 0
    springs = Springs(targets.places, seen * stiffness_of(model.material, rods.rest_length, seen)[:, None])
    drawn = relax(rods, model.material, loose, Newton.careful(), up=model.up, external=springs, external_index=np.arange(count))
    shapes = finite_rods(drawn.configuration, rods)
    first = clamps.start_frame
    if starts:
        along = tangent_from_quaternion(shapes.quaternions[:, 0])
        first = matrix_from_quaternion(smallest_rotation(first[..., 0], along)) @ first
    frames = quaternion_from_matrix(bishop_frames(tangent_from_quaternion(shapes.quaternions), first[..., 1]))
    place = np.linspace(0.0, 1.0, rods.edges)
    twist = total_twist(rods.quaternions)
    every = []
    for more in TWISTS:
        own = np.broadcast_to([1.0, 0.0, 0.0], (count, rods.edges, 3))
        every.append(quaternion_product(frames, quaternion_about(own, (twist + more)[:, None] * place)))
    rows = np.tile(np.arange(count), len(TWISTS))
    guessed = Configuration(shapes.start[rows], np.concatenate(every), rods.rest_length)
    grippers = clamps.take(rows)
    matrices, vertices = guessed.frames, guessed.vertices
    if starts:
        grippers = replace(grippers, start_position=vertices[:, 0].copy(), start_frame=matrices[:, 0].copy())
    if ends:
        grippers = replace(grippers, end_position=vertices[:, -1].copy(), end_frame=matrices[:, -1].copy())
    return Configuration.concatenate([rods, guessed]), joined([clamps, grippers])


def _distance(solution: Solution, targets: Targets) -> np.ndarray:
    """(B,) mm, infinite for rods that are not at certified rest."""
    sound = solution.converged & solution.stable
    return np.where(sound, targets.distance(np.nan_to_num(solution.configuration.vertices)), np.inf)
