"""Images of rods: cameras, what is detected in their images, and how well a rod's projection agrees with it (§IV)."""
