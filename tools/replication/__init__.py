"""The paper's tables and figures, measured on the shipped scenes: what ``tools/reproduce.py`` runs."""
