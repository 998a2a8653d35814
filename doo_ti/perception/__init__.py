"""Rods from images (§IV-A, Alg. 1)."""
