"""Rods that are relaxed together: they may touch each other, and points of them may be tied (docs/groups.md)."""
