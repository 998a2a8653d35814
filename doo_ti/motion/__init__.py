"""Quasi-static motion: clamps move in sub-steps, rods follow their branch of equilibria, and jumps are counted (§III-D)."""
