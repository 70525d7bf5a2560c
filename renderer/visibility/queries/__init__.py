"""Culling with hardware occlusion queries: stop-and-wait, CHC, CHC++ and conditional rendering."""
