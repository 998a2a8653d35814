"""The true Θ of the lab's rods."""

from doo_ti.bench.workload import RIBBON_TWIST

TRUTH = {  # bend_1, bend_2, twist in mm³; weight 1
    "nylon": (1.8e6, 1.8e6, 1.2e6), "vicryl": (6e5, 6e5, 8e5), "silk": (1.5e5, 1.5e5, 5e4),
    "ribbon": (6e6, 1.2e5, RIBBON_TWIST),
}
