"""Beyond the grid: the continuous optimum of Θ and its uncertainty (§III-E)."""
