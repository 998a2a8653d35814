"""Calibrated cameras: the lens, rigs and their files, calibration from boards (§V-A)."""
