"""Arrays from pickles, without unpickling: no name in a file is ever imported.

A pickle names functions and classes that its reader calls, so that reading one runs what it names. Here the few names of which
NumPy's arrays consist stand for the small classes below, which keep numbers and do nothing else; any other name is refused.
"""

import io
import math
import pickle
from pathlib import Path

import numpy as np

from doo_ti.errors import InputError
from doo_ti.io.arrays import first_line
from doo_ti.io.files import read_content

MOST_FILE_BYTES = 1 << 28
KINDS = "fiu"
REMEDY = "give a pickle of NumPy arrays of plain numbers, or lists of them"


class _Kind:
    """A dtype of numbers."""

    def __init__(self, code="", align=False, copy=False):
        self.dtype = np.dtype(code) if isinstance(code, str) and len(code) <= 3 and code[:1] in KINDS else None
        if self.dtype is None or self.dtype.kind not in KINDS:
            raise pickle.UnpicklingError(f"dtype {str(code)[:20]!r}")

    def __setstate__(self, state):
        order = state[1] if isinstance(state, tuple) and len(state) >= 2 else None
        if order not in ("<", ">", "|", "="):
            raise pickle.UnpicklingError("a dtype's state")
        self.dtype = self.dtype.newbyteorder(order)


class _Array:
    """An array, filled from its bytes; ``value`` is None until then."""

    value = None

    def fill(self, shape, kind: _Kind, content: bytes, fortran: bool) -> "_Array":
        sound = isinstance(kind, _Kind) and isinstance(content, bytes | bytearray) and isinstance(shape, tuple)
        if not sound or any(type(side) is not int or side < 0 for side in shape):
            raise pickle.UnpicklingError("an array's state")
        if math.prod(shape) * kind.dtype.itemsize != len(content):
            raise pickle.UnpicklingError(f"{len(content)} bytes for shape {shape}")
        self.value = np.frombuffer(bytes(content), kind.dtype).reshape(shape, order="F" if fortran else "C")
        return self

    def __setstate__(self, state):
        if not isinstance(state, tuple) or len(state) != 5:
            raise pickle.UnpicklingError("an array's state")
        _, shape, kind, fortran, content = state
        self.fill(shape, kind, content, bool(fortran))


def _reconstruct(kind, shape, code) -> _Array:
    return _Array()


def _from_buffer(content, kind, shape, order) -> _Array:
    return _Array().fill(shape, kind, content, order == "F")


def _scalar(kind, content) -> _Array:
    return _Array().fill((), kind, content, False)


def _encoded(text, code) -> bytes:
    """How protocol 2 writes bytes."""
    if not isinstance(text, str) or code != "latin1":
        raise pickle.UnpicklingError("bytes")
    return text.encode("latin1")


MULTIARRAY = ("numpy.core.multiarray", "numpy._core.multiarray")
ALLOWED = {
    ("numpy", "ndarray"): _Array, ("numpy", "dtype"): _Kind, ("_codecs", "encode"): _encoded,
    **{(module, "_reconstruct"): _reconstruct for module in MULTIARRAY},
    **{(module, "scalar"): _scalar for module in MULTIARRAY},
    **{(module, "_frombuffer"): _from_buffer for module in ("numpy.core.numeric", "numpy._core.numeric")},
}


class _Reader(pickle.Unpickler):
    def find_class(self, module, name):
        if (module, name) not in ALLOWED:
            raise pickle.UnpicklingError(f"names {f'{module}.{name}'[:80]}")
        return ALLOWED[module, name]


def read_pickled_array(path: Path) -> np.ndarray:
    """The array in a pickle: one, or a list of arrays of one shape, stacked, float64.

    Raises InputError for a file that names anything but arrays, is damaged, or holds something else.
    """
    try:
        found = _Reader(io.BytesIO(read_content(path, MOST_FILE_BYTES))).load()
    except InputError:
        raise
    except Exception as error:  # a damaged pickle may raise anything
        raise InputError(path, "file", f"not a pickle of arrays ({first_line(error)})", REMEDY) from None
    rows = found if isinstance(found, list) else [found]
    arrays = [row.value if isinstance(row, _Array) else None for row in rows]
    if not arrays or any(array is None for array in arrays) or len({array.shape for array in arrays}) > 1:
        raise InputError(path, "file", "holds no array, or arrays of different shapes", REMEDY)
    stacked = np.stack(arrays).astype(np.float64)
    return stacked if isinstance(found, list) else stacked[0]
