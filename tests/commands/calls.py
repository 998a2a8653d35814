"""Calls of commands: small inputs, and the checks that they succeed or refuse."""

from pathlib import Path

import numpy as np

from doo_ti.commands.cli import main
from tests.conftest import SEED
from tests.io.rods import twisted_frames, wavy_vertices

MATERIAL = ["--bend", "6e5", "--twist", "8e5", "--weight", "1"]


def good_keys() -> dict[str, np.ndarray]:
    rng = np.random.default_rng(SEED)
    vertices, twist = wavy_vertices(rng), np.array([0.1, -2.0, 4.0])
    frames, lengths = twisted_frames(vertices, twist, rng), np.linalg.norm(np.diff(vertices, axis=1), axis=-1).max(axis=0)
    return {"vertices_mm": vertices, "rest_length_mm": lengths, "start_frame": frames[:, 0], "end_frame": frames[:, -1],
            "total_twist_deg": np.degrees(twist)}


def write_good(folder: Path) -> None:
    np.savez(folder / "good.npz", **good_keys())


def written(path: Path) -> dict[str, np.ndarray]:
    with np.load(path, allow_pickle=False) as file:
        return dict(file)


def tree(folder: Path) -> dict[str, bytes | None]:
    return {str(path): path.read_bytes() if path.is_file() else None for path in sorted(folder.rglob("*"))}


def words_of(argv: str | list) -> list[str]:
    return argv.split() if isinstance(argv, str) else list(map(str, argv))


def ended(capsys, argv: str | list, code: int = 0) -> tuple[str, str]:
    """Run the command, which has that exit code: its output and its messages."""
    capsys.readouterr()
    assert main(words_of(argv)) == code
    return capsys.readouterr()


def succeeded(capsys, argv: str | list) -> str:
    """Run the command, which has exit code 0: what it printed."""
    return ended(capsys, argv)[0]


def made(argv: str | list) -> dict[str, np.ndarray]:
    """Run the command, which has exit code 0: the arrays of the npz after ``--out``."""
    words = words_of(argv)
    assert main(words) == 0
    return written(Path(words[words.index("--out") + 1]))


def refused(capsys, folder: Path, argv: str | list, *words: str) -> None:
    """Run the command and check that it is refused in one line that holds ``words``."""
    before = tree(folder)
    capsys.readouterr()
    code = main(words_of(argv))
    out, err = capsys.readouterr()
    assert code == 2, err
    assert err.count("\n") == 1 and err.endswith("\n") and out == ""
    assert "Traceback" not in err and err.startswith("doo-ti: ") and "; " in err
    for word in words:
        assert word in err
    assert tree(folder) == before
