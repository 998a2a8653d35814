"""Rods from images (§IV-A, Alg. 1), and their twist from shapes (§IV-B, Eq. 4)."""
