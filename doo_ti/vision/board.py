"""Calibration boards: a chessboard, or ChArUco, a chessboard with markers in its white squares.

A board's own axes: origin at its first inner corner in reading order, x along a row, y up the page, z out of the page. A
chessboard is read with its black corner square at the upper left, which half a turn must not bring back: one of its two
numbers of corners is even, the other odd.
"""

import re
from dataclasses import dataclass

import numpy as np

from doo_ti.errors import InputError

FORMS = "chessboard:9x6:10 (inner corners, square in mm) or charuco:9x6:10:7 (squares, square and marker in mm)"
DICTIONARY = "DICT_4X4_50"


@dataclass(frozen=True)
class Board:
    """A flat board with inner corners at known places.

    columns, rows  inner corners of a chessboard, **squares** of a ChArUco board, as OpenCV counts them
    square         edge of a square, mm
    marker         edge of a marker, mm; None for a chessboard
    dictionary     of the markers, as ``cv2.aruco`` names it

    Raises InputError for a board too small, one that looks the same after half a turn, markers that do not fit into the
    squares, and a dictionary that is unknown or has too few markers.
    """

    columns: int
    rows: int
    square: float
    marker: float | None = None
    dictionary: str = DICTIONARY
    source: str = "board"

    def __post_init__(self):
        if min(self.columns, self.rows) < 3:
            raise self._error(f"{self.columns} x {self.rows} is too small", "use a board of at least 3 x 4")
        if not 0 < self.square < np.inf:
            raise self._error(f"squares of {self.square:g} mm", "give the edge of a square in mm")
        if self.marker is None:
            if (self.columns + self.rows) % 2 == 0:
                raise self._error(f"{self.columns} x {self.rows} corners look the same after half a turn",
                                  "use a board with one number even and the other odd, or ChArUco")
        else:
            self._check_markers()

    def _check_markers(self) -> None:
        if not 0 < self.marker < self.square:
            raise self._error(f"markers of {self.marker:g} mm in squares of {self.square:g} mm",
                              "give the edge of a marker in mm, smaller than a square")
        import cv2

        if not (self.dictionary.startswith("DICT_") and hasattr(cv2.aruco, self.dictionary)):
            known = [name for name in dir(cv2.aruco) if name.startswith("DICT_")]
            raise self._error(f"dictionary {self.dictionary!r}", f"use one of {', '.join(known)}")
        wanted, there = self.columns * self.rows // 2, len(self._markers().bytesList)
        if wanted > there:
            raise self._error(f"{wanted} markers, but {self.dictionary} has {there}", "name a larger dictionary")

    def _error(self, problem: str, remedy: str) -> InputError:
        return InputError(self.source, "--board", problem, remedy)

    def _markers(self):
        import cv2

        return cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, self.dictionary))

    @property
    def corners(self) -> tuple[int, int]:
        """Columns and rows of inner corners."""
        less = 0 if self.marker is None else 1
        return self.columns - less, self.rows - less

    @property
    def points(self) -> np.ndarray:
        """(N, 3) mm: the inner corners in the board's own axes, row by row."""
        columns, rows = self.corners
        row, column = np.divmod(np.arange(columns * rows), columns)
        return np.stack([self.square * column, -self.square * row, np.zeros(len(row))], axis=-1)

    def opencv(self):
        """The ``cv2.aruco.CharucoBoard``; its ``generateImage`` draws what to print."""
        import cv2

        return cv2.aruco.CharucoBoard((self.columns, self.rows), self.square, self.marker, self._markers())


def parse_board(text: str, source: str = "command line") -> Board:
    """The board that ``chessboard:9x6:10`` or ``charuco:9x6:10:7[:DICTIONARY]`` describes; InputError for anything else."""
    number = r"(\d+(?:\.\d*)?|\.\d+)"
    match = re.fullmatch(rf"(?:chessboard:(\d+)x(\d+):{number}|charuco:(\d+)x(\d+):{number}:{number}(?::(\w+))?)", text)
    if match is None:
        raise InputError(source, "--board", f"{text!r}", f"give {FORMS}")
    columns, rows, square = (match[at] or match[at + 3] for at in (1, 2, 3))
    marker = None if match[7] is None else float(match[7])
    return Board(int(columns), int(rows), float(square), marker, match[8] or DICTIONARY, source)
