"""Manipulation with visual feedback: rods brought to a wanted shape by their grippers (§VI)."""
