"""Arrays from pickles, without unpickling: no name in a file is ever imported.

A pickle names functions and classes that its reader calls, so that reading one runs what it names. Here the few names of which
NumPy's arrays consist stand for the small classes below, which keep numbers and do nothing else; any other name is refused.

A few bytes can also make a reader fill the memory, or compute without end. So the instructions of a file are read before any is
carried out: they are those of lists, tuples, text, whole numbers and arrays, and what is kept to be used again has the next
number. Arrays are filled at the end, when it is known that together they have no more numbers than the file has bytes.
"""

import io
import math
import pickle
import pickletools
from pathlib import Path

import numpy as np

from doo_ti.io.arrays import first_line
from doo_ti.system.errors import InputError
from doo_ti.system.files import read_content

MOST_FILE_BYTES = 1 << 28
KINDS = "fiu"
REMEDY = "give a pickle of NumPy arrays of plain numbers, or lists of them"


class _Kind:
    """A dtype of numbers."""

    def __init__(self, code="", align=False, copy=False):
        if not isinstance(code, str) or len(code) > 3 or code[:1] not in KINDS:
            raise pickle.UnpicklingError("a dtype that is not of plain numbers")
        self.dtype = np.dtype(code)

    def __setstate__(self, state):
        order = state[1] if isinstance(state, tuple) and len(state) >= 2 else None
        if order not in ("<", ">", "|", "="):
            raise pickle.UnpicklingError("a dtype's state")
        self.dtype = self.dtype.newbyteorder(order)


class _Array:
    """The parts of an array: ``shape``, None until they are there, ``content``: bytes, or text of a character for each."""

    shape = None

    def fill(self, shape, kind: _Kind, content, fortran: bool) -> "_Array":
        sound = isinstance(kind, _Kind) and isinstance(content, bytes | bytearray | str) and isinstance(shape, tuple)
        if not sound or any(type(side) is not int or side < 0 for side in shape):
            raise pickle.UnpicklingError("an array's state")
        if math.prod(shape) * kind.dtype.itemsize != len(content):
            raise pickle.UnpicklingError(f"{len(content)} bytes for shape {shape}")
        self.shape, self.dtype, self.content, self.order = shape, kind.dtype, content, "F" if fortran else "C"
        return self

    def __setstate__(self, state):
        if not isinstance(state, tuple) or len(state) != 5:
            raise pickle.UnpicklingError("an array's state")
        _, shape, kind, fortran, content = state
        self.fill(shape, kind, content, bool(fortran))

    def value(self) -> np.ndarray:
        content = self.content.encode("latin1") if isinstance(self.content, str) else bytes(self.content)
        return np.frombuffer(content, self.dtype).reshape(self.shape, order=self.order)


def _reconstruct(kind, shape, code) -> _Array:
    return _Array()


def _from_buffer(content, kind, shape, order) -> _Array:
    return _Array().fill(shape, kind, content, order == "F")


def _scalar(kind, content) -> _Array:
    return _Array().fill((), kind, content, False)


def _encoded(text, code) -> str:
    """How protocol 2 writes bytes: text, a character for each."""
    if not isinstance(text, str) or code != "latin1":
        raise pickle.UnpicklingError("bytes")
    return text


MULTIARRAY = ("numpy.core.multiarray", "numpy._core.multiarray")
ALLOWED = {
    ("numpy", "ndarray"): _Array, ("numpy", "dtype"): _Kind, ("_codecs", "encode"): _encoded,
    **{(module, "_reconstruct"): _reconstruct for module in MULTIARRAY},
    **{(module, "scalar"): _scalar for module in MULTIARRAY},
    **{(module, "_frombuffer"): _from_buffer for module in ("numpy.core.numeric", "numpy._core.numeric")},
}


INSTRUCTIONS = frozenset("""
    PROTO FRAME STOP MARK GLOBAL STACK_GLOBAL REDUCE BUILD NONE NEWTRUE NEWFALSE INT BININT BININT1 BININT2 LONG LONG1 LONG4
    EMPTY_TUPLE TUPLE TUPLE1 TUPLE2 TUPLE3 EMPTY_LIST LIST APPEND APPENDS PUT BINPUT LONG_BINPUT MEMOIZE GET BINGET LONG_BINGET
    STRING BINSTRING SHORT_BINSTRING UNICODE BINUNICODE SHORT_BINUNICODE BINUNICODE8 BINBYTES SHORT_BINBYTES BINBYTES8
    BYTEARRAY8
""".split())
"""Without dictionaries and sets: the hash of nested tuples can take for ever."""
PUTS = ("PUT", "BINPUT", "LONG_BINPUT")


def _check_instructions(content: bytes) -> None:
    """Raise an error unless the bytes are whole instructions of the allowed kinds."""
    for number, (instruction, argument, _) in enumerate(pickletools.genops(content)):
        if instruction.name not in INSTRUCTIONS:
            raise pickle.UnpicklingError(f"the instruction {instruction.name}")
        if instruction.name in PUTS and not 0 <= argument <= number:
            raise pickle.UnpicklingError(f"keeps a value under number {str(argument)[:20]}")


class _Reader(pickle.Unpickler):
    def find_class(self, module, name):
        if (module, name) not in ALLOWED:
            raise pickle.UnpicklingError(f"names {f'{module}.{name}'[:80]}")
        return ALLOWED[module, name]


def read_pickled_array(path: Path) -> np.ndarray:
    """The array in a pickle: one, or a list of arrays of one shape, stacked, float64.

    Raises InputError for a file that names anything but arrays, is damaged, or holds something else.
    """
    content = read_content(path, MOST_FILE_BYTES)
    try:
        _check_instructions(content)
        found = _Reader(io.BytesIO(content)).load()
        rows = found if isinstance(found, list) else [found]
        shapes = {row.shape if isinstance(row, _Array) else None for row in rows}
        if None in shapes or len(shapes) != 1:
            raise pickle.UnpicklingError("no array, or arrays of different shapes")
        if len(rows) * math.prod(*shapes) > len(content):
            raise pickle.UnpicklingError("one array again and again")
        stacked = np.stack([row.value() for row in rows]).astype(np.float64)
    except Exception as error:  # a damaged pickle may raise anything
        raise InputError(path, "file", f"not a pickle of arrays ({first_line(error)})", REMEDY) from None
    return stacked if isinstance(found, list) else stacked[0]
