"""Adaptive tessellation: the triangles of surfaces, chosen on the device for each view."""

from renderer.tessellation.settings import TessellationSettings
from renderer.tessellation.tessellator import SurfaceTessellation, Tessellator, tessellation_passes

__all__ = ["SurfaceTessellation", "TessellationSettings", "Tessellator", "tessellation_passes"]
