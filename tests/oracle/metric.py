"""Eq. 1 for one pair of configurations, as printed."""

import numpy as np


def distance(vertices, observed, m1=None, observed_m1=None, frame_weight=0.0, valid=None) -> float:
    """d = 1/(n−1) Σ ‖v_i − v_i'‖ + w_m/(E−1) Σ ‖m1_j − m1_j'‖, mm, n the number of valid vertices (all V by default).

    vertices, observed (V, 3) mm; m1, observed_m1 (E, 3); frame_weight w_m in mm; valid (V,) bool.
    """
    total, marks = 0.0, 0
    for i in range(len(vertices)):
        if valid is None or valid[i]:
            total += np.sqrt(np.sum((np.asarray(vertices[i]) - observed[i]) ** 2))
            marks += 1
    total /= marks - 1
    if frame_weight:
        edges = len(m1)
        total += frame_weight / (edges - 1) * sum(
            np.sqrt(np.sum((np.asarray(m1[j]) - observed_m1[j]) ** 2)) for j in range(edges)
        )
    return float(total)
