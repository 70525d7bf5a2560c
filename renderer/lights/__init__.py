"""Which lights reach what."""
