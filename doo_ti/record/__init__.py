"""Recordings for the rerun viewer: a sweep, a figure over the cells of its grid, motions, ribbons, and rods in images.

Only this package imports rerun; import it where it is used, not at a module's top: that takes half a second.
Entities, timelines and counts: docs/recording.md.
"""
