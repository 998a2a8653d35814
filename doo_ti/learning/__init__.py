"""Θ from observed configurations by exhaustive search: Eqs. 2 and 3, sweeps, cross-validation (§III-E)."""
