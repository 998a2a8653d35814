"""Images from files, and the thread's centre line in them (§IV-A)."""
