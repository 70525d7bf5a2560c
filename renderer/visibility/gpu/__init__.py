"""Culling by depth images: pyramids, reprojection, and draw lists that the device makes by itself."""
