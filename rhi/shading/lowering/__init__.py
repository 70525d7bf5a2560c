"""From the typed tree to lane code."""
