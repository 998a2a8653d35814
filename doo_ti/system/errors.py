"""Errors that a user can cause; each message names place, problem and remedy.

A rod that cannot be computed is not an error: it has a :class:`~doo_ti.rod.types.Status`.
"""

from numbers import Integral

import numpy as np

MOST_EDGES = 1_000_000  # of a rod


class InputError(ValueError):
    """Wrong input. The command line prints it as one line and exits with code 2. It replaces arguments of the library by its
    options: the ``field`` where the source is not a file, and names in `backticks`.

    Parameters
    ----------
    source: the file, option or argument at fault.
    field: the key, column or option in it.
    problem: the value, and why it is wrong.
    remedy: what to give instead.
    """

    def __init__(self, source: str, field: str, problem: str, remedy: str):
        self.source: str = str(source)
        self.field: str = str(field)
        self.problem: str = problem
        self.remedy: str = remedy
        super().__init__(" ".join(f"{source}: {field}: {problem}; {remedy}".split()))

    def __reduce__(self) -> tuple[type, tuple[str, str, str, str]]:
        """The parts of the error, so that it can be sent from one process to another."""
        return type(self), (self.source, self.field, self.problem, self.remedy)


class InterruptedRunError(RuntimeError):
    """A long run stopped early; finished work is kept and the message states how to resume (exit code 1)."""


def require(holds: object, source, field: str, problem: str, remedy: str) -> None:
    """Raise InputError, of which these are the parts, unless it ``holds``."""
    if not holds:
        raise InputError(source, field, problem, remedy)


def require_whole(source: str, field: str, value, least: int, most: int = 2**31 - 1) -> None:
    """Raise InputError unless ``value`` is a whole number from ``least`` to ``most``, at most what kernels can count to."""
    if not isinstance(value, Integral) or isinstance(value, bool) or not least <= value <= most:
        shown = "beyond all bounds" if isinstance(value, Integral) and abs(value) > 2**63 else f"{value!r}"
        raise InputError(source, field, shown, f"give a whole number from {least} to {most}")


def real_array(source: str, field: str, value, remedy: str, kinds: str = "fiu") -> np.ndarray:
    """``value`` as an array of real numbers. Raises InputError for text, booleans and complex numbers.

    kinds  NumPy's letters of the allowed kinds of dtype, ``b`` for booleans
    """
    array = np.asarray(value)
    if array.dtype.kind not in kinds:
        raise InputError(source, field, f"dtype {array.dtype} is not numeric", remedy)
    return array
