"""Marks of cables and sutures as people would give them: a folder per specimen, drawn from its seed.

``marks.csv`` (pose, mark, x, y, z in m; missing marks have no row), ``spacing.txt`` (mm, where the lengths between marks were
measured), ``marks.npz`` (where the frames of the grippers are known), ``truth.json``. What a nuisance draws does not depend on
which others are on. Without the nuisance ``turns`` the file states total twists, from which whole turns follow.
"""

import json
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

from tools.studies.marks_study.rod import equilibria, points, turned

FAMILIES = ("cable", "suture")
ALWAYS = ("spacing", "clip", "frames")
SOMETIMES = {"chord": 0.5, "missing": 0.5, "mislabel": 0.5, "curvature": 0.8, "uneven": 0.35, "stiffness": 0.5}
NUISANCES = (*ALWAYS, *SOMETIMES, "turns")
GRAVITY = 9.81
DEGREES = ((50, 30), (500, 40), (1500, 50), (np.inf, 60))  # weight w L³ / EI below which this degree resolves the rod
CHANCES = 4  # times as many poses are tried as are wanted


@dataclass(frozen=True)
class Recipe:
    """One rod and how it was measured; lengths in m, EI and GJ in N m²."""

    family: str
    seed: int
    nuisances: tuple[str, ...]
    EI: float
    GJ: float
    grams_per_metre: float
    free: float             # length between the clips
    poses: int
    marks: int
    noise: float
    clip: tuple[float, float]
    up: str
    frames_given: bool
    spacings_stated: bool

    @property
    def load(self) -> float:
        """w L³ / EI."""
        return self.grams_per_metre * 1e-3 * GRAVITY * self.free**3 / self.EI


def stream(family: str, seed: int, name: str) -> np.random.Generator:
    return np.random.default_rng([seed, FAMILIES.index(family), ("recipe", "poses", "noise", "which", *NUISANCES).index(name)])


def drawn(family: str, seed: int, nuisances: tuple[str, ...] | None = None, small: bool = False) -> Recipe:
    """The recipe of a seed, with these nuisances, or drawn ones; ``small``: 12 poses of 13 marks, or 20 poses of a suture."""
    if nuisances is None:
        chance = stream(family, seed, "which").random(len(SOMETIMES))
        nuisances = ALWAYS + tuple(n for n, c in zip(SOMETIMES, chance, strict=True) if c < SOMETIMES[n]) + ("turns",)
    rng = stream(family, seed, "recipe")

    def log(low, high):
        return float(np.exp(rng.uniform(np.log(low), np.log(high))))

    while True:
        if family == "cable":
            EI, grams, free, clip = log(2e-4, 3e-2), log(20, 120), rng.uniform(0.5, 1.5), rng.uniform(0.01, 0.05, 2)
            poses, marks, noise = rng.integers(10, 26), rng.integers(9, 31), log(2e-4, 1e-3)
            given, lightest, heaviest = rng.random() < 0.5, 3.0, 2500.0
        else:
            EI, grams, free, clip = log(1.5e-7, 2e-6), log(0.2, 0.6), rng.uniform(0.08, 0.12), rng.uniform(0.0015, 0.004, 2)
            poses, noise = rng.integers(20, 61), log(5e-5, 2e-4)
            marks, given, lightest, heaviest = round(free / rng.uniform(0.0025, 0.004)) + 1, True, 1.0, 2500.0
        GJ, up, stated = EI * log(0.3, 1.5), "yz"[rng.integers(2)], rng.random() < 0.5
        if small:
            poses, marks = (12, 13) if family == "cable" else (20, marks)
        recipe = Recipe(family, seed, nuisances, EI, GJ, grams, float(free), int(poses), int(marks), noise,
                        (float(clip[0]), float(clip[1])), up, bool(given), bool(stated))
        if lightest < recipe.load < heaviest:
            return recipe


def mark_lengths(recipe: Recipe) -> tuple[np.ndarray, np.ndarray]:
    """Places of the marks along the rod from the end of the start clip, and the spacings that the user believes, in m."""
    on, edges = recipe.nuisances, recipe.marks - 1
    share = np.ones(edges)
    if "uneven" in on:
        share *= stream(recipe.family, recipe.seed, "uneven").uniform(0.6, 1.4, edges)
    rng, held = stream(recipe.family, recipe.seed, "clip"), np.zeros(2)
    if "clip" in on:
        held = rng.uniform(0.15, 0.95, 2) * recipe.clip
    if "chord" in on:
        held = -stream(recipe.family, recipe.seed, "chord").uniform(0.1, 0.8, 2) * recipe.free / edges
    true = share * (1 + stream(recipe.family, recipe.seed, "spacing").uniform(-0.02, 0.02, edges)) if "spacing" in on else share
    scale = (recipe.free + held.sum()) / true.sum()
    return np.concatenate([[0], np.cumsum(true * scale)]) - held[0], share * scale


def rest_curvature(recipe: Recipe, s: np.ndarray) -> np.ndarray:
    """(len(s), 3) in 1/m: a smooth random field whose root mean square is one over the radius."""
    field = np.zeros((len(s), 3))
    if "curvature" in recipe.nuisances:
        rng = stream(recipe.family, recipe.seed, "curvature")
        radius, order = np.exp(rng.uniform(np.log(0.4), np.log(2.0))), np.arange(6)
        size = rng.normal(size=(2, 6)) / (1 + (order / 2) ** 2)
        size /= radius * np.sqrt((size[:, 0] ** 2 + (size[:, 1:] ** 2).sum(-1) / 2).sum())  # of the mean of squares over s
        field[:, 1:] = np.cos(np.pi * order * s[:, None]) @ size.T
    return field


def stiffness_along(recipe: Recipe, s: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """(len(s),) of the bend and twist stiffness over their geometric means: two waves, of 3 to 12 % together. ``weights`` of
    the mean over s."""
    wave = np.zeros(len(s))
    if "stiffness" in recipe.nuisances:
        rng = stream(recipe.family, recipe.seed, "stiffness")
        order, phase = rng.integers(1, 4, (2, 1)) / 1.3, rng.uniform(0, 2 * np.pi, (2, 1))
        wave = np.sin(2 * np.pi * order * s + phase).sum(axis=0)
        wave -= weights @ wave
        wave *= rng.uniform(0.03, 0.12) / np.sqrt(weights @ wave**2)
    return np.exp(wave)


def frame_along(tangent: np.ndarray) -> np.ndarray:
    side = np.cross([0, 0, 1.0], tangent)
    side /= np.linalg.norm(side, axis=-1, keepdims=True)
    return np.stack([tangent, side, np.cross(tangent, side)], axis=-1)


def clamps(recipe: Recipe, count: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Start frames, end places over the free length, and end frames of ``count`` poses, z up."""
    rng, cable = stream(recipe.family, recipe.seed, "poses"), recipe.family == "cable"
    azimuth, elevation = rng.uniform(-np.pi, np.pi, count), np.radians(rng.uniform(-25, 25, count))
    away = np.radians(rng.uniform(10, 60, count)) * rng.choice([-1, 1], count)
    dip = np.radians(rng.uniform(-55, 20, count))

    def direction(a, e):
        return np.stack([np.cos(a) * np.cos(e), np.sin(a) * np.cos(e), np.sin(e)], axis=-1)

    chord, start = direction(azimuth, elevation), frame_along(direction(azimuth + away, dip))
    roll = np.radians(rng.uniform(-60, 60, (count, 1))) if cable else rng.uniform(-np.pi, np.pi, (count, 1))
    start = start @ turned(roll * [1, 0, 0])
    turn = 2 * np.arccos(np.clip((start[:, :, 0] * chord).sum(-1), -1, 1))
    axis = np.cross(start[:, :, 0], chord)
    arc = turned(axis / np.linalg.norm(axis, axis=-1, keepdims=True) * turn[:, None]) @ start
    twist = np.radians(rng.uniform(-1, 1, (count, 1)) * (100 if cable else 170))
    end = arc @ turned(rng.uniform(-0.5, 0.5, (count, 3)) * [0, 1, 1]) @ turned(twist * [1, 0, 0])
    return start, chord * rng.uniform(0.4, 0.93, (count, 1)), end


def exact(recipe: Recipe) -> tuple[np.ndarray, ...]:
    """Marks (poses, marks, 3) in m without noise, z up, the true frames of both clips, and the total twists in degrees."""
    degree = next(degree for load, degree in DEGREES if recipe.load < load)
    arc, count = mark_lengths(recipe)[0] / recipe.free, recipe.poses
    start, span, end = clamps(recipe, CHANCES * count)
    at, weight = points(degree), np.array([0, 0, recipe.load])
    kappa, stiffness = rest_curvature(recipe, at.s) * recipe.free, stiffness_along(recipe, at.s, at.weights)
    taken, kept = [], 0
    for rows in np.array_split(np.arange(len(span)), max(1, round(CHANCES / 1.25))):
        if kept < count:
            rods, right = equilibria(degree, recipe.GJ / recipe.EI, np.tile(weight, (len(rows), 1)), start[rows], span[rows],
                                     end[rows], kappa, stiffness)
            inside = rods.points_at(np.clip(arc, 0, 1))[right]
            first, last = rods.frames[right, 0], rods.frames[right, -1]
            inside += np.minimum(arc, 0)[:, None] * first[:, None, :, 0] + np.maximum(arc - 1, 0)[:, None] * last[:, None, :, 0]
            twist = np.degrees(rods.bending()[right, :, 0] @ rods.at.weights)
            taken.append((inside * recipe.free, first, last, twist))
            kept += right.sum()
    if kept < count:
        raise RuntimeError(f"{recipe.family} {recipe.seed}: {kept} of {count} poses are stable")
    return tuple(np.concatenate(part)[:count] for part in zip(*taken, strict=True))


def specimen(recipe: Recipe, folder: Path) -> dict:
    """Write the specimen's files, and return what is in ``truth.json``."""
    marks, first, last, twist = exact(recipe)
    count, each, on = *marks.shape[:2], recipe.nuisances
    turn = np.eye(3) if recipe.up == "z" else np.array([[1, 0, 0], [0, 0, 1], [0, -1, 0.0]])
    seen = (marks + recipe.noise * stream(recipe.family, recipe.seed, "noise").normal(size=marks.shape)) @ turn.T
    first, last = turn @ first, turn @ last
    if "frames" in on and recipe.frames_given:
        rng = stream(recipe.family, recipe.seed, "frames")
        scatter = np.radians(rng.uniform(0, 0.4))
        off = rng.normal(size=(2, 3))
        off *= (np.radians(rng.uniform(0, 2, 2)) / np.linalg.norm(off, axis=1))[:, None]
        first, last = (frames @ turned(off[end] + scatter * rng.normal(size=(count, 3)) / np.sqrt(3))
                       for end, frames in enumerate((first, last)))
    there, bad, label = np.ones((count, each), bool), None, "none"
    if "missing" in on:
        rng = stream(recipe.family, recipe.seed, "missing")
        there = rng.random((count, each)) > rng.uniform(0, 0.15)
        outer = rng.random((count, 2)) > rng.choice([0, 0.3])
        there[:, [0, -1]] &= outer
    if "mislabel" in on:
        rng = stream(recipe.family, recipe.seed, "mislabel")
        bad, label = int(rng.integers(count)), ("reversed", "swapped")[rng.integers(2)]
        order = np.arange(each)
        i = int(rng.integers(1, each - 3))
        order[[i, i + 2]] = order[[i + 2, i]]
        order = order[::-1] if label == "reversed" else order
        seen[bad], there[bad] = seen[bad][order], there[bad][order]
    folder.mkdir(parents=True, exist_ok=True)
    rows = [f"{p},{m},{x:.6f},{y:.6f},{z:.6f}\n" for p in range(count) for m in range(each) if there[p, m]
            for x, y, z in [seen[p, m]]]
    (folder / "marks.csv").write_text("pose,mark,x,y,z\n" + "".join(rows))
    arc, believed = mark_lengths(recipe)
    if recipe.spacings_stated:
        (folder / "spacing.txt").write_text("".join(f"{1e3 * one:.3f}\n" for one in believed))
    if recipe.frames_given:
        counted = {} if "turns" in on else {"total_twist_deg": twist}
        np.savez(folder / "marks.npz", vertices_mm=np.where(there[..., None], 1e3 * seen, np.nan),
                 up=turn @ [0, 0, 1.0], start_frame=first, end_frame=last, **counted)
    truth = {**asdict(recipe), "load": recipe.load, "arc": arc.tolist(), "mislabel": label, "bad_pose": bad}
    (folder / "truth.json").write_text(json.dumps(truth))
    return truth
