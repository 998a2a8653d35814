"""What scratch holds of a rod in motion besides what :mod:`doo_ti.relaxation.chain_layout` names (docs/dynamics.md)."""

from doo_ti.physics.view import Layout

# Of a vertex: positions and velocities at the last two instants, mm and mm/s; then, in energy over mm² but ``load`` and
# ``force``, in energy over mm: inertia κ, drag d, its growth with speed per mm/s, the weight of a point mass there, a dead
# force, and a spring's stiffness with its point.
VERTEX = Layout(place_1=3, place_2=3, velocity_1=3, velocity_2=3, inertia=1, drag=1, drag_by_speed=1, load=1, force=3, spring=1,
                spring_point=3)
PLACE_2, VELOCITY_1, INERTIA, DRAG, DRAG_BY_SPEED, LOAD, FORCE, SPRING, SPRING_POINT = map(VERTEX.at, (
    "place_2", "velocity_1", "inertia", "drag", "drag_by_speed", "load", "force", "spring", "spring_point"))
VERTEX_ITEMS = len(VERTEX)
# Of an edge, after those of the vertex where it ends: its frames at the last two instants, and of the joint where it begins the
# rest curvature of its left and its right frame and its rest twist, for the step being made.
MOTION = VERTEX + Layout(frame_1=4, frame_2=4, rest_left=2, rest_right=2, rest_twist=1)
# Of a rod: shares of the rest curvature and twist that damping makes, the sum of the inertia κ of all vertices, by how much its
# link has changed, how its clamps reach (:mod:`.clamp_table`), one where the step is one of backward Euler though others are
# not, and where neither clamps nor obstacles move in it, and vertex 0.
ROD = Layout(bend_share=1, twist_share=1, inertia=1, relinked=1, reach=1, euler=1, still=1, vertex=VERTEX)
