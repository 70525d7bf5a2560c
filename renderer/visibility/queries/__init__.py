"""Culling by hardware occlusion queries, from stop-and-wait to CHC++."""
