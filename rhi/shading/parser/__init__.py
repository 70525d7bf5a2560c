"""The parser: from Python's syntax tree to the typed tree."""
