"""Commands run in an empty folder; a file that one writes appears when it is complete: none is opened by its own name."""

import os
import sys
from pathlib import Path

import pytest

from doo_ti.commands import cli

TESTS = str(Path(__file__).parents[1])
opened: list[str] = []


def _watch(event: str, arguments: tuple) -> None:
    if event == "open" and isinstance(arguments[0], (str, os.PathLike)) and arguments[2] & (os.O_WRONLY | os.O_RDWR):
        frame = sys._getframe(1)
        while frame is not None and not frame.f_code.co_filename.startswith((cli.__file__, TESTS)):
            frame = frame.f_back
        if frame is not None and frame.f_code.co_filename == cli.__file__:  # not what stands in for a part of the command
            opened.append(os.path.abspath(arguments[0]))


sys.addaudithook(_watch)


@pytest.fixture(autouse=True)
def written_whole(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    opened.clear()
    yield
    assert [path for path in opened if Path(path).is_relative_to(tmp_path) and not path.endswith(".part")] == []
