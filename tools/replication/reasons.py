"""What the report says beside the numbers."""

LABORATORY = []
REASONS = {}
