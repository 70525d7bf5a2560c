"""Bounding boxes, the hierarchies over them, and culling by view volume. Runs on the CPU."""
