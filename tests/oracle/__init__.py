"""A slow, dense f64 implementation of the rod in NumPy, the reference of the package's tests. It shares no code with it."""
