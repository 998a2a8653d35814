"""The trials' measures, their changes of images, and rods that are recovered with the energy, not without it."""

from dataclasses import replace

import numpy as np
import pytest

from doo_ti.perception.search import PerceptionOptions
from doo_ti.vision.reprojection.distance_map import distance_maps
from tools.studies.perception_study import mapped, photographed, recovered
from tools.studies.replication.images import PAPER_MM
from tools.studies.trials.perception import (
    filled,
    unseen,
    usual_width,
    with_energy,
)


@pytest.mark.thorough
def test_gaps_are_seen_and_filled():
    case, _ = photographed("vicryl", [5])
    pixels, whole = case.pixels, case.detections
    assert 2.5 < usual_width(whole) < 4.5
    near = np.linalg.norm(whole[0][1].points - pixels[1, 0, 400], axis=1) < 40
    holed = [[found if camera != 1 else replace(found, points=found.points[~near], direction=found.direction[~near],
                                                strength=found.strength[~near]) for camera, found in enumerate(whole[0])]]
    maps = distance_maps(holed, 60)
    missing = unseen(maps, pixels)
    assert missing.shape == (1, 3, pixels.shape[2]) and missing[0, 1, 390:410].all()
    assert 60 / 700 < missing[0, 1].mean() < 120 / 500 and missing[0, [0, 2]].mean() < 0.02
    again = distance_maps(filled(holed, maps, pixels), 60)
    assert not unseen(again, pixels).any()


@pytest.mark.thorough
def test_rods_are_recovered():
    case, _ = photographed("vicryl", [3, 44])
    _, trial, _ = recovered(case, case.rods.point, case.rods.direction)
    print(f"vertices off by {trial.vertex_error}, from the curve by {trial.curve_error} mm; E_vis {trial.energy_vis}, "
          f"from the true rod {trial.truth_energy}")
    assert trial.correct.all() and trial.vertex_error.max() < 0.15 and trial.curve_error.max() < 0.05
    assert (trial.curve_error < trial.vertex_error).all()
    np.testing.assert_allclose(trial.energy_vis, trial.truth_energy, rtol=1e-3)


@pytest.mark.slow
@pytest.mark.parametrize("thread", ["nylon", "vicryl", "silk"])
def test_the_lab(thread):
    """§V-E: all of the paper's 60 sets of each thread, to the paper's accuracy."""
    case, _ = photographed(thread, 60)
    _, trial, _ = recovered(case, case.rods.point, case.rods.direction)
    print(f"{thread}: vertices off by {trial.vertex_error.mean():.3f}, worst set {trial.vertex_error.max():.3f} mm; from the "
          f"curve {trial.curve_error.mean():.3f}, worst {trial.curve_error.max():.3f} mm")
    assert trial.correct.all()
    assert trial.vertex_error.mean() <= PAPER_MM[thread] and trial.curve_error.mean() < 0.03 and trial.vertex_error.max() < 0.15


@pytest.mark.slow
def test_energy_distinguishes_rods_that_images_do_not():
    """Fig. 6: all views cross themselves; gaps of the detection are filled as in §V-E."""
    case, _ = photographed("loops_vicryl", None, crossing=True)
    assert len(case.rods.names) > 15
    case = mapped(case, filled(case.detections, case.maps, case.pixels))
    trials = [recovered(case, case.rods.point, case.rods.direction, with_energy(PerceptionOptions(), share))[1]
              for share in (1.0, 1e-2)]
    wrong = [int((~trial.correct).sum()) for trial in trials]
    print(f"of {len(case.rods.names)} sets {wrong[0]} are wrong with energy, {wrong[1]} with a hundredth of it")
    assert wrong[0] <= 1 and wrong[1] >= 2 * max(wrong[0], 1)
