"""Rods brought to a wanted shape by their grippers, from what is seen of them (§VI).

    servo = Servo(rods, material, clamps, Targets(vertices))
    for _ in range(30):
        clamps = servo.step(seen)        # (B, V, 3) mm, NaN where not seen; the grippers' next poses
    servo.status, servo.material

Each loop has a model of its rod: an equilibrium under the grippers' poses, and its derivatives by these and by what is not
known of the rod. A step

    1. learns: the marks correct what is not known (:mod:`.belief`); what the model cannot explain is kept as an offset;
    2. moves: damped least squares from the model with its offset to the target, at most ``step_mm`` long;
    3. looks ahead: the model goes there. Where it loses its stability, snaps, or does not come nearer, the step is shortened.

A rod that comes no nearer looks for an equilibrium that does (:mod:`.targets`), and its grippers go straight to the poses of
that one, or back where there is no way. A rod that has snapped is seen far from where its model is; the model is then drawn to
the marks.

Axes: B rods, V vertices, P unknowns.
"""

from collections.abc import Sequence
from copy import deepcopy
from typing import Annotated

import numpy as np
from numpy.typing import ArrayLike

from doo_ti.contact.obstacles import Obstacle
from doo_ti.contact.surroundings import Surroundings
from doo_ti.manipulation.belief import CENTRE, CLIP, Belief, LearnedMaterial, elastic_curvature
from doo_ti.manipulation.damped_steps import DampedSteps
from doo_ti.manipulation.model import (
    EXACT,
    Model,
    between_marks,
    boxed,
    change_between,
    drawn_in,
    gap_of_held,
    held,
    moved,
    padded,
    put_rows,
    shortened,
    size_of,
    slack,
    slack_gradient,
)
from doo_ti.manipulation.targets import (
    ServoOptions,
    ServoStatus,
    Targets,
    nearest_goal,
    require_matching,
    steps_towards,
)
from doo_ti.relaxation.newton import Newton
from doo_ti.relaxation.relax import relax
from doo_ti.relaxation.sensitivity import GRIPPERS, sensitivity
from doo_ti.rod.material import doubt_marks
from doo_ti.rod.shapes import with_end_edges
from doo_ti.rod.types import Clamps, Configuration, Material, Solution, finite_rods, put_rods, unit_up
from doo_ti.system.arguments import counted, typed
from doo_ti.system.errors import InputError

PARAMETERS = ("bend", "twist", *GRIPPERS)
OF_GRIPPERS = slice(CLIP, CLIP + 12)  # of the columns of derivatives
SHORTER = 0.4  # of a step that was refused, the length of the next one that is tried
TRIES = 4  # lengths of a step; the last is zero, which only takes in what was learned
NONLINEAR, NONLINEAR_MM = 0.5, 1.0
"""Share of a displacement, and mm, by which a step may end elsewhere than its derivatives say. Further off it is too long, or a
snap: with 1 snaps pass, with 0.2 steps are short."""
WORSE, ROUNDING = 1.02, 0.1
"""Growth of the distance to the target, as a factor and in mm, that is still taken for rounding and noise."""
GAIN = 0.3  # of the newest moment in the offset
SNAPPED, SNAPPED_SHARE = 5.0, 0.02
"""A rod has snapped where its marks are so many standard deviations and so much of its length from its model."""
AIMS, NEARER = 3, 0.5
"""How often a rod that comes no nearer is given a goal to go to, and the share of its distance that the goal must be within."""
CONFIRMED, BLIND = 3.0, 10
"""How much farther than ``reached_mm`` marks may be from the target of a rod that is there, over their noise; and steps without
marks after which a rod is lost or, without marks of what is asked, not there."""
STRANGE, MOMENTS = 0.05, 5
"""No model explains a rod of which half the marks are by so much of its length off what is learned, so often in a row."""
LITTLE = 0.005
"""Of the distance to the target or, if that is less, of the longest step, what a step must gain at least, or the rod is as near
as it comes; and of the longest step, by how much it must bring grippers nearer to the poses that they go to."""


class Servo:
    """B loops of manipulation at once.

    rod        B rods, at or near rest under ``clamps``
    material   nominal Θ, round, one row for all or B
    clamps     the grippers' poses, B
    targets    for B rods, or one for all
    options    ServoOptions
    obstacles, radius  as in :func:`doo_ti.relaxation.relax.relax`, at rest and without friction

    Attributes: ``clamps``, the grippers' poses after the last step; ``material``, what has been learned of Θ; ``status`` (B,)
    ServoStatus; ``distance`` (B,) mm, weighted root mean square from the target as it is estimated; ``snaps`` (B,) how often a
    model was drawn to the marks again.

    Raises InputError where numbers of rods or vertices do not match and for materials that are not round and uniform.
    """

    @typed
    def __init__(self, rod: Configuration, material: Material, clamps: Clamps, targets: Targets,
                 options: ServoOptions | None = None, *, up: ArrayLike = (0.0, 0.0, 1.0), obstacles: Sequence[Obstacle] = (),
                 radius: ArrayLike | None = None):
        count = rod.count
        require_matching(rod, material, clamps, targets)
        around = Surroundings.checked("Servo", obstacles, radius, count)
        if around.rub:
            raise InputError("Servo", "obstacles", "with friction, which depends on the way", "give obstacles without friction")
        self._options = options = ServoOptions() if options is None else options
        self._around, self._up = around, unit_up(up, "Servo")
        rows = np.zeros(count, dtype=np.int64)
        self._edge = float(rod.rest_length[0])
        self._padded = options.compliance > 0 and self._edge > 0
        rod = with_end_edges(rod) if self._padded else rod
        targets = targets.take(rows) if targets.count < count else targets
        self._targets = targets.padded() if self._padded else targets
        material = material.take(rows) if material.count < count else material
        self._belief = Belief(material, rod.rest_length, options, CENTRE if self._padded else 0.0)
        self.clamps = clamps
        model = relax(rod, self._belief.material, clamps, Newton.careful(), up=self._up, **around.arguments)
        self._last, self._sound = finite_rods(model.configuration, rod), model.converged & model.stable
        self._shapes = self._last.vertices
        self._offset = np.zeros((count, rod.edges + 1, 3))
        self._length = np.full(count, options.step_mm)
        self.status = np.full(count, int(ServoStatus.MOVING))
        self.snaps = np.zeros(count, dtype=np.int64)
        self._aims, self._aiming, self._aimed = clamps, np.zeros(count, dtype=bool), np.zeros(count, dtype=np.int64)
        # Where the rods began to go to a goal, and how near they were; those that go back there.
        self._left, self._left_distance, self._returning = clamps, np.zeros(count), np.zeros(count, dtype=bool)
        self.distance = self._targets.distance(self._shapes)
        self._seen_distance = np.full(count, np.inf)  # mm from the target by the marks alone, infinite where none shows it
        # Moments since anything, and since anything that is asked, was seen; and in a row of which no model explains the marks.
        self._blind, self._unseen, self._strange = np.zeros(count, int), np.full(count, BLIND), np.zeros(count, int)

    def __repr__(self) -> str:
        counts = [f"{number} {ServoStatus(kind).name.lower()}"
                  for kind, number in zip(*np.unique(self.status, return_counts=True), strict=True)]
        return f"Servo({counted(self.clamps.count, 'rod')}: {', '.join(counts)})"

    @property
    def material(self) -> LearnedMaterial:
        """What has been learned of Θ, with 95 % intervals."""
        return self._belief.result()

    @property
    def vertices(self) -> np.ndarray:
        """(B, V, 3) mm, where the rods are estimated to be after the last step."""
        vertices = self._shapes + self._offset
        return vertices[:, 1:-1] if self._padded else vertices

    @typed
    def step(self, seen: Annotated[np.ndarray, "B V 3", float]) -> Clamps:
        """The grippers' next poses.

        seen  (B, V, 3) mm: where vertices are seen now, while the grippers are at ``clamps``; NaN where they are not

        A rod of which nothing is seen moves as its model says. Raises InputError for another shape and infinite places.
        """
        seen = np.asarray(seen, dtype=np.float64)
        wanted = (len(self.status), self._offset.shape[1] - 2 * self._padded, 3)
        if seen.shape != wanted or np.isinf(seen).any():
            raise InputError("Servo.step", "seen", f"shape {seen.shape}, or infinite", f"give {wanted} mm, or NaN")
        if not np.isfinite(self._belief.expected).any():  # the first moment
            doubt_marks("Servo.step", "seen", seen, self._last.rest_length[self._padded : wanted[1] - 1 + self._padded])
        seen = padded(seen) if self._padded else seen
        visible = np.isfinite(seen).all(axis=-1)
        shown = (self._targets.shares * visible).sum(axis=1)  # of what the target asks
        by_marks = self._targets.distance(np.where(visible[..., None], seen, self._targets.places))
        self._seen_distance = np.where(shown > 0, by_marks / np.sqrt(np.where(shown > 0, shown, 1.0)), np.inf)
        self._blind = np.where(visible.any(axis=1), 0, self._blind + 1)
        self._unseen = np.where(shown > 0, 0, self._unseen + 1)
        self._follow_snaps(seen, visible)
        rests, modes = self._relaxed(np.arange(len(visible))), self._belief.modes if self._belief.uneven else None
        found = sensitivity(rests, PARAMETERS + ("modes",) * self._belief.uneven, modes, rotations=False, loads=False)
        usable = found.usable & np.isfinite(found.vertices[:, -1]).all(axis=(1, 2))  # none of taut rods
        derivatives = np.where(usable[:, None, None, None], found.vertices, 0.0)
        model = np.where(usable[:, None, None], rests.configuration.vertices, self._shapes)
        visible = visible & usable[:, None]
        frames = np.stack([self.clamps.start_frame] * 2 + [self.clamps.end_frame] * 2)
        transform = self._belief.transform(frames, elastic_curvature(self._last, self._belief.material))
        force = rests.contact_force
        touching = np.zeros(len(usable), dtype=bool) if force is None else (np.nan_to_num(force) != 0.0).any(axis=(1, 2))
        change = self._belief.learn(seen - model, visible, derivatives, transform, touching)
        columns = derivatives.reshape(len(usable), -1, derivatives.shape[-1])
        expected = model + (columns @ change[..., None]).reshape(model.shape)
        apart = np.linalg.norm(np.where(visible[..., None], seen - expected, np.inf), axis=-1)
        half = np.take_along_axis(np.sort(apart, axis=1), visible.sum(axis=1, keepdims=True) // 2, axis=1)[:, 0]
        strange = (half > STRANGE * self._last.rest_length.sum()) & visible.any(axis=1)
        self._strange = (self._strange + 1) * strange
        left = (1 - GAIN) * self._offset + GAIN * between_marks(seen - expected, visible)
        self._offset = np.where(visible.any(axis=1)[:, None, None], left, self._offset)
        steps = steps_towards(self._targets, expected + self._offset, derivatives[..., OF_GRIPPERS], self._options)
        self._move(expected, columns, steps, usable)
        return deepcopy(self.clamps)

    def _follow_snaps(self, seen: np.ndarray, visible: np.ndarray) -> None:
        """Draw the models to the marks that are far from them, where that explains the marks better."""
        apart = np.where(visible[..., None], seen - self._shapes - self._offset, 0.0)
        error, lost = size_of(apart, visible), ~self._sound
        # The first moment is compared with nothing: what is not known of the rod has not been learned.
        limit = np.maximum(SNAPPED * self._belief.expected, SNAPPED_SHARE * self._last.rest_length.sum())
        rods = np.flatnonzero((lost | (error > limit)) & visible.any(axis=1))
        if not len(rods):
            return
        model, clamps = self._models(rods), self.clamps.take(rods)
        # On the branch that is nearest to the marks: drawn to them, then let go.
        found = model.relaxed(model.drawn(self._last.take(rods), clamps, seen[rods], visible[rods]), clamps)
        sound = found.converged & found.stable
        left = np.where(visible[rods][..., None], seen[rods] - found.configuration.vertices, 0.0)
        better = sound & (lost[rods] | (size_of(left, visible[rods]) < 0.5 * error[rods]))
        rods = rods[better]
        self._offset[rods] = 0.0
        self._belief.forget(rods)
        self.snaps[rods] += 1
        self._put(rods, found.configuration.take(np.flatnonzero(better)))

    def _put(self, rods: np.ndarray, models: Configuration, shapes: np.ndarray | None = None) -> None:
        """Take ``models`` with the vertices ``shapes`` for where the ``rods`` are."""
        shapes = models.vertices if shapes is None else shapes
        self._last, self._shapes = put_rods(self._last, rods, models), self._shapes.copy()
        self._shapes[rods] = shapes

    def _move(self, expected: np.ndarray, columns: np.ndarray, steps: DampedSteps, usable: np.ndarray) -> None:
        """Move the grippers, and the models with them: as far as these follow."""
        start = self.clamps
        here, self.distance = self._targets.distance(expected + self._offset), self.distance.copy()
        waiting = np.arange(len(usable))
        refused, gain = np.zeros(len(usable), dtype=bool), np.zeros(len(usable))
        longest = np.where(usable & (self._strange < MOMENTS), self._length, 0.0)
        length, stiff = self._last.rest_length.sum(), self._belief.held(self._edge)
        loose = self._slack(start, np.arange(len(usable)))
        least, moves = np.minimum(loose, self._least_slack()), self._options.moves
        tighter, room = -slack_gradient(start, stiff) * moves / self._options.scale, loose - least
        free = np.minimum(gap_of_held(start, self._edge, self._around), 0.0)  # a gripper inside an obstacle goes no deeper
        to_aim, boxes = self._to_aims(), (self._options.start_box, self._options.end_box)
        for attempt in range(TRIES):
            most = longest if attempt < TRIES - 1 else np.zeros_like(longest)
            step = np.where(self._aiming[:, None], shortened(to_aim, most), steps.below(most, tighter, room))[waiting]
            origin = start.take(waiting)
            there = boxed(moved(origin, step / self._options.scale), origin, boxes)
            step[:, :3] = there.start_position - origin.start_position
            step[:, 6:9] = there.end_position - origin.end_position
            tight = np.maximum(least[waiting] - self._slack(there, waiting), 0.0)
            # Drawn in, a gripper may leave its box again.
            there = boxed(drawn_in(there, tight, stiff[waiting], moves), origin, boxes)
            self.clamps = put_rows(self.clamps, waiting, there)
            model = self._relaxed(waiting)
            targets, change = self._targets.take(waiting), step * moves / self._options.scale
            linear = (columns[waiting, :, OF_GRIPPERS] @ change[..., None]).reshape(len(waiting), -1, 3)
            shapes = model.configuration.vertices
            off = size_of(shapes - expected[waiting] - linear)
            distance = targets.distance(shapes + self._offset[waiting])
            size = np.linalg.norm(step, axis=1)
            nearer = self._aiming[waiting] | (distance <= WORSE * here[waiting] + ROUNDING)
            nearer &= self._slack(there, waiting) >= least[waiting] - EXACT * length
            nearer &= gap_of_held(there, self._edge, self._around.take(waiting)) >= free[waiting]
            follows = (off <= NONLINEAR * size_of(linear) + NONLINEAR_MM) & nearer
            good = model.converged & model.stable & (follows | (size == 0))
            done = waiting[good]
            rows = np.flatnonzero(good)
            self._put(done, model.configuration.take(rows), shapes[rows])
            self.distance[done], gain[done] = distance[good], (here[waiting] - distance)[good]
            if attempt == 0:
                self._length[done] = np.minimum(2 * np.maximum(size[good], 1.0), self._options.step_mm)
            longest[waiting] = SHORTER * np.minimum(longest[waiting], np.maximum(size, 0.1))
            refused[waiting[~good]] = True
            waiting = waiting[~good]
            if not len(waiting):
                break
            self._length[waiting] = np.maximum(longest[waiting], 0.5)
        self._sound = ~np.isin(np.arange(len(usable)), waiting)
        self.clamps = put_rows(self.clamps, waiting, start.take(waiting))
        self._judge(gain, refused)
        self._end_aims(np.linalg.norm(to_aim, axis=1))
        self._aim()
        waits = np.isin(self.status, (ServoStatus.NEAREST, ServoStatus.BLOCKED)) & self._aiming
        self.status = np.where(waits, ServoStatus.MOVING, self.status)

    def _end_aims(self, before: np.ndarray) -> None:
        """End the ways to goals, ``before`` (B,) mm long before this step, that are at their end or go no farther. Rods that
        are then farther from their targets than where they set out go back there."""
        left = np.linalg.norm(self._to_aims(), axis=1)
        ended = (before <= self._options.step_mm) | (left > before - LITTLE * self._options.step_mm)  # there, or no way to it
        ended = self._aiming & (ended | np.isin(self.status, (ServoStatus.LOST, ServoStatus.REACHED)))
        back = ended & ~self._returning & (self.status != ServoStatus.REACHED)
        back &= self.distance > WORSE * self._left_distance + ROUNDING
        self._aims = put_rows(self._aims, np.flatnonzero(back), self._left.take(np.flatnonzero(back)))
        self._aiming &= ~ended | back
        self._returning = (self._returning & ~ended) | back
        self._length[back] = self._options.step_mm

    def _judge(self, gain: np.ndarray, refused: np.ndarray) -> None:
        """Set the statuses after a step that has brought the models nearer by ``gain`` (B,) mm, or was ``refused`` (B,)."""
        there, unseen = self.distance <= self._options.reached_mm, self._unseen >= BLIND
        stuck = (gain < LITTLE * np.minimum(self.distance, self._options.step_mm)) | (there & unseen)
        status = np.where(stuck, np.where(refused, ServoStatus.BLOCKED, ServoStatus.NEAREST), ServoStatus.MOVING)
        near = self._seen_distance <= self._options.reached_mm + CONFIRMED * self._options.noise_mm
        near |= np.isinf(self._seen_distance) & ~unseen
        known = self._sound & (self._blind < BLIND) & (self._strange < MOMENTS)
        self.status = np.where(known, np.where(there & near, ServoStatus.REACHED, status), ServoStatus.LOST)

    def _aim(self) -> None:
        """Give rods that come no nearer to their targets a goal that is, where there is one. On the way to it the distance may
        grow."""
        stuck = np.isin(self.status, (ServoStatus.NEAREST, ServoStatus.BLOCKED)) & ~self._aiming & (self._aimed < AIMS)
        rods = np.flatnonzero(stuck & (self.distance > self._options.reached_mm))
        if not len(rods):
            return
        self._aimed[rods] += 1
        here = Targets(self._targets.vertices[rods] - self._offset[rods], self._targets.shares[rods])
        goal = nearest_goal(self._last.take(rods), self.clamps.take(rods), self._models(rods), here, self._options)
        good = (self._slack(goal.clamps, rods) >= self._least_slack()[rods]) & (goal.distance < NEARER * self.distance[rods])
        within = boxed(goal.clamps, self.clamps.take(rods), (self._options.start_box, self._options.end_box))
        for end in ("start_position", "end_position"):
            good &= (np.abs(getattr(within, end) - getattr(goal.clamps, end)) <= self._options.reached_mm).all(axis=1)
        self._aims = put_rows(self._aims, rods[good], goal.clamps.take(np.flatnonzero(good)))
        self._left = put_rows(self._left, rods[good], self.clamps.take(rods[good]))
        self._left_distance[rods[good]], self._aiming[rods[good]] = self.distance[rods[good]], True
        self._length[rods[good]] = self._options.step_mm

    def _to_aims(self) -> np.ndarray:
        """(B, 12) mm, what is left of the grippers' way to their goal; zero for rods without one."""
        way = change_between(self.clamps, self._aims) * self._options.scale
        return np.where(self._aiming[:, None], way, 0.0)

    def _slack(self, clamps: Clamps, rods: np.ndarray) -> np.ndarray:
        """(n,) mm of slack of those ``rods`` between grippers at ``clamps`` (n), where the clips are estimated to be."""
        stiff = self._belief.held(self._edge)[rods]
        return slack(held(clamps, self._belief.clip[rods]), self._last.rest_length.sum(), stiff)

    def _least_slack(self) -> np.ndarray:
        """(B,) mm of slack that grippers keep: the option's, and what is not known of the clips."""
        return self._options.slack * self._last.rest_length.sum() + self._belief.clip_margin

    def _relaxed(self, rods: np.ndarray) -> Solution:
        """The models of ``rods`` at rest under their clamps and what is known of them, from their last shapes."""
        return self._models(rods).relaxed(self._last.take(rods), self.clamps.take(rods))

    def _models(self, rods: np.ndarray) -> Model:
        every = Model(self._belief.material, self._belief.clip, self._up, self._around)
        return every if len(rods) == len(self.status) else every.take(rods)
