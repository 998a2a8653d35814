"""Beyond the grid: sensitivities of equilibria, the continuous optimum of Θ and its uncertainty."""
