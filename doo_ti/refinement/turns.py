"""Whole turns of rods that frames hold at both ends, where nobody measured the total twist.

The frames leave the twist open up to whole turns. F takes, of several, the rod nearest to the marks: under a twist stiffness
that is too low a wrong turn changes the shape little, is taken, and confirms the stiffness. So a fit begins with several twist
stiffnesses, each with the turns that are nearest then, and once with as little twist as the frames leave in all rods, which
marks that are far apart may not tell from a turn more; the posterior decides. At its end each observation's turns are chosen
once more, under what was learned.
"""

from collections.abc import Callable, Iterable, Iterator
from contextlib import suppress
from dataclasses import replace

import numpy as np

from doo_ti.refinement.fit import Fit, Fitted, State
from doo_ti.refinement.priors import Scales
from doo_ti.refinement.theta import common_rod
from doo_ti.refinement.unknowns import Values
from doo_ti.system.errors import InputError

RATIOS = (0.25, 0.5, 1.0, 2.0, 4.0)
"""Twist over bend stiffness with which a fit begins."""
TURNS = (-1, 0, 1)
"""Whole turns of an observation that are compared, each with the most probable clamps."""
AGAIN = 3
"""How often each observation is chosen once more, as long as that changes any."""


def twisted(fit: Fit, values: Values, scales: Scales) -> Iterator[State]:
    """Rods relaxed from their observations at ``values``, with each of several twist stiffnesses, and with the least twist."""
    theta = values.theta
    least = fit.posed(fit.from_marks(replace(values, theta=common_rod(theta), scatter=0 * values.scatter), scales, turn=0))
    if least.used.any():
        yield least
    for ratio in RATIOS:
        twisted = replace(theta, twist=ratio * float(np.diag(theta.bend).mean()))
        with suppress(InputError):  # no rod is stable at that twist stiffness
            yield fit.begin(replace(values, theta=twisted, scatter=0 * values.scatter), scales)


def turns_chosen_again(fit: Fit, fitted: Fitted, steps: int) -> list[Fitted]:
    """``fitted``, continued with the turns that are most probable under what was learned, as long as that helps: of several, or
    of those that were measured and those that misfits took instead. All that were reached, the best first."""
    turns = TURNS if fit.unknowns.rod.turns_unknown else (None,)

    def others(state: State) -> Iterable[State]:
        values = replace(state.values, scatter=0 * state.values.scatter)
        return (fit.posed(fit.from_marks(values, state.scales, turn)) for turn in turns)

    return chosen_again(fit, fitted, steps, others)


def chosen_again(fit: Fit, fitted: Fitted, steps: int, others: Callable[[State], Iterable[State]]) -> list[Fitted]:
    """``fitted``, continued as long as that makes it better. Each time every observation takes the most probable of its present
    state and the ``others``. All that were reached, the best first.

    others  from a state, states that differ from it in poses and shapes alone
    """
    reached = [fitted]
    for _ in range(AGAIN):
        state = reached[-1].state
        begun = fit.best_of([state, *others(state)])
        if np.array_equal(begun.values.scatter, state.values.scatter):
            break
        reached.append(fit.run(begun, steps).after(reached[-1]))
        if reached[-1].rank >= reached[-2].rank:
            break
    return sorted(reached, key=lambda one: one.rank)
