"""What counts as reproduced, stated before any run: the paper's own criterion where it has one."""

from dataclasses import dataclass
from enum import StrEnum

import numpy as np


class Verdict(StrEnum):
    """Of one criterion over all specimens; the order is from worst to best."""

    NOT = "not"
    PARTLY = "partly"
    REPRODUCED = "reproduced"


USUAL, SOME = 0.8, 0.2
"""A criterion is reproduced where it holds for at least the first share of the specimens, partly from the second on."""


def verdict(held: list[bool]) -> Verdict:
    """Raises ValueError where nothing was measured."""
    if not len(held):
        raise ValueError("a criterion without a specimen")
    share = np.mean(held)
    return Verdict.REPRODUCED if share >= USUAL else Verdict.PARTLY if share >= SOME else Verdict.NOT


@dataclass(frozen=True)
class Criterion:
    """text    what must hold in a specimen
    source     "paper": the paper states it; "here": it states none, or none that can be measured
    claimed    as the paper, and as this package: what the documents state, and what every run, of whatever size, has to find or
               exceed. Set after the first run; texts and bounds were stated before it
    """

    text: str
    source: str
    claimed: tuple[Verdict, Verdict]


R, P, N = Verdict.REPRODUCED, Verdict.PARTLY, Verdict.NOT
CRITERIA = {
    "F (§III-D)": {"same": Criterion("the paper's own scheme (Descent) ends within 0.02 mm of Newton's minimum, at the "
                                     "learned Θ, for 98 % of the rods", "here", (R, R))},
    "Table I": {
        "silk": Criterion("silk's Θ has the smallest error on silk, the other two are worse by more than one standard error",
                          "paper", (R, R)),
        "alike": Criterion("on nylon and on vicryl the Θ of these two are within one standard error of each other", "paper",
                           (N, N)),
        "size": Criterion("every prediction of a material by its own Θ is within 3.2 mm on average", "paper", (R, R)),
        "own": Criterion("each material is predicted best by its own Θ (the paper: 1 of 3 columns)", "here", (R, R)),
    },
    "Table II": {
        "diagonal": Criterion("the minimum is on the diagonal in at least 6 of 9 columns", "paper", (R, R)),
        "near": Criterion("the diagonal is within 7 % of the minimum in every column", "paper", (P, P)),
        "split": Criterion("Θ of the same material and end distance predicts better than Θ of the material alone, mean of the "
                           "9 test sets", "paper", (R, R)),
    },
    "Table III": {
        "diagonal": Criterion("the minimum is on the diagonal in all 6 columns", "paper", (N, N)),
        "dynamic": Criterion("tested on Eq. 3, Θ learned on Eq. 3 is better than Θ learned on Eq. 2 at the same end distance "
                             "by more than one standard error, at all 3 distances", "paper", (N, N)),
        "static": Criterion("tested on Eq. 2, Θ learned on Eq. 3 is at most 1.32 times as bad (the paper's largest ratio)",
                            "paper", (R, R)),
    },
    "Fig. 1": {"apart": Criterion("rods of three materials with one start and one motion end 3.2 mm or more apart, mean over "
                                  "vertices", "here", (R, R))},
    "Fig. 3": {"differ": Criterion("the cells with the smallest error differ between the three materials", "paper", (R, R))},
    "Fig. 4": {
        "lower": Criterion("vicryl: β/α of the best cell is smaller at 54 mm than at 66 mm", "paper", (N, N)),
        "between": Criterion("β/α of all distances together is between these two, or equals one", "paper", (P, P)),
    },
    "Fig. 5": {
        "dynamic": Criterion("Eq. 3 has a clear minimum (5 % deep) in region 2, α2 > α1 > β, and in region 3, α1 > α2 > β",
                             "paper", (N, N)),
        "static": Criterion("Eq. 2 has no clear minimum in at least one of the two", "paper", (R, R)),
        "axis": Criterion("both objectives find the stiff axis: the best cell has α1 > α2", "here", (R, R)),
    },
    "Fig. 6": {"energy": Criterion("of threads in loops, images with 1e-4 of the energy choose wrong rods that E_vis gets "
                                   "right", "paper", (R, R))},
    "Perception": {
        "all": Criterion("every set is recovered: mean error of its vertices below 1 mm", "paper", (R, R)),
        "error": Criterion("mean errors at most the paper's: 0.023, 0.028, 0.040 mm for nylon, silk, vicryl", "paper", (N, R)),
    },
    "Fig. 7": {
        "grows": Criterion("more observations, more success: D = 6 above D = 1", "paper", (N, N)),
        "least": Criterion("success at least the paper's: 53.3 % at D = 1, 80 % at D = 6", "paper", (R, R)),
        "near": Criterion("success at D = 1 within 10 points of the paper's 53.3 %", "paper", (N, N)),
        "range": Criterion("a range of angles explains some shapes: at D = 1 one estimate in ten or more is ambiguous", "paper",
                           (R, R)),
    },
}
