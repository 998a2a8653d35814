"""What a command works on: a scene's observations, and observations to a file."""

from dataclasses import replace
from pathlib import Path

import numpy as np

from doo_ti.io.observations import Observations, load_observations, save_observations
from doo_ti.io.scene import Scene, Synthesis
from doo_ti.terminal import in_line


def observed(scene: Scene, up: np.ndarray | None) -> Observations:
    """A scene's observations, loaded or synthesised, under the scene's name."""
    if isinstance(scene.observations, Synthesis):
        from doo_ti.synthesis import synthesise

        observations = synthesise(scene.observations)
        observations = replace(observations, sha256=scene.sha256)
    else:
        observations = load_observations(scene.observations)
    return replace(observations, name=scene.name, **({} if up is None else {"up": up}))


def save(out: Path, observations: Observations) -> None:
    out.parent.mkdir(parents=True, exist_ok=True)
    save_observations(out, observations)
    print(f"{observations.count} observations of {observations.edges + 1} vertices written to {in_line(out)}")
