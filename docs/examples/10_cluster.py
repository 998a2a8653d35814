"""A sweep on the workers of a Dask cluster, here two processes on this machine; the cells are the same to the last bit."""

import numpy as np
from distributed import LocalCluster

from doo_ti import Grid, SweepOptions, read_landscape, sweep
from doo_ti.io.scene import Synthesis
from doo_ti.lab.synthesis import synthesise
from doo_ti.rod.grid import Axis

if __name__ == "__main__":  # workers are new processes, which import this file
    suture = synthesise(Synthesis(bend=6e5, twist=8e5, end_distances_mm=(42.0, 66.0), end_rotations_deg=(0.0, 90.0, 180.0)))
    grid = Grid((Axis("bend", np.geomspace(1e5, 4e6, 8)), Axis("twist", np.geomspace(1e5, 4e6, 8))))
    with LocalCluster(n_workers=2, threads_per_worker=1, host="127.0.0.1", dashboard_address=None) as cluster:
        # The same on the command line: doo-ti sweep SCENE.toml --dask tcp://HOST:8786 --out RUN
        sweep("runs/cluster", suture, grid, options=SweepOptions(scheduler=cluster.scheduler_address))
    sweep("runs/alone", suture, grid)

    # Final check: both runs have the same cells.
    shared, alone = read_landscape("runs/cluster"), read_landscape("runs/alone")
    print(f"smallest mean distance {np.nanmin(shared.mean_distance):.3f} mm, of {shared.mean_distance.size} cells")
    np.testing.assert_array_equal(shared.mean_distance, alone.mean_distance)
