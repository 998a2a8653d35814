"""Rendered images of rods, as seen by a rig of cameras (§V-A)."""
