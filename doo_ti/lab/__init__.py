"""The virtual laboratory: rods of the paper's experiment (§V-A), and what ``doo-ti bench`` measures on this machine."""
