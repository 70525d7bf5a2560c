"""Measurement of the error and the time of each built-in on each backend."""
