"""What a rod will do when its ends are moved (§III-D, Fig. 1)."""
