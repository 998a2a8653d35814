"""Energies of rods that move: what a time step adds to those of rods at rest, and an account of what is stored, what is
dissipated, and what the grippers do, summed up step by step (docs/dynamics.md).

Axes: G materials, R rods, V vertices, E edges, T instants. Energies in the package's unit, mm².
"""

from dataclasses import dataclass

import numpy as np

from doo_ti.dynamics.parameters import GRAVITY, RATES, Dynamics, vertex_lengths
from doo_ti.dynamics.trajectory import Detail
from doo_ti.relaxation.external import PointLoads
from doo_ti.relaxation.time_steps import Memory, curvatures
from doo_ti.relaxation.time_sweep import DRAG, DRAG_BY_SPEED, FORCE, INERTIA, LOAD, SPRING, SPRING_POINT, VERTEX_ITEMS
from doo_ti.rod.frames import conjugate, quaternion_of_turn, quaternion_product, rotation_vector, tangent_from_quaternion
from doo_ti.rod.types import Material, Status
from doo_ti.system.errors import InputError

STORED = ("kinetic", "gravity", "bending", "twist", "springs", "loads")  # parts of the energy that a rod has at an instant
FLOWS = ("drag", "bend_damping", "twist_damping", "contact", "work")
"""What has been dissipated since the start, by what, and the grippers' work on the rod since then. Contact takes what friction
and impacts do, less the work of obstacles that move."""
SMALL_TURN = 1e-5  # rad, for differences of the strains
TURNS = quaternion_of_turn(SMALL_TURN * np.repeat(np.eye(3), 2, axis=0) * np.tile([1.0, -1.0], 3)[:, None])
"""By that about each axis, forwards and backwards."""


@dataclass(frozen=True)
class Losses:
    """What R rods are made of, for the account of their energies.

    length         (R, E) mm
    bend           (R, 1 or E, 2, 2), twist (R, 1 or E − 1), rest (R, 1 or E − 1, 2) ω̄ in 1/mm: as :class:`.Material`
    bend_damping, twist_damping  (R,) s
    weight         (R, V) energy per mm of height: of the rod and of point masses
    mass           (R, V) energy over (mm/s)², drag (R, V) energy s/mm², drag_by_speed (R, V) energy s²/mm³
    force          (R, V, 3) dead forces, energy per mm
    spring_stiffness (R, V), spring_point (R, V, 3)
    up             (3,)
    """

    length: np.ndarray
    bend: np.ndarray
    twist: np.ndarray
    rest: np.ndarray
    bend_damping: np.ndarray
    twist_damping: np.ndarray
    weight: np.ndarray
    mass: np.ndarray
    drag: np.ndarray
    drag_by_speed: np.ndarray
    force: np.ndarray
    spring_stiffness: np.ndarray
    spring_point: np.ndarray
    up: np.ndarray

    @classmethod
    def of(cls, material: Material, dynamics: Dynamics, rows: np.ndarray, length: np.ndarray, numbers: np.ndarray, rate: float,
           up: np.ndarray) -> "Losses":
        """Those of rods with the materials ``rows`` (R,), edges of ``length`` (R, E) and :func:`.vertex_numbers` (R, V, -), at
        the ``rate`` a/h of a step."""
        rest = np.zeros((material.count, 1, 2)) if material.rest_curvature is None else material.rest_curvature
        damping = [dynamics.column(name, material.count)[rows] for name in ("bend_damping", "twist_damping")]
        weight = 2.0 * material.weight[rows, None] * vertex_lengths(length) + numbers[..., LOAD - INERTIA]
        drag, by_speed = (numbers[..., column - INERTIA] / rate for column in (DRAG, DRAG_BY_SPEED))
        mass = numbers[..., 0] / rate**2
        return cls(length, material.bend[rows], material.twist[rows], rest[rows], *damping, weight, mass, drag, by_speed,
                   numbers[..., FORCE - INERTIA : SPRING - INERTIA], numbers[..., SPRING - INERTIA],
                   numbers[..., SPRING_POINT - INERTIA :], up)

    @property
    def pair_length(self) -> np.ndarray:
        """(R, E − 1) l̄ of the joints."""
        return self.length[:, :-1] + self.length[:, 1:]

    def stresses(self, strains: np.ndarray) -> np.ndarray:
        """(R, E − 1, 5) derivatives of the elastic energy by ``strains``, less the rest's: B κ/l̄ twice and 2 β m/l̄."""
        bend = np.broadcast_to(self.bend, (len(self.bend), self.length.shape[1], 2, 2))
        left, right = (np.einsum("rjab,rjb->rja", b, bent) for b, bent in (
            (bend[:, :-1], strains[..., :2]), (bend[:, 1:], strains[..., 2:4])))
        turn = 2.0 * self.twist * strains[..., 4]
        return np.concatenate([left, right, turn[..., None]], axis=-1) / self.pair_length[..., None]

    def rest_strains(self) -> np.ndarray:
        """(R, E − 1, 5) at which there is no stress."""
        bent = 0.5 * self.pair_length[..., None] * self.rest
        return np.concatenate([bent, bent, np.zeros_like(bent[..., :1])], axis=-1)

    def elastic(self, strains: np.ndarray) -> np.ndarray:
        """(R, E − 1, 5) energy of the joints at ``strains``, of bending but for the last, which is of twisting."""
        strains = strains - self.rest_strains()
        return 0.5 * strains * self.stresses(strains)

    def stored(self, memory: Memory, strains: np.ndarray) -> dict[str, np.ndarray]:
        """(R,) energies of each of STORED; ``strains`` are those of the memory."""
        place, velocity = memory.places[..., :3], memory.places[..., 6:9]
        work = self.elastic(strains)
        apart = ((place - self.spring_point) ** 2).sum(axis=-1)
        return {
            "kinetic": (0.5 * self.mass * (velocity**2).sum(axis=-1)).sum(axis=-1),
            "gravity": (self.weight * (place @ self.up)).sum(axis=-1),
            "bending": work[..., :4].sum(axis=(-1, -2)), "twist": work[..., 4].sum(axis=-1),
            "springs": (0.5 * self.spring_stiffness * apart).sum(axis=-1), "loads": -(self.force * place).sum(axis=(-1, -2))}

    def dissipated(self, memory: Memory, change: np.ndarray, step: float) -> dict[str, np.ndarray]:
        """(R,) what was dissipated in the step h before ``memory`` at its mean speeds; the strains changed by ``change``."""
        moved = memory.places[..., :3] - memory.places[..., 3:6]
        square = (moved**2).sum(axis=-1) / step
        loss = change * self.stresses(change) / step
        return {"drag": (square * (self.drag + self.drag_by_speed * np.sqrt(square / step))).sum(axis=-1),
                "bend_damping": self.bend_damping * loss[..., :4].sum(axis=(-1, -2)),
                "twist_damping": self.twist_damping * loss[..., 4].sum(axis=-1)}


class Account:
    """The energies of R rods as they move, at every instant, and what has flown since the first.

    The grippers' work on a taut rod, on which their forces are not determined, is what the rod gains and loses.

    losses  what the rods are made of
    scheme  of the steps, h = ``step`` in s
    held    (R, 2) bool: whether a gripper holds the start, and the end
    memory  of the rods at the start
    touches whether there are obstacles
    """

    def __init__(self, losses: Losses, scheme: str, step: float, held: np.ndarray, memory: Memory, touches: bool):
        self.losses, self.step, self.held, self.touches = losses, step, held, touches
        rate = RATES[scheme]
        self.scheme = rate / step, (rate - 1.0) / rate
        self._flows = {name: np.zeros(len(held)) for name in FLOWS}
        self._forces, self._contact, self._instants = None, 0.0, []
        self._strains = joint_strains(memory.frames_before), joint_strains(memory.frames)
        self._stored = sum(losses.stored(memory, self._strains[1]).values())
        self._keep(memory)
        self._store(memory)

    def _keep(self, memory: Memory) -> None:
        """What the next step needs of the memory before it."""
        self._velocities = memory.places[..., 6:9].copy(), memory.places[..., 9:12].copy()
        self._before = memory.frames.copy(), memory.places[..., :3].copy()

    def _store(self, memory: Memory) -> None:
        """An instant for the tables."""
        stored = self.losses.stored(memory, self._strains[1])
        self._instants.append((memory.frames.copy(), memory.places[..., 6:9].copy(), stored | self._flows))

    def see(self, memory: Memory, end_force: np.ndarray, contact: np.ndarray | float, is_frame: bool) -> None:
        """The step that led to ``memory``, with the force (R, 3) of the far clamp at its end, where the start is held too, and
        those of ``contact`` (R, V, 3) on the vertices."""
        older, last = self._strains
        now = joint_strains(memory.frames)
        # After an impact, whose step is one of backward Euler, a rod remembers that velocity only.
        euler = (memory.places[..., 6:9] == memory.places[..., 9:12]).all(axis=(1, 2))[:, None, None]
        rate, extrapolation = np.where(euler, 1.0 / self.step, self.scheme[0]), np.where(euler, 0.0, self.scheme[1])
        rates, acceleration = (rate * (new - old - extrapolation * (old - before)) for new, old, before in (
            (now, last, older), (memory.places[..., 6:9], *self._velocities)))
        forces = self._gripper_forces(memory, end_force, contact, now, rates, acceleration)
        before = forces if self._forces is None else [
            np.where(np.isnan(old), new, old) for old, new in zip(self._forces, forces, strict=True)]
        frames, places = self._before
        ends = [0, -1]
        moves = memory.places[:, ends, :3] - places[:, ends]
        turns = rotation_vector(quaternion_product(memory.frames[:, ends], conjugate(frames[:, ends])))
        work = sum((0.5 * (a + b) * way).sum(axis=(1, 2)) for a, b, way in zip(before, forces, (moves, turns), strict=True))
        mean = 0.5 * (self._contact + contact)
        taken = -(mean * (memory.places[..., :3] - places)).sum(axis=(1, 2))
        new = self.losses.dissipated(memory, now - last, self.step) | {"contact": taken}
        stored = sum(self.losses.stored(memory, now).values())
        new["work"] = np.where(np.isnan(work), stored - self._stored + sum(new.values()), work)
        self._stored = stored
        self._flows = {name: self._flows[name] + new[name] for name in FLOWS}
        self._forces, self._contact, self._strains = forces, contact, (np.where(euler, now, last), now)
        self._keep(memory)
        if is_frame:
            self._store(memory)

    def _gripper_forces(self, memory: Memory, end_force: np.ndarray, contact: np.ndarray | float, strains: np.ndarray,
                        rates: np.ndarray, acceleration: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """((R, 2, 3) forces, (R, 2, 3) moments) of the grippers on the first and the last vertex and edge; ``rates`` are those
        of the ``strains``, ``acceleration`` (R, V, 3) that of the vertices.

        Of the forces f on the vertices, with inertia, drag and contact, the chain carries N_e = −Σ_{i>e} f_i − F_end through
        edge e; an edge is in balance under the joints' moments T, the gripper's and l t × (−N).
        """
        own = self.losses
        place, velocity = (memory.places[..., k : k + 3] for k in (0, 6))
        speed = np.linalg.norm(velocity, axis=-1)
        force = (-own.mass[..., None] * acceleration - (own.drag + own.drag_by_speed * speed)[..., None] * velocity
                 + own.force - own.weight[..., None] * own.up - own.spring_stiffness[..., None] * (place - own.spring_point)
                 + contact)
        total = force.sum(axis=1)
        end = np.where(self.held.all(axis=1)[:, None], end_force, np.where(self.held[:, 1:], -total, 0.0))
        start = np.where(self.held[:, :1], -total - end, 0.0)
        damping = np.concatenate([np.repeat(own.bend_damping[:, None], 4, axis=1), own.twist_damping[:, None]], axis=1)
        stress = own.stresses(strains - own.rest_strains()) + damping[:, None] * own.stresses(rates)
        joints = [_joint_moment(memory.frames[:, :2], stress[:, 0], 0), _joint_moment(memory.frames[:, -2:], stress[:, -1], 1)]
        edges = own.length[:, [0, -1], None] * tangent_from_quaternion(memory.frames[:, [0, -1]])
        through = np.stack([force[:, 0] + start, -force[:, -1] - end], axis=1)
        moments = np.cross(edges, through) - np.stack(joints, axis=1)
        return np.stack([start, end], axis=1), np.where(self.held[..., None], moments, 0.0)

    def detail(self, status: np.ndarray) -> Detail:
        """Frames, velocities and energies at the start and at all frames seen, of rods with that ``status`` (R, F).

        Energies are those of STORED and FLOWS, ``sum`` of the former, ``dissipated`` by drag, damping and contact together, and
        ``unaccounted``: the sum at the start and the work, less the sum and what was dissipated. That is lost by the scheme, or
        an error of this account; both are of the scheme's order in h. Gravity and loads count from the start.
        """
        frames, velocities, rows = zip(*self._instants, strict=True)
        failed = np.pad(status != Status.CONVERGED, ((0, 0), (1, 0)))
        parts = {name: np.where(failed, np.nan, np.stack([row[name] for row in rows], axis=1)) for name in (*STORED, *FLOWS)}
        for name in ("gravity", "loads"):
            parts[name] = parts[name] - parts[name][:, :1]
        if not self.losses.spring_stiffness.any():
            del parts["springs"]
        if not self.losses.force.any():
            del parts["loads"]
        if not self.touches:
            del parts["contact"]
        total = sum(parts[name] for name in STORED if name in parts)
        dissipated = sum(parts[name] for name in FLOWS if name != "work" and name in parts)
        energies = parts | {"sum": total, "dissipated": dissipated,
                            "unaccounted": total[:, :1] + parts["work"] - total - dissipated}
        lost = failed[..., None, None]
        return Detail(np.where(lost, np.nan, np.stack(frames, axis=1)), np.where(lost, np.nan, np.stack(velocities, axis=1)),
                      energies)


def joint_strains(frames: np.ndarray) -> np.ndarray:
    """(R, J, 5) of joints of (R, J + 1, 4) frames: κ = (κb·m2, −κb·m1) of the left frame, of the right one, and twist m."""
    x1, x2, y1, y2, turn = np.moveaxis(curvatures(frames), -1, 0)
    return np.stack([2.0 * x2, -2.0 * x1, 2.0 * y2, -2.0 * y1, turn], axis=-1)


def _joint_moment(frames: np.ndarray, stress: np.ndarray, edge: int) -> np.ndarray:
    """(R, 3) moment in the world of a joint with ``stress`` (R, 5) on its first or second ``edge``, of frames (R, 2, 4): minus
    the derivative of its energy by a turn of that edge, by differences of the strains."""
    turned = np.repeat(frames[None], len(TURNS), axis=0)
    turned[:, :, edge] = quaternion_product(TURNS[:, None], frames[:, edge])
    sides = joint_strains(turned.reshape(-1, 2, 4)).reshape(3, 2, len(frames), 5)
    return -((sides[:, 0] - sides[:, 1]) * stress).sum(axis=-1).T / (2.0 * SMALL_TURN)


def damping_shares(dynamics: Dynamics, count: int, rate: float) -> np.ndarray:
    """(count, 2) shares of rest curvature and twist that damping adds, r = τ a/h / (1 + τ a/h), of materials at the ``rate``
    a/h of a step."""
    tau = np.stack([dynamics.column(name, count) for name in ("bend_damping", "twist_damping")], axis=1)
    return tau * rate / (1.0 + tau * rate)


def stiffened(material: Material, dynamics: Dynamics, rate: float) -> Material:
    """The material with the stiffness that damping adds, and its rest curvature in that."""
    shares = damping_shares(dynamics, material.count, rate)
    if not shares.any():
        return material
    stiffer = 1.0 / (1.0 - shares)
    rest = np.zeros((1, 1, 2)) if material.rest_curvature is None else material.rest_curvature
    return Material(material.bend * stiffer[:, :1, None, None], material.twist * stiffer[:, 1:], material.weight,
                    rest * (1.0 - shares[:, :1, None]), material.weight_per_length)


def vertex_numbers(source: str, material: Material, dynamics: Dynamics, lengths: np.ndarray, rows: np.ndarray,
                   rate: float) -> np.ndarray:
    """(R, V, VERTEX_ITEMS − INERTIA) of rods with edges of ``lengths`` (1 or R, E) mm and the materials ``rows`` (R,), at the
    ``rate`` a/h of a step: what :mod:`doo_ti.relaxation.time_sweep` has of a vertex from INERTIA on, without loads.

    Raises InputError, naming ``source``, for rods without mass.
    """
    share, count = vertex_lengths(lengths), material.count
    weight = material.weight[rows]
    density = weight if dynamics.density is None else dynamics.column("density", count)[rows]
    if not (density > 0).all():
        raise InputError(source, "density", "zero, since the material has no weight", "give Dynamics(density=...)")
    point = dynamics.point_masses(count, share.shape[1])[rows]
    mass = 2.0 * density[:, None] / GRAVITY * share
    numbers = np.zeros((len(rows), share.shape[1], VERTEX_ITEMS - INERTIA))
    numbers[..., 0] = (mass + 2.0 * density[:, None] / GRAVITY * point) * rate**2
    numbers[..., DRAG - INERTIA] = mass * dynamics.column("drag", count)[rows, None] * rate
    numbers[..., DRAG_BY_SPEED - INERTIA] = mass * dynamics.column("quadratic_drag", count)[rows, None] * rate
    numbers[..., LOAD - INERTIA] = 2.0 * weight[:, None] * point
    return numbers


def add_loads(numbers: np.ndarray, loads: PointLoads, rate: float) -> None:
    """Add the masses, forces and springs of ``loads``, of R rows or one, to :func:`vertex_numbers`, in place."""
    numbers[..., 0] += loads.mass / GRAVITY * rate**2
    numbers[..., LOAD - INERTIA] += loads.mass
    numbers[..., FORCE - INERTIA : SPRING - INERTIA] = loads.force
    if loads.springs is not None:
        numbers[..., SPRING - INERTIA] = loads.springs.stiffness
        numbers[..., SPRING_POINT - INERTIA :] = loads.springs.points
