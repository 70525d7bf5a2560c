"""Adaptive tessellation: the triangles of height fields, chosen on the device for each view."""

from renderer.tessellation.settings import TessellationSettings
from renderer.tessellation.tessellator import FieldTessellation, Tessellator, tessellation_passes

__all__ = ["FieldTessellation", "TessellationSettings", "Tessellator", "tessellation_passes"]
