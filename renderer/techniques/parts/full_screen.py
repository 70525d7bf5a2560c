"""Passes over all pixels of a target."""

from __future__ import annotations

from typing import Final

from renderer.scene import Depth
from rhi import DepthFunction, Device, Mesh

Color = tuple[float, float, float, float]

BEHIND: Final = {Depth.REVERSED: DepthFunction.LESS, Depth.STANDARD: DepthFunction.GREATER}
"""The depth function that is passed behind the geometry, and never in front of the background."""


def make_triangle(device: Device) -> Mesh:
    """Create the mesh of a `BackgroundScreen` shader."""
    return device.mesh(3, label="whole target")
