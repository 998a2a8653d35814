"""How well rods agree with what images show: distance maps, E_proj and E_vis; and marks triangulated (§IV-A, §V-A)."""
