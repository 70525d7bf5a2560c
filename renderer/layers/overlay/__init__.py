"""The debug overlay: a layer that shows what a frame costs and what culling did.

overlay = Overlay(device)
renderer.layers.append(overlay)
"""

from renderer.layers.overlay.overlay import Overlay

__all__ = ["Overlay"]
