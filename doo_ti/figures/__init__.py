"""The paper's landscapes from finished sweeps, as pictures and recordings (Fig. 3, 4, 5)."""
