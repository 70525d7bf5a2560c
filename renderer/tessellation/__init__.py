"""Adaptive tessellation: the triangles of height fields, chosen on the device for each view."""

from renderer.tessellation.settings import TessellationSettings
from renderer.tessellation.tessellator import Tessellation, Tessellator, tessellation_passes

__all__ = ["Tessellation", "TessellationSettings", "Tessellator", "tessellation_passes"]
