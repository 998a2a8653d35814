"""Scenes that come with the package: commands take them by name in any folder, ``vicryl``, ``whip``, ``scenes/rig.yaml``."""

from pathlib import Path

PACKAGE = Path(__file__).parents[1]
INSTALLED, SOURCE = PACKAGE / "scenes", PACKAGE.parent / "scenes"
"""Where they lie in an installed package, and in its source."""


def scene_file(name: str) -> str:
    """``name`` where there is such a file or folder, else the scene of that name that comes with the package, else ``name``."""
    asked = Path(name)
    if not name or asked.exists() or asked.is_absolute() or ".." in asked.parts:
        return name
    folder = INSTALLED if INSTALLED.is_dir() else SOURCE
    within = Path(*asked.parts[1:]) if asked.parts[0] == "scenes" and len(asked.parts) > 1 else asked
    for place in (folder, folder / "motion", folder / "groups"):
        for file in (place / within, place / within.with_suffix(".toml")):
            if file.is_file():
                return str(file)
    return name
