"""Calibrated cameras: the lens, rigs and their files, calibration from boards, projection in kernels (§V-A)."""
