"""Kernels' functions are found by their lines as inspect finds them."""

import inspect

from doo_ti.relaxation import chain, contacts, newton_trip
from doo_ti.system.taichi_internals import _lines_of


def _unused(function):
    raise AssertionError(f"{function} is not found by its line")


def test_lines_are_those_of_inspect():
    lines, found = _lines_of(_unused), 0
    for kind in (chain.Chain, contacts.Contacts, newton_trip.NewtonTrip):
        for function in vars(kind).values():
            if hasattr(function, "_is_taichi_function"):
                assert lines(function) == inspect.getsourcelines(function)
                found += 1
    assert found > 20
