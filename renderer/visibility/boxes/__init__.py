"""Bounding boxes: hierarchies of them, frustum culling, and the boxes that queries draw."""
