"""A small artificial run, with different sizes of all axes, so that swapped axes are detected; and a recording, read back."""

from collections import defaultdict

import numpy as np

from doo_ti import LandscapePlane, Observed, Status
from doo_ti.rod.grid import Axis, Grid, valley

ITERATIONS, OBSERVATIONS, VERTICES, BENDS, RATIOS = 13, 6, 9, 5, 4


def observations(rng: np.random.Generator) -> np.ndarray:
    """(D, V, 3) mm: arches of three widths, twice each, all starting at the origin."""
    along, width = np.linspace(0, 1, VERTICES), np.repeat([30.0, 50.0, 70.0], 2)[:, None]
    arches = np.stack([width * along, 0 * width * along, (90 - width) * np.sin(np.pi * along) / 2], axis=-1)
    arches[:, 1:-1] += rng.normal(0, 0.3, (OBSERVATIONS, VERTICES - 2, 3))
    return arches


def grid() -> Grid:
    return Grid((Axis("bend", np.geomspace(1e5, 1e7, BENDS)), Axis("twist_ratio", np.geomspace(0.2, 5, RATIOS))))


def landscape() -> np.ndarray:
    """(G,) mm with the minimum in cell (2, 1) and one cell, (4, 3), not evaluated."""
    bend, ratio = np.meshgrid(np.arange(BENDS) - 2, np.arange(RATIOS) - 1, indexing="ij")
    values = 0.5 + 0.8 * bend**2 + 0.3 * ratio**2
    values[4, 3] = np.nan
    return values.reshape(-1)


def plane(**more) -> LandscapePlane:
    cells = grid()
    return LandscapePlane.of(cells.picture_axes, landscape().reshape(cells.shape), (2, 1, 0), **more)


def relaxation(rng: np.random.Generator) -> dict:
    """Arguments of `record_sweep` for a relaxation without a landscape."""
    from doo_ti.record.sweep import SweepTrajectory

    vertices, decay = observations(rng), np.exp(-np.arange(ITERATIONS))
    bump = np.sin(np.pi * np.linspace(0, 1, VERTICES))[None, :, None] * rng.normal(0, 4, (OBSERVATIONS, 1, 3))
    energy = 1e3 + 1e3 * decay[:, None] + rng.normal(0, 10, OBSERVATIONS)
    labels = {"end_distance_mm": np.repeat([30.0, 50.0, 70.0], 2), "end_rotation_deg": np.tile([0.0, 120.0], 3)}
    trajectory = SweepTrajectory(vertices + decay[:, None, None, None] * bump, energy,
                            0.1 * decay[:, None] ** 2 * np.ones(OBSERVATIONS), np.full(OBSERVATIONS, Status.CONVERGED),
                            np.linspace(0.4, 0.9, OBSERVATIONS))
    return {
        "run_id": "run-1", "name": "made up", "observed": Observed(vertices, labels), "trajectory": trajectory,
        "properties": {"seed": 7, "command": "doo-ti sweep a|b", "shape": (5, 4)}}


def sweep(rng: np.random.Generator) -> dict:
    return relaxation(rng) | {"plane": plane(), "intervals": valley(grid(), landscape())}


def read(path) -> tuple[dict, dict]:
    """{entity: {column: rows}} of static data, {entity: {timeline: {column: rows}}} of the rest, in the timeline's order."""
    from rerun.chunk import RrdReader

    static, moving = defaultdict(dict), defaultdict(lambda: defaultdict(lambda: defaultdict(list)))
    for chunk in RrdReader(path).stream():
        columns = chunk.to_record_batch().to_pydict()
        if chunk.is_static:
            static[chunk.entity_path].update(columns)
        for timeline in () if chunk.is_static else chunk.timeline_names:
            for name, rows in columns.items():
                moving[chunk.entity_path][timeline][name] += rows
    for timelines in moving.values():
        for timeline, columns in timelines.items():
            order = sorted(range(len(columns[timeline])), key=columns[timeline].__getitem__)
            timelines[timeline] = {name: [rows[k] for k in order] for name, rows in columns.items()}
    return static, moving
