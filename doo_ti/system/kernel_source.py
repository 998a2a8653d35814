"""The source of kernels, read once for all calls of a function.

Before a kernel runs, in every process, Taichi translates its functions. At each call of a function it searches, formats and
parses the source again, and for every expression it prepares a quotation for a possible error message. Our kernels have
hundreds of functions and thousands of calls, so this takes half of the time until a kernel runs. With DOO_TI_DEBUG set Taichi
works as usual, and an error in a kernel is quoted.
"""

import ast
import inspect
import linecache
import os
import textwrap
from collections import defaultdict
from collections.abc import Callable
from functools import cache
from pathlib import Path
from types import SimpleNamespace

PARTS = ("getsourcefile", "getsourcelines", "textwrap", "ast", "transform_tree")
"""What is replaced in Taichi's module; left as they are in a version that has others."""


OURS = str(Path(__file__).resolve().parents[1]) + os.sep
"""Files whose functions are found by their line: those of others may change while the process runs."""


def read_once(quotes: Callable[[], bool]) -> None:
    """Have Taichi read each source once. ``quotes`` says whether it is still to quote, as in kernels that are not ours."""
    from taichi.lang import kernel_impl
    from taichi.lang.ast import ast_transformer_utils

    if os.environ.get("DOO_TI_DEBUG"):
        return
    if all(hasattr(kernel_impl, part) for part in PARTS):
        trees = _Trees(kernel_impl.transform_tree)
        for part, new in zip(PARTS, (
                cache(kernel_impl.getsourcefile), _lines_of(kernel_impl.getsourcelines),
                SimpleNamespace(fill=cache(textwrap.fill), dedent=cache(textwrap.dedent)),
                SimpleNamespace(parse=trees.parse), trees.transform), strict=True):
            setattr(kernel_impl, part, new)
    context = getattr(ast_transformer_utils, "ASTTransformerContext", None)
    if hasattr(context, "get_pos_info"):
        quoted = context.get_pos_info
        context.get_pos_info = lambda self, node: quoted(self, node) if quotes() else ""


class _Trees:
    """Parsed functions. A tree that is being traced is not given out again, as a function may be called in its own argument."""

    def __init__(self, transform: Callable):
        self._transform, self._idle, self._busy = transform, defaultdict(list), {}

    def parse(self, source: str) -> ast.Module:
        if self._idle[source]:
            tree, nodes = self._idle[source].pop()
        else:
            tree = ast.parse(source)
            nodes = list(ast.walk(tree))
        self._busy[id(tree)] = source, nodes
        return tree

    def transform(self, tree: ast.Module, context):
        """What Taichi does with a tree, which then is without what it has noted in it; that of a kernel is not used again."""
        found = self._transform(tree, context)
        source, nodes = self._busy.pop(id(tree), (None, ()))
        if source is not None and not context.is_kernel:
            for node in nodes:
                node.__dict__.pop("ptr", None)
                node.__dict__.pop("caller", None)
            self._idle[source].append((tree, nodes))
        return found


def _lines_of(otherwise: Callable) -> Callable:
    """What :func:`inspect.getsourcelines` returns, without its search: the lines of a function and the number of the first."""
    @cache
    def lines(function) -> tuple[list[str], int]:
        code = inspect.unwrap(function).__code__
        file, first = code.co_filename, code.co_firstlineno
        last = _last_lines(file).get(first) if file.startswith(OURS) else None
        return otherwise(function) if last is None else (linecache.getlines(file)[first - 1 : last], first)

    return lines


@cache
def _last_lines(file: str) -> dict[int, int]:
    """The last line of each function of a file, by its first, that of a decorator where it has any."""
    last, blocks = {}, [ast.parse("".join(linecache.getlines(file)))]
    while blocks:
        block = blocks.pop()
        blocks += [node for node in block.body if hasattr(node, "body")]
        if isinstance(block, ast.FunctionDef):
            last[min([block.lineno, *(mark.lineno for mark in block.decorator_list)])] = block.end_lineno
    return last
