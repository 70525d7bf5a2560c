"""Measurements and comparisons: one engine, and what is compared with it."""
