"""F through its public door: what it promises for every rod, whatever the batch, the clamps and the arithmetic."""
