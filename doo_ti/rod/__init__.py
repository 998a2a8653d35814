"""What a rod is: its material, configuration and clamps, observations of it, its starts, and the distance of Eq. 1."""
