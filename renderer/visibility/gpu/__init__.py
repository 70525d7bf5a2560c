"""Culling with depth images: depth pyramids, reprojection, and draw lists made on the device."""
