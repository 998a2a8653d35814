"""The instants of a motion that a TOML file states, and quantities that it states at some moments, smooth between them."""

from collections.abc import Mapping

import numpy as np

from doo_ti.io.toml_file import Table, checked, unit_direction
from doo_ti.system.errors import InputError


def instants(source, rate: float, duration: float, most: int, called: str) -> np.ndarray:
    """(1 + steps,) s: ``rate`` instants a second from zero to ``duration``, the values of ``rate_hz`` and ``duration_s`` in the
    file ``source``. Raises InputError, which calls them ``called``, for fewer than one step or more than ``most``."""
    steps = round(duration * rate)
    if not 1 <= steps <= most:
        raise InputError(source, "duration_s", f"{steps} {called} at rate_hz", f"give 1 to {most:,}")
    return np.arange(steps + 1) / rate


def between_moments(source, name: str, rows: list, table: type[Table], first: Mapping[str, object],
                    time: np.ndarray) -> dict[str, np.ndarray]:
    """The quantities of ``first``, as they are at time zero, at the instants ``time`` (T,) in s: (T, ...) each, on monotone
    cubics between the moments of ``rows``, called ``name`` in the file ``source``; after the last they stay.

    table  how a moment is written: ``time_s``, and quantities that are None where they stay as they were. Those whose names
           end in "direction" become unit vectors

    Raises InputError where times do not rise, and as :func:`.checked` does.
    """
    from scipy.interpolate import PchipInterpolator

    now, at, values = dict(first), [0.0], {key: [value] for key, value in first.items()}
    for k, row in enumerate(rows):
        moment = checked(source, f"{name}[{k}]", row, table)
        if moment.time_s < at[-1] or k and moment.time_s == at[-1]:
            raise InputError(source, f"{name}[{k}].time_s", f"{moment.time_s:g} does not rise", "give moments in their order")
        for key in now:
            value = getattr(moment, key)
            if value is not None:
                direction = key.endswith("direction")
                now[key] = unit_direction(source, f"{name}[{k}].{key}", value) if direction else np.array(value)
        if moment.time_s == at[-1]:
            at.pop()
            for key in now:
                values[key].pop()
        at.append(moment.time_s)
        for key in now:
            values[key].append(now[key])
    if len(at) == 1:
        return {key: np.broadcast_to(value[0], (len(time), *np.shape(value[0]))) for key, value in values.items()}
    return {key: PchipInterpolator(at, np.array(value))(np.minimum(time, at[-1])) for key, value in values.items()}
