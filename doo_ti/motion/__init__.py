"""Quasi-static motion: clamps move in sub-steps, rods follow their branch of equilibria, jumps are counted, and configurations
are predicted (§III-D, Fig. 1)."""
