"""The source of kernels, read once for all calls of a function.

To trace a kernel, in every process, Taichi looks up, lays out and parses the source of a function again at each of its calls,
and quotes a piece of it for every expression, should that be wrong. Ours are hundreds of functions with thousands of calls:
half of the time until a kernel runs. With DOO_TI_DEBUG set Taichi does so itself, and an error in a kernel is quoted.
"""

import ast
import inspect
import linecache
import os
import textwrap
from collections import defaultdict
from collections.abc import Callable
from functools import cache
from types import SimpleNamespace

PARTS = ("getsourcefile", "getsourcelines", "textwrap", "ast", "transform_tree")
"""What is replaced in Taichi's module; left as they are in a version that has others."""


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
    """The lines of a function's source and the number of the first: :func:`inspect.getsourcelines`, without a search."""
    @cache
    def lines(function) -> tuple[list[str], int]:
        code = getattr(inspect.unwrap(function), "__code__", None)
        last = code and _last_lines(code.co_filename).get(code.co_firstlineno)
        if not last:
            return otherwise(function)
        return linecache.getlines(code.co_filename)[code.co_firstlineno - 1 : last], code.co_firstlineno

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
