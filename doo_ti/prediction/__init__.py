"""Configurations of a rod after its ends have moved (§III-D, Fig. 1)."""
