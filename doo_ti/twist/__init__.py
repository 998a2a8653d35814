"""Twist angles from shapes (§IV-B, Eq. 4)."""
