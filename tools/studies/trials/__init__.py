"""Trials of the studies on known rods: images to rods, motions, twist."""
