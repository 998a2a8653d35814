"""Parts of the calibration study: random specimens, the fit, coverage of intervals, rows of a CSV, the picture."""
