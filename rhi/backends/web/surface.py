"""The WebGPU context of a canvas element: the texture that the page shows next."""

from __future__ import annotations

from typing import Any

from rhi.backends.web.js_objects import WebObject

_RENDER_ATTACHMENT = 0x10


class CanvasTexture:
    """The texture of a canvas for the next frame. It expires when the page shows it.

    Attributes:
        size: (width, height).
        format: of the views: with `-srgb`, draws encode.
    """

    def __init__(self, texture: Any, form: str) -> None:
        self._texture = WebObject(texture)
        self.size = (int(texture.width), int(texture.height))
        self.format = form

    def create_view(self) -> WebObject:
        """Return a view to draw to."""
        view: WebObject = self._texture.create_view(format=self.format)
        return view


class CanvasSurface:
    """Draws to a canvas element of the page; `get_texture` is a backend's `get_surface`."""

    def __init__(self, element: Any, device: WebObject, gpu: Any) -> None:
        """Configure the element's context for a device.

        Args:
            element: an `HTMLCanvasElement`, of which no other kind of context was requested.
            gpu: the page's `navigator.gpu`, which names the format that costs no conversion.
        """
        self._format = str(gpu.getPreferredCanvasFormat())
        self._context = WebObject(element.getContext("webgpu"))
        self._context.configure(
            {
                "device": device,
                "format": self._format,
                "view_formats": [self._format + "-srgb"],
                "usage": _RENDER_ATTACHMENT,
                "alpha_mode": "opaque",
            }
        )

    def get_texture(self, is_srgb: bool) -> CanvasTexture:
        """Return the texture of the next frame; `is_srgb`: draws to it encode."""
        texture = self._context._internal.getCurrentTexture()
        return CanvasTexture(texture, self._format + "-srgb" * is_srgb)
