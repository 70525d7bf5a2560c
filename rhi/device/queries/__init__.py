"""Occlusion queries, query sets, and GPU timers."""
