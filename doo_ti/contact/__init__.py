"""Contact of rods with what lies around them: obstacles and their signed distances (docs/contact.md)."""
