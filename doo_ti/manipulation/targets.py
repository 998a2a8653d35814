"""What a manipulation is to reach, which options it has, and its goals: the rods at rest that are nearest to the targets, and
the grippers' poses that hold them there.

Axes: B rods, V vertices, K guesses of each.
"""

from dataclasses import dataclass, replace
from enum import IntEnum
from functools import cached_property
from typing import Annotated

import numpy as np

from doo_ti.contact.surroundings import Surroundings
from doo_ti.manipulation.damped_steps import DampedSteps, normal_equations
from doo_ti.manipulation.model import (
    EXACT,
    Model,
    drawn_in,
    moved,
    padded,
    put_rows,
    slack,
    slack_gradient,
)
from doo_ti.relaxation.sensitivity import GRIPPERS, sensitivity
from doo_ti.rod.frames import (
    bishop_frames,
    quaternion_about,
    quaternion_from_matrix,
    quaternion_of_turn,
    quaternion_product,
    rotation_matrix,
    tangent_from_quaternion,
    total_twist,
    transported,
)
from doo_ti.rod.material import Material, Rows, doubt_marks
from doo_ti.rod.types import Clamp, Clamps, Configuration, Solution, finite_rods, put_rods
from doo_ti.system.arguments import owning, typed
from doo_ti.system.errors import InputError, require

ASKED = 1e-12  # least total weight of a rod's vertices


@owning
@dataclass(frozen=True)
class Targets:
    """Where vertices of B rods shall be.

    vertices  (B, V, 3) mm; NaN where nothing is asked
    weight    (B, V) of the squared distances, zero or positive; None: one

    Raises InputError for a rod of which nothing is asked, infinite places and weights that are negative or not finite.
    """

    vertices: Annotated[np.ndarray, "B V 3", float]
    weight: Annotated[np.ndarray | None, "B V", float] = None

    def __post_init__(self) -> None:
        require(not np.isinf(self.vertices).any(), "Targets", "vertices", "infinite", "give mm, or NaN where nothing is asked")
        if self.weight is not None and not ((self.weight >= 0) & np.isfinite(self.weight)).all():
            raise InputError("Targets", "weight", "negative or not finite", "give zero or positive weights")
        nothing = np.flatnonzero(~(self._weight.sum(axis=1) > ASKED))
        if len(nothing):
            raise InputError("Targets", "vertices", f"nothing is asked of rod {nothing[0]}: all NaN, as without an "
                             "equilibrium", "give at least one vertex a place")

    @property
    def count(self) -> int:
        """B, the number of rods."""
        return len(self.vertices)

    @cached_property
    def places(self) -> np.ndarray:
        """(B, V, 3) mm, zero where nothing is asked."""
        return np.nan_to_num(self.vertices)

    @cached_property
    def shares(self) -> np.ndarray:
        """(B, V) weights of the vertices, one in all of each rod; zero where nothing is asked."""
        return self._weight / self._weight.sum(axis=1, keepdims=True)

    @property
    def _weight(self) -> np.ndarray:
        asked = np.isfinite(self.vertices).all(axis=-1)
        return asked * (1.0 if self.weight is None else self.weight)

    def take(self, index: Rows) -> "Targets":
        """The targets of the rods named by ``index``."""
        return Targets(self.vertices[index], None if self.weight is None else self.weight[index])

    def padded(self) -> "Targets":
        """The same for rods with one more edge at each end, of whose ends nothing is asked."""
        return Targets(padded(self.vertices), None if self.weight is None else np.pad(self.weight, ((0, 0), (1, 1))))

    def distance(self, vertices: np.ndarray) -> np.ndarray:
        """(B,) mm, the weighted root mean square distance of ``vertices`` (B, V, 3) to their places."""
        apart = self.places - vertices
        x, y, z = np.moveaxis(apart * apart, -1, 0)
        return np.sqrt(np.sum(self.shares * (x + y + z), axis=1))


class ServoStatus(IntEnum):
    """Where a rod stands after a step.

    MOVING     on its way
    REACHED    within ``reached_mm`` of its target, by the estimate and, but for noise, by marks of what the target asks
    NEAREST    no motion of the grippers brings it nearer: the target is out of reach, or on another branch; or it is there by
               the estimate, but no mark has shown what the target asks for ten steps
    BLOCKED    every motion that would bring it nearer makes the model unstable or snap
    LOST       no stable model explains what is seen, and the grippers rest; or nothing was seen in ten steps
    """

    MOVING = 0
    REACHED = 1
    NEAREST = 2
    BLOCKED = 3
    LOST = 4


Box = tuple[tuple[float, float, float], tuple[float, float, float]]


def require_free(name: str, free: tuple[str, ...]) -> None:
    """Raise InputError unless an options' ``free`` names coordinates of grippers, each once."""
    if not free or set(free) - set(GRIPPERS) or len(set(free)) < len(free):
        raise InputError(name, "free", f"{free!r:.60}", f"name some of {', '.join(GRIPPERS)}, each once")


@typed
@dataclass(frozen=True)
class ServoOptions:
    """How a :class:`~doo_ti.manipulation.servo.Servo` moves and what it takes for unknown.

    free          which grippers' coordinates move, of "start_shift", "start_turn", "end_shift", "end_turn"
    step_mm       longest move of a step: the root of the sum of squares of both shifts in mm and both turns times ``lever_mm``
    lever_mm      mm that count as much as a radian
    slack         of the rod's length: grippers stay so much nearer to each other than the rod reaches between them, and nearer
                  by what is not known of both clips. It does not cover a wrong length; forces have no limit
    start_box, end_box  ((x, y, z), (x, y, z)) mm: the lowest and the highest places that a gripper may take; None: anywhere. A
                  gripper that begins outside goes no farther out
    reached_mm    distance to the target at which a rod counts as there
    noise_mm      standard deviation of a coordinate of a mark
    bend, ratio   standard deviations of what is not known of ln B and ln β/B before anything is seen; zero: known
    clip_mm, clip_deg  of each component of the displacement and rotation of the clips from the poses that are reported
    compliance    of the additional compliance of the joints at the clamps, over their own: meshes differ in it. Zero: clamps
                  act as those of ``rod``
    curvature     of the coefficients of the rest curvature, over the rod's length, rad: cable off a drum has one or two; zero:
                  straight at rest
    memory        number of moments from which Θ is learned: older ones fade, as their linearisation is out of date

    Raises InputError for numbers out of range, and unknown or no coordinates.
    """

    free: tuple[str, ...] = GRIPPERS
    step_mm: float = 15.0
    lever_mm: float = 60.0
    slack: float = 0.005
    start_box: Box | None = None
    end_box: Box | None = None
    reached_mm: float = 0.5
    noise_mm: float = 0.3
    bend: float = 0.4
    ratio: float = 0.4
    clip_mm: float = 1.0
    clip_deg: float = 2.0
    compliance: float = 0.3
    curvature: float = 1.0
    memory: float = 15.0

    def __post_init__(self) -> None:
        require_free("ServoOptions", self.free)
        for name in ("start_box", "end_box"):
            box = getattr(self, name)
            if box is not None and (np.shape(box) != (2, 3) or not (np.less_equal(*box)).all()):
                raise InputError("ServoOptions", name, f"{box!r:.60}", "give the lowest and the highest x, y, z in mm")
        for name in ("step_mm", "lever_mm", "reached_mm", "noise_mm", "memory"):
            require(0 < getattr(self, name) < 1e6, "ServoOptions", name, f"{getattr(self, name):g}", "give a positive number")
        for name in ("slack", "bend", "ratio", "clip_mm", "clip_deg", "compliance", "curvature"):
            require(0 <= getattr(self, name) < 1e3, "ServoOptions", name, f"{getattr(self, name):g}",
                    "give zero or a positive number")

    @property
    def moves(self) -> np.ndarray:
        """(12,) bool: the free ones of the grippers' coordinates, in the order of GRIPPERS."""
        return np.repeat([name in self.free for name in GRIPPERS], 3)

    @property
    def scale(self) -> np.ndarray:
        """(12,) mm per unit of each coordinate."""
        return np.repeat([1.0, self.lever_mm, 1.0, self.lever_mm], 3)


def require_places(source: str, rod: Configuration, targets: Targets) -> None:
    """Raise InputError, of ``source``, where targets are not those of the rods' vertices, and for rods of different lengths."""
    require(targets.vertices.shape[1] == rod.edges + 1, source, "targets", f"{targets.vertices.shape[1]} vertices for rods of "
            f"{rod.edges + 1}", "give a place, or NaN, for each vertex")
    require(rod.rest_length.ndim == 1, source, "rod", "rods with edges of different lengths",
            "give (E,) rest lengths, the same for all")
    doubt_marks("Targets", "vertices", targets.vertices, rod.rest_length)


def require_matching(rod: Configuration, material: Material, clamps: Clamps, targets: Targets) -> None:
    """Raise InputError where the arguments of a servo do not belong together."""
    count = rod.count
    if clamps.count != count or material.count not in (1, count) or targets.count not in (1, count):
        raise InputError("Servo", "clamps, material, targets", f"{clamps.count}, {material.count} and {targets.count} rows for "
                         f"{count} rods", "give a row for each rod; one material or target serves all")
    require_places("Servo", rod, targets)
    apart, length = np.linalg.norm(clamps.end_position - clamps.start_position, axis=1).max(initial=0.0), rod.rest_length.sum()
    require(not apart > length, "Servo", "clamps", f"{apart:.4g} mm apart, and the rod {length:.4g} mm long",
            "bring them within its reach")
    if not replace(material, rest_curvature=None).is_isotropic:
        raise InputError("Servo", "material", "not round, or not the same all along the rod", "give Material(bend, twist)")


# --- goals ---------------------------------------------------------------------------------------------------------------

TWISTS = np.radians([0.0, 90.0, -90.0, 180.0, -180.0, 270.0, -270.0, 360.0, -360.0])
"""By which guesses are twisted more than the rod is. Marks do not show twist; the fit finds it within a quarter turn."""
GUESSES = 2 + len(TWISTS)  # of each rod: itself as it is, carried to its target, and drawn to it under each twist
ITERATIONS = 20  # of the fit of the grippers' poses
LONGEST = 40.0  # mm, of a step of that fit, shifts in mm and turns times the lever
SHRINK, GROW = 0.3, 2.0  # of a step's length after it has been refused, and taken


def steps_towards(targets: Targets, shapes: np.ndarray, columns: np.ndarray, options: ServoOptions) -> DampedSteps:
    """Steps of the grippers, in mm, that bring ``shapes`` (B, V, 3) to their targets; ``columns`` (B, V, 3, 12) are the
    derivatives of the shapes by the grippers' coordinates."""
    normal, gradient = normal_equations(columns, targets.shares, targets.places - shapes)
    unit = options.moves / options.scale
    return DampedSteps(normal * np.outer(unit, unit), gradient * unit)


@dataclass(frozen=True)
class Goal:
    """B rods at certified rest near their targets."""

    rods: Configuration  # B
    clamps: Clamps  # the grippers' poses, B
    distance: np.ndarray  # (B,) mm, weighted root mean square; infinite where no guess has come to rest

    def take(self, rods: np.ndarray) -> "Goal":
        """The goals of the rods named by ``rods``."""
        return Goal(self.rods.take(rods), self.clamps.take(rods), self.distance[rods])


def nearest_goal(rods: Configuration, clamps: Clamps, model: Model, targets: Targets, options: ServoOptions) -> Goal:
    """The rods' goals: of several guesses, each drawn to its target and fitted, those that come nearest."""
    fitted = fitted_guesses(rods, clamps, model, targets, options)
    best = np.argmin(fitted.distance.reshape(GUESSES, rods.count), axis=0)
    return fitted.take(best * rods.count + np.arange(rods.count))


def fitted_guesses(rods: Configuration, clamps: Clamps, model: Model, targets: Targets, options: ServoOptions) -> Goal:
    """The goals (K·B) that all guesses lead to."""
    drawn, grippers = _guesses(rods, clamps, model, targets, options)
    rows = np.tile(np.arange(rods.count), GUESSES)
    return fit(drawn, grippers, model.take(rows), targets.take(rows), options)


def fit(rods: Configuration, clamps: Clamps, model: Model, targets: Targets, options: ServoOptions) -> Goal:
    """The rods that are nearest to their targets, from these on, by damped least squares in the grippers' poses
    (Levenberg, Marquardt); every one is certified."""
    solution = model.relaxed(rods, clamps)
    rods, distance = finite_rods(solution.configuration, rods), _distance(solution, targets)
    length, reach, stiff = np.full(rods.count, LONGEST), rods.rest_length.sum(), np.full(rods.count, rods.rest_length[0])
    unit = options.moves / options.scale
    for _ in range(ITERATIONS):
        rows = np.flatnonzero(length >= options.reached_mm * SHRINK)  # others have come as near as they can
        if not len(rows):
            break
        own, here, asked = model.take(rows), clamps.take(rows), targets.take(rows)
        solution = own.relaxed(rods.take(rows), here)
        columns = np.nan_to_num(sensitivity(solution, GRIPPERS, rotations=False, loads=False).vertices)
        vertices = solution.configuration.vertices
        shapes = np.where(np.isfinite(vertices), vertices, asked.places)
        loose = slack(here, reach, stiff[rows])
        least, tighter = np.minimum(loose, options.slack * reach), -slack_gradient(here, stiff[rows]) * unit
        step = steps_towards(asked, shapes, columns, options).below(length[rows], tighter, loose - least)
        there = moved(here, step * unit)
        there = drawn_in(there, np.maximum(least - slack(there, reach, stiff[rows]), 0.0), stiff[rows], options.moves)
        tried = own.relaxed(rods.take(rows), there)
        nearer = _distance(tried, asked)
        good = (nearer < distance[rows]) & (slack(there, reach, stiff[rows]) >= least - EXACT * reach)
        length[rows] = np.where(good, np.minimum(GROW * length[rows], LONGEST),
                                SHRINK * np.minimum(length[rows], np.linalg.norm(step, axis=1)))
        taken, good = rows[good], np.flatnonzero(good)
        rods, clamps = put_rods(rods, taken, tried.configuration.take(good)), put_rows(clamps, taken, there.take(good))
        distance[taken] = nearer[good]
    solution = model.relaxed(rods, clamps)
    return Goal(finite_rods(solution.configuration, rods), clamps, _distance(solution, targets))


def _guesses(rods: Configuration, clamps: Clamps, model: Model, targets: Targets, options: ServoOptions
             ) -> tuple[Configuration, Clamps]:
    """(K·B) rods: as they are, carried to their targets so, and drawn to them by springs, twist by twist; and grippers that
    hold them so. A gripper that is not free to shift and turn stays."""
    starts, ends = ({f"{end}_shift", f"{end}_turn"} <= set(options.free) for end in ("start", "end"))
    loose = replace(clamps, start=Clamp.FREE if starts else clamps.start,
                    end=Clamp.FREE if ends else clamps.end)
    shapes = replace(model, surroundings=Surroundings()).drawn(rods, loose, targets.places, targets.shares > 0)
    first, tangents = clamps.start_frame, tangent_from_quaternion(shapes.quaternions)
    if starts:
        first = transported(first, tangents[:, 0])
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
    # Drawn to a target that is straight, a rod would be taut.
    reach, stiff = rods.rest_length.sum(), np.full(len(rows), rods.rest_length[0])
    tight = np.maximum(options.slack * reach - slack(grippers, reach, stiff), 0.0)
    grippers = drawn_in(grippers, tight, stiff, options.moves)
    whole, there = _carried(rods, clamps, targets, model.up) if starts and ends else (rods, clamps)
    return Configuration.concatenate([rods, whole, guessed]), Clamps.concatenate([clamps, there, grippers])


def _carried(rods: Configuration, clamps: Clamps, targets: Targets, up: np.ndarray) -> tuple[Configuration, Clamps]:
    """The rods and their grippers, moved together as rigid bodies: shifted, and turned about the vertical, to where they are
    nearest to their targets. Rods at rest stay at rest."""
    share, vertices = targets.shares[..., None], rods.vertices
    centre, goal = (share * vertices).sum(axis=1), (share * targets.places).sum(axis=1)
    here, asked = share * (vertices - centre[:, None]), targets.places - goal[:, None]
    sine = (np.cross(here, asked) @ up).sum(axis=1)
    cosine = (here * asked).sum(axis=(1, 2)) - ((here @ up) * (asked @ up)).sum(axis=1)
    turn = np.arctan2(sine, cosine)[:, None] * up
    rotation = rotation_matrix(turn)

    def put(place: np.ndarray) -> np.ndarray:
        return goal + (rotation @ (place - centre)[..., None])[..., 0]

    frames = quaternion_product(quaternion_of_turn(turn)[:, None], rods.quaternions)
    return Configuration(put(rods.start), frames, rods.rest_length), replace(
        clamps, start_position=put(clamps.start_position), start_frame=rotation @ clamps.start_frame,
        end_position=put(clamps.end_position), end_frame=rotation @ clamps.end_frame)


def _distance(solution: Solution, targets: Targets) -> np.ndarray:
    """(B,) mm, infinite for rods that are not at certified rest."""
    sound = solution.converged & solution.stable
    return np.where(sound, targets.distance(np.nan_to_num(solution.configuration.vertices)), np.inf)
