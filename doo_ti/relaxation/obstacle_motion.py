"""Obstacles that move during a motion: where they are at the end of a step, and by how much it carries their places
(docs/contact.md)."""

import taichi as ti

from doo_ti.contact.obstacles import AXES, POINT
from doo_ti.physics.quaternion import first_director, normalised, product, second_director, tangent
from doo_ti.physics.tuples import dot, minus, plus, record, scaled, variable
from doo_ti.relaxation.contact_layout import (
    CARRIED,
    CARRY,
    HEAD,
    OBSTACLE_ITEMS,
    SHIFT_BEFORE,
    TURN,
    TURN_BEFORE,
)
from doo_ti.relaxation.contact_rounds import ContactRounds

# Columns of an obstacle's pose at an instant: first its turn, a quaternion, then its shift, mm. They take a place x of it from
# where it is in the table of obstacles to R x + shift.
POSE_SHIFT, POSE_COLUMNS = 4, 7


@ti.func
def applied_turn(q, x):
    """R(q) x."""
    return plus(plus(scaled(tangent(q), x[0]), scaled(first_director(q), x[1])), scaled(second_director(q), x[2]))


@ti.data_oriented
class ObstacleMotion(ContactRounds):
    """Contacts with obstacles that may move. ``tables`` holds poses (1 or row, 1 + step, obstacle, POSE_COLUMNS), the first at
    the instant before all steps."""

    @ti.func
    def first_poses(self, tables, scratch: ti.template(), slot, row, unit):
        """Put the obstacles of lane ``slot`` where they are before the first step."""
        if ti.static(self.moves):
            for o in range(tables.kinds.shape[0]):
                pose = self.pose_from(tables, row, 0, o, unit)
                at = tables.contacts + (HEAD + o * OBSTACLE_ITEMS) * self.stride
                self.put_all(scratch, at + TURN * self.stride, slot, pose.turn + pose.shift)
                self.put_all(scratch, at + TURN_BEFORE * self.stride, slot, pose.turn + pose.shift)

    @ti.func
    def next_poses(self, tables, scratch: ti.template(), slot, row, step, share, unit):
        """Move them by that ``share`` of their way to the end of step ``step``."""
        if ti.static(self.moves):
            own = ti.min(row, tables.obstacles.shape[0] - 1)
            for o in range(tables.kinds.shape[0]):
                at = tables.contacts + (HEAD + o * OBSTACLE_ITEMS) * self.stride
                pose = self.pose_from(tables, row, step + 1, o, unit)
                turn, shift = variable(pose.turn), variable(pose.shift)
                old = self.numbers4(scratch, at + TURN_BEFORE * self.stride, slot)
                before = self.numbers3(scratch, at + SHIFT_BEFORE * self.stride, slot)
                if share < 1.0:
                    alike = ti.select(dot(old, turn) < 0.0, 0.0 - share, share)
                    turn = normalised(plus(scaled(old, 1.0 - share), scaled(turn, alike)))
                    shift = plus(scaled(before, 1.0 - share), scaled(shift, share))
                carry = product(turn, (old[0], 0.0 - old[1], 0.0 - old[2], 0.0 - old[3]))
                point = scaled(self.column(tables, own, o, POINT), 1.0 / unit)
                self.put_all(scratch, at + POINT * self.stride, slot, plus(applied_turn(turn, point), shift))
                for axis in ti.static(range(3)):
                    along = self.column(tables, own, o, AXES + 3 * axis)
                    self.put_all(scratch, at + (AXES + 3 * axis) * self.stride, slot, applied_turn(turn, along))
                self.put_all(scratch, at + TURN * self.stride, slot, turn + shift)
                self.put_all(scratch, at + CARRY * self.stride, slot,
                             tangent(carry) + first_director(carry) + second_director(carry))
                self.put_all(scratch, at + CARRIED * self.stride, slot, minus(shift, applied_turn(carry, before)))

    @ti.func
    def keep_poses(self, rod, done):
        """Make where they are now that of the instant before, in the lanes that are ``done``."""
        if ti.static(self.moves):
            for o in range(rod.obstacles):
                at = self.obstacle(rod, o)
                for k in ti.static(range(POSE_COLUMNS)):
                    old = at + (TURN_BEFORE + k) * self.stride
                    rod.scratch[old] = ti.select(done, rod.scratch[at + (TURN + k) * self.stride], rod.scratch[old])

    @ti.func
    def pose_from(self, tables, row, instant, o, unit):
        """The record of ``turn`` and ``shift`` of an obstacle at an instant, lengths over ``unit``."""
        i, shift = ti.min(row, tables.poses.shape[0] - 1), ti.static(POSE_SHIFT)
        return record(
            turn=(tables.poses[i, instant, o, 0], tables.poses[i, instant, o, 1], tables.poses[i, instant, o, 2],
                  tables.poses[i, instant, o, 3]),
            shift=(tables.poses[i, instant, o, shift] / unit, tables.poses[i, instant, o, shift + 1] / unit,
                   tables.poses[i, instant, o, shift + 2] / unit))

    @ti.func
    def column(self, tables, row, o, first: ti.template()):
        """Three numbers of an obstacle in its table."""
        return (tables.obstacles[row, o, first], tables.obstacles[row, o, first + 1], tables.obstacles[row, o, first + 2])

    @ti.func
    def put_all(self, scratch: ti.template(), at, slot, values):
        """Put numbers into lane ``slot``, one after the other."""
        for k in ti.static(range(len(values))):
            self.put(scratch, at + k * self.stride, slot, values[k])

    @ti.func
    def numbers3(self, scratch: ti.template(), at, slot):
        """Three numbers of lane ``slot``."""
        s = ti.static(self.stride)
        return (ti.cast(self.get(scratch, at, slot), ti.f64), ti.cast(self.get(scratch, at + s, slot), ti.f64),
                ti.cast(self.get(scratch, at + 2 * s, slot), ti.f64))

    @ti.func
    def numbers4(self, scratch: ti.template(), at, slot):
        """Four of them."""
        return self.numbers3(scratch, at, slot) + (ti.cast(self.get(scratch, at + 3 * self.stride, slot), ti.f64),)
