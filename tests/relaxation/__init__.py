"""F through its public functions: its guarantees for every rod, in any batch, with any clamps and arithmetic."""
