"""The virtual laboratory of the paper's experiment (§V-A)."""
