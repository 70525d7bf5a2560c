"""Occlusion queries, sets of them, and the tree of GPU timers."""
