"""Quasi-static motion: clamps on their way, rods that follow their branch, and where they jump (§III-D)."""
