"""Pictures: error landscapes over the parameter grid (§III-E), rods in space and over images, and curves.

Only this package draws with matplotlib, on its own canvas: no window, no global figure, no changed setting.
"""
