"""Obstacles that move during a motion: where they are at the end of a step, and by how much it carries their places
(docs/contact.md)."""

import taichi as ti

from doo_ti.contact.obstacles import AXES, POINT
from doo_ti.physics.quaternion import first_director, partway, product, rotated, second_director, tangent
from doo_ti.physics.tuples import minus, plus, record, scaled, variable
from doo_ti.physics.view import exact, read
from doo_ti.relaxation.loading import Loading

# Columns of an obstacle's pose at an instant: first its turn, a quaternion, then its shift, mm. They take a place x of it from
# where it is in the table of obstacles to R x + shift.
POSE_SHIFT, POSE_COLUMNS = 4, 7


@ti.data_oriented
class ObstacleLoading(Loading):
    """Loading of the poses of obstacles. ``tables`` holds poses (1 or row, 1 + step, obstacle, POSE_COLUMNS), the first at the
    instant before all steps."""

    def __init__(self, sweep):
        super().__init__(sweep)
        self.moves = self.touches and self.contacts.moves

    @ti.func
    def first_poses(self, tables, slot, row, unit):
        """Load the poses of lane ``slot`` before the first step."""
        for o in range(tables.kinds.shape[0]):
            pose = self.pose_from(tables, row, 0, o, unit)
            at = self.contacts.obstacle(self.contacts.of_lane(tables, slot), o)
            at.pose = pose.turn + pose.shift
            at.pose_before = pose.turn + pose.shift

    @ti.func
    def next_poses(self, tables, slot, row, step, share, unit):
        """Load the poses of lane ``slot`` after that ``share`` of the way to the end of step ``step``, where that puts the
        obstacles, and by how much it carries their places."""
        own = ti.min(row, tables.obstacles.shape[0] - 1)
        for o in range(tables.kinds.shape[0]):
            at = self.contacts.obstacle(self.contacts.of_lane(tables, slot), o)
            pose = self.pose_from(tables, row, step + 1, o, unit)
            turn, shift = variable(pose.turn), variable(pose.shift)
            old = exact(at.turn_before)
            before = exact(at.shift_before)
            if share < 1.0:
                turn = partway(old, turn, share)
                shift = plus(scaled(before, 1.0 - share), scaled(shift, share))
            carry = product(turn, (old[0], 0.0 - old[1], 0.0 - old[2], 0.0 - old[3]))
            point = scaled(read(tables.obstacles, own, o, POINT), 1.0 / unit)
            at.point = plus(rotated(turn, point), shift)
            at.axis_1 = rotated(turn, read(tables.obstacles, own, o, AXES))
            at.axis_2 = rotated(turn, read(tables.obstacles, own, o, AXES + 3))
            at.axis_3 = rotated(turn, read(tables.obstacles, own, o, AXES + 6))
            at.pose = turn + shift
            at.carry = tangent(carry) + first_director(carry) + second_director(carry)
            at.carried = minus(shift, rotated(carry, before))

    @ti.func
    def rest_of_poses(self, tables, row, step):
        """One where no obstacle moves in step ``step``, else zero."""
        i, still = ti.min(row, tables.poses.shape[0] - 1), ti.cast(1.0, ti.f64)
        for o, k in ti.ndrange(tables.kinds.shape[0], POSE_COLUMNS):
            if tables.poses[i, step, o, k] != tables.poses[i, step + 1, o, k]:
                still = 0.0
        return still

    @ti.func
    def pose_from(self, tables, row, instant, o, unit):
        """The record of ``turn`` and ``shift`` of an obstacle at an instant, lengths over ``unit``."""
        i = ti.min(row, tables.poses.shape[0] - 1)
        return record(turn=read(tables.poses, i, instant, o, 0, count=4),
                      shift=scaled(read(tables.poses, i, instant, o, POSE_SHIFT), 1.0 / unit))
