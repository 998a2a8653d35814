"""Agreement of rods with images: distance maps, E_proj and E_vis; and triangulation of marks (§IV-A, §V-A)."""
