"""What the studies try on rods that are known: images to rods, motions, twist."""
