"""The kernels that give every thread a loop of its own: one factory for all, from the names and types of their arguments."""

import linecache
from collections.abc import Callable

import numpy as np
import taichi as ti

from doo_ti.physics.number import Number
from doo_ti.physics.tuples import record
from doo_ti.relaxation import tables as of
from doo_ti.system import runtime
from doo_ti.system.errors import InputError

TABLE1, TABLE2, TABLE3, TABLE4 = (ti.types.ndarray(dtype=ti.f64, ndim=size) for size in (1, 2, 3, 4))
INDEX1, INDEX2 = (ti.types.ndarray(dtype=ti.i32, ndim=size) for size in (1, 2))
FIELD = ti.types.ndarray(dtype=ti.f32, ndim=1)
SCRATCH = "scratch"  # the type of an array of a kernel's own numbers
RODS = {  # of the kernels that take rods as :class:`.Tables` has them
    "rest_length": TABLE2,  # [1 or configuration, edge] mm
    "clamp": TABLE2,  # [configuration, CLAMP_COLUMNS]
    "material": TABLE2,  # [material, STIFFNESS + 1 or edge · STIFFNESS_COLUMNS]
    "rods": INDEX2,  # [rod, ROD_COLUMNS]
    "threads": ti.i32, "scratch": SCRATCH,
}

SOURCE = """def {name}({names}):
    ti.loop_config(block_dim=block, serialize=serial)
    for thread in range(threads):
        work(record({fields}), thread)
"""


def loop_kernel(name: str, number: Number, arguments: dict, loop, block: int, serial: bool = False,
                brief: bool = False) -> Callable:
    """A kernel that takes ``arguments``, types by names, among them ``threads``, and has each of so many threads do the
    ``work`` of ``loop``, a Taichi function of the record of all arguments and of the thread's number. It is called with the
    arguments by their names, and has the ``loop``.

    block   threads in a block, 1 on a CPU
    serial  on a CPU, work on the caller's thread
    brief   see :func:`.runtime.compiled_briefly`: for kernels that otherwise take minutes to compile

    A launch raises InputError for a table that is too large to be counted.
    """
    source = SOURCE.format(name=name, names=", ".join(arguments), fields=", ".join(f"{one}={one}" for one in arguments))
    file = f"<kernel {name}>"
    # Where Taichi looks for the source of a kernel, which is the same for all of that name.
    linecache.cache[file] = len(source), None, source.splitlines(keepends=True), file
    scope = {"ti": ti, "record": record, "work": loop.work, "block": block, "serial": serial}
    exec(compile(source, file, "exec"), scope)
    scratch = ti.types.ndarray(dtype=number.type, ndim=1)
    scope[name].__annotations__ = {one: scratch if kind is SCRATCH else kind for one, kind in arguments.items()}
    kernel = runtime.kernel(scope[name])
    compiled = runtime.compiled_briefly(kernel) if brief else kernel

    def launch(**given) -> None:
        for table, values in given.items():
            if isinstance(values, np.ndarray) and values.size > of.MOST_NUMBERS:
                raise InputError(name, table, f"{values.size:,} numbers in one call", "give fewer rods or edges at a time")
        compiled(*(given[one] for one in arguments))

    launch.loop = loop
    return launch
