"""Other simulators of rods beside this package, on the same rods."""
