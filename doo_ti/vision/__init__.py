"""Images of rods: cameras, detection of rods in images, and the reprojection error of rods (§IV)."""
