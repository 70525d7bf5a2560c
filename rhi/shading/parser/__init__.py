"""From Python's syntax to the typed tree."""
