"""Random tasks of manipulation, and the rods that a servo does not know: their stiffness, mesh, clips and rest curvature.

Rods of 330 mm between two grippers. A goal is the shape of the true rod after a random move of the grippers. Axes: B tasks.
"""

from dataclasses import dataclass, replace

import numpy as np

from doo_ti import Clamp, Clamps, Configuration, Material, Newton, Simulation, hanging, relax
from doo_ti.manipulation.model import held, moved

LENGTH, EDGES, BEND = 330.0, 33, 6e5
SPREAD = 0.4  # standard deviation of ln of the factors on B and on β/B
SPARE = 3  # tasks that are drawn for each that is kept: those whose rods cannot be held, or are taut, are not
TAUT = 0.97
NOISE = 0.3  # mm, of a mark's coordinate


@dataclass(frozen=True)
class Plant:
    """How true rods differ from a servo's model, besides their stiffness.

    finer          edges of theirs for each of the model's
    clip_mm, clip_deg  standard deviations of what their clips are displaced and turned by
    curvature      1/mm, root mean square of each component of their rest curvature, a sum of four waves along the rod
    """

    finer: int = 1
    clip_mm: float = 0.0
    clip_deg: float = 0.0
    curvature: float = 0.0


@dataclass(frozen=True)
class Tasks:
    """B tasks.

    rods, clamps  the servo's model and the grippers' poses at the beginning
    nominal       its material, B rows
    goal          (B, V, 3) mm, of the true rod after the move
    goal_clamps   where the grippers were then
    real          the true rods at the beginning
    true          their material, B rows; ``factors`` (2, B) on B and on β/B
    clip          (B, 12) how true rods are held
    finer         their edges for each of the model's
    """

    rods: Configuration
    clamps: Clamps
    nominal: Material
    goal: np.ndarray
    goal_clamps: Clamps
    real: Configuration
    true: Material
    factors: np.ndarray
    clip: np.ndarray
    finer: int

    @property
    def count(self) -> int:
        """B."""
        return len(self.goal)

    def simulation(self) -> Simulation:
        """The true rods at the beginning."""
        return Simulation(self.real, self.true, held(self.clamps, self.clip))

    def vertices(self, rods: Configuration) -> np.ndarray:
        """(B, V, 3) mm, of true rods, where the model has vertices."""
        return rods.vertices[:, :: self.finer]

    def marks(self, rods: Configuration, number: int, random: np.random.Generator) -> np.ndarray:
        """(B, V, 3) mm: that ``number`` of marks with noise, NaN at the other vertices."""
        vertices = self.vertices(rods)
        rows = np.linspace(0, vertices.shape[1] - 1, number).round().astype(int)
        seen = np.full_like(vertices, np.nan)
        seen[:, rows] = vertices[:, rows] + NOISE * random.normal(size=seen[:, rows].shape)
        return seen

    def take(self, rows: np.ndarray) -> "Tasks":
        """Those named by ``rows``."""
        rods = {name: getattr(self, name).take(rows) for name in ("rods", "clamps", "nominal", "goal_clamps", "real", "true")}
        return replace(self, goal=self.goal[rows], factors=self.factors[:, rows], clip=self.clip[rows], **rods)


def tasks(count: int, seed: int, plant: Plant = Plant(), both: bool = True) -> Tasks:  # noqa: B008
    """``count`` tasks from a seed, moved by ``both`` grippers or by the far one."""
    random = np.random.default_rng(seed)
    drawn = SPARE * count
    factors = np.exp(SPREAD * random.normal(size=(2, drawn)))
    ends = np.zeros((drawn, 3))
    ends[:, 0] = random.uniform(120.0, 280.0, drawn)
    real, clamps = hanging(LENGTH, EDGES * plant.finer, np.zeros((drawn, 3)), ends, clamp=Clamp.FRAME)
    rods, _ = hanging(LENGTH, EDGES, np.zeros((drawn, 3)), ends, clamp=Clamp.FRAME)
    clamps = moved(clamps, np.repeat([0.0, 0.3, 20.0, 0.3], 3) * random.normal(size=(drawn, 12)))
    clip = np.tile(np.repeat([plant.clip_mm, np.radians(plant.clip_deg)], 3), 2) * random.normal(size=(drawn, 12))
    nominal = Material(np.full(drawn, BEND), np.full(drawn, BEND))
    true = Material(BEND * factors[0], BEND * factors[0] * factors[1], 1.0, _curvature(plant, real.edges - 1, drawn, random))
    begin = relax(real, true, held(clamps, clip), Newton.careful())
    model = relax(rods, nominal, clamps, Newton.careful())
    move = np.repeat([70.0, 0.6, 70.0, 0.6] if both else [0.0, 0.0, 95.0, 0.8], 3) * random.normal(size=(drawn, 12))
    goal_clamps = moved(clamps, move)
    end = Simulation(begin.configuration, true, held(clamps, clip)).step(held(goal_clamps, clip))
    apart = np.linalg.norm(goal_clamps.end_position - goal_clamps.start_position, axis=1)
    sound = begin.converged & begin.stable & model.converged & model.stable & end.converged & end.stable
    rows = np.flatnonzero(sound & (apart < TAUT * LENGTH))[:count]
    if len(rows) < count:
        raise RuntimeError(f"{len(rows)} of {count} tasks: draw more")
    goal = end.configuration.vertices[:, :: plant.finer]
    every = Tasks(rods, clamps, nominal, goal, goal_clamps, begin.configuration, true, factors, clip, plant.finer)
    return every.take(rows)


def _curvature(plant: Plant, joints: int, count: int, random: np.random.Generator) -> np.ndarray | None:
    """(B, joints, 2) 1/mm."""
    if not plant.curvature:
        return None
    waves = np.cos(np.pi * np.arange(4)[:, None] * np.linspace(0.0, 1.0, joints)) / np.sqrt(2.5)
    return plant.curvature * np.einsum("bka,kj->bja", random.normal(size=(count, 4, 2)), waves)
