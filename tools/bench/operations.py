"""Operations of a trip through Newton's loop, counted in the compiled kernel: ``python tools/bench/operations.py``.

Prints a line per kind of rod: operations in the loops over edges, for each edge, and outside, for each trip. These
figures are in :data:`doo_ti.lab.cases.OPERATIONS`; a slow test of tests/tools compares them.

The kernels are compiled in a separate process, in which LLVM writes the optimised code to a file. In it the additions,
multiplications, divisions and roots on packs are counted by the loop that contains them. Parts that are skipped for held edges
are counted for every edge, so the loops count for the E − 2 free edges.
"""

import os
import re
import subprocess
import sys
import tempfile
from collections import defaultdict
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT))

from doo_ti.lab.cases import OPERATIONS

SPECIMENS = {"isotropic": "many", "general": "band", "springs": "pulled"}
RELAX = "from doo_ti.lab.cases import COARSE, Specimens; Specimens(64).{}.relaxed(COARSE, 'f32')"
COUNTED = re.compile(r"= (?:fadd|fsub|fmul|fdiv) .*<16 x float>|@llvm\.sqrt\.v16f32\(")


def counted(kind: str) -> tuple[int, int]:
    """(operations for each edge, operations besides) of a trip of the kernel in f32 for rods of that kind."""
    with tempfile.TemporaryDirectory() as folder:
        environment = {**os.environ, "PYTHONPATH": str(ROOT), "TI_OFFLINE_CACHE_FILE_PATH": folder,  # an empty cache
                       "TI_PRINT_KERNEL_LLVM_IR_OPTIMIZED": "1"}
        subprocess.run([sys.executable, "-c", RELAX.format(SPECIMENS[kind])], cwd=folder, env=environment, check=True,
                       stdin=subprocess.DEVNULL, capture_output=True)
        functions = [function for file in Path(folder).glob("*.ll") for function in
                     re.findall(r"^define .*?^}", file.read_text(encoding="utf-8"), re.MULTILINE | re.DOTALL)]
    return in_loops(max(functions, key=lambda function: len(COUNTED.findall(function))))


def in_loops(function: str) -> tuple[int, int]:
    """Operations in the loops inside the outermost loop that has any, and in that loop itself."""
    blocks = basic_blocks(function)
    operations = {name: len(COUNTED.findall(code)) for name, code in blocks.items()}
    loops = natural_loops(blocks)
    trips = max(loops, key=lambda head: sum(operations[name] for name in loops[head]))
    inner = {name for head, body in loops.items() if head in loops[trips] and head != trips for name in body}
    return (sum(operations[name] for name in inner), sum(operations[name] for name in loops[trips] - inner))


def basic_blocks(function: str) -> dict[str, str]:
    """The code of each block by its label, the entry first."""
    pieces = re.split(r"^([\w.$-]+):.*\n", "\n".join(["entry:", *function.splitlines()[1:], ""]), flags=re.MULTILINE)
    return {label: code for label, code in zip(pieces[1::2], pieces[2::2], strict=True) if code.strip()}


def natural_loops(blocks: dict[str, str]) -> dict[str, set[str]]:
    """The blocks of each loop by the block it begins with: those from which a jump back to that one can be reached."""
    following = {name: re.findall(r"label %([\w.$-]+)", code) for name, code in blocks.items()}
    before, loops = defaultdict(list), defaultdict(set)
    for name, others in following.items():
        for other in others:
            before[other].append(name)
    entry = next(iter(blocks))
    for head in before:
        elsewhere = reached(entry, following, head)
        for name in before[head]:
            if name not in elsewhere:  # every way to it leads through the head
                loops[head] |= {head} | reached(name, before, head)
    return dict(loops)


def reached(start: str, ways: dict[str, list[str]], barred: str) -> set[str]:
    """The blocks that can be reached from one, itself among them, not by way of the barred one."""
    found, waiting = set(), [start]
    while waiting:
        place = waiting.pop()
        if place not in found and place != barred:
            found.add(place)
            waiting += ways.get(place, ())
    return found


def main() -> None:
    for kind, known in OPERATIONS.items():
        found = counted(kind)
        print(f"{kind}: {found[0]} for each edge and {found[1]} besides; the package has {known[0]} and {known[1]}")


if __name__ == "__main__":
    main()
