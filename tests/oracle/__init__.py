"""A slow, dense f64 twin of the rod in NumPy: what the package is checked against. It shares no code with it."""
