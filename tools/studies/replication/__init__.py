"""The paper's tables and figures, measured on the shipped scenes: what ``tools/studies/reproduce.py`` runs."""
