"""The two intermediate representations: the typed tree, and lane code with explicit masks."""
