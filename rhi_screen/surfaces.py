"""Surfaces: windows in which a device shows images through Vulkan, Metal or Direct3D 12, without a copy by
the CPU."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Protocol, runtime_checkable

import rhi
from rhi_screen.canvases import Canvas


@runtime_checkable
class SurfaceBackend(Protocol):
    """A backend that draws images to the textures of a window; the one on wgpu."""

    device: Any
    get_surface: Callable[[bool], Any] | None


def can_show_on_surface(canvas: Canvas) -> bool:
    """True if surfaces can be created for a canvas: it must be a window."""
    widget: Any = getattr(canvas, "_subwidget", canvas)
    return "window" in (widget._rc_get_present_info(["screen", "bitmap"]) or ())  # as each prefers


def open_surface(canvas: Canvas, device: rhi.Device) -> None:
    """Make `device.present` show images of a device on wgpu in a canvas that `can_show_on_surface`."""
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
