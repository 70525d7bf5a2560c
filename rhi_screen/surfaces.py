"""Surfaces: windows and canvas elements in which a device shows images without a copy by the CPU.

A device on `wgpu` shows them through Vulkan, Metal or Direct3D 12, one on `web` by the page's WebGPU.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Protocol, runtime_checkable

import rhi
from rhi_screen.canvases import Canvas

SURFACE_BACKENDS = ("wgpu", "web")


@runtime_checkable
class SurfaceBackend(Protocol):
    """A backend that draws images to the textures of a window; the one on wgpu."""

    device: Any
    get_surface: Callable[[bool], Any] | None


@runtime_checkable
class PageBackend(Protocol):
    """A backend that draws images to a canvas element of a page; the one on web."""

    def show_on(self, element: Any) -> None:
        """Make `device.present` show images on an element."""


def can_show_on_surface(canvas: Canvas, backend: str) -> bool:
    """True if devices on a backend can show images on a surface of a canvas: it must be a window or an
    element."""
    if backend not in SURFACE_BACKENDS or (backend == "web") is not hasattr(canvas, "get_element_context"):
        return False
    widget: Any = getattr(canvas, "_subwidget", canvas)
    return "window" in (widget._rc_get_present_info(["screen", "bitmap"]) or ())  # as each prefers


def open_surface(canvas: Canvas, device: rhi.Device) -> None:
    """Make `device.present` show images of a device in a canvas that `can_show_on_surface`."""
    if device.backend_name == "web":
        page_kind: Any = PageBackend
        device.backend_as(page_kind).show_on(canvas.get_element_context().element)
        return
    kind: Any = SurfaceBackend  # mypy takes no protocol for a class
    backend = device.backend_as(kind)
    context = canvas.get_context("wgpu")
    plain = context.get_preferred_format(backend.device.adapter).removesuffix("-srgb")

    def get_surface(is_srgb: bool) -> Any:
        form = plain + "-srgb" * is_srgb
        if (context.get_configuration() or {}).get("format") != form:
            context.configure(device=backend.device, format=form)
        return context.get_current_texture()

    backend.get_surface = get_surface
