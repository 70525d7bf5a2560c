"""The web backend: rhi's contract on one device of a page."""

from __future__ import annotations

from typing import Any

import js

from rhi.backends.web.page import WebPage
from rhi.backends.web.surface import CanvasSurface
from rhi.backends.webgpu.implementation import Host
from rhi.backends.webgpu.specified_formats import SpecifiedFormats
from rhi.backends.webgpu.webgpu_backend import WebGpuBackend


class WebBackend(WebGpuBackend):
    """A backend on one device of a page; the handle of its `device` is the page's `GPUDevice`."""

    def __init__(self, page: WebPage, host: Host) -> None:
        super().__init__(page, host, SpecifiedFormats(host.features))

    def show_on(self, element: Any) -> None:
        """Make `device.present` show images on an `HTMLCanvasElement`, without a copy through the CPU."""
        self.get_surface = CanvasSurface(element, self.device, js.navigator.gpu).get_texture
