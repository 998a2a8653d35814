"""Images of rods as a rig of cameras would take them (§V-A)."""
