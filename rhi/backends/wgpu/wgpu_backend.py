"""The wgpu backend: rhi's contract on one device of wgpu-native."""

from __future__ import annotations

from rhi.backends.webgpu.implementation import Host
from rhi.backends.webgpu.webgpu_backend import WebGpuBackend
from rhi.backends.wgpu.format_uses import TriedFormats
from rhi.backends.wgpu.native import WgpuNative


class WgpuBackend(WebGpuBackend):
    """A backend on one device of wgpu-native; its `device` is wgpu-py's."""

    def __init__(self, host: Host) -> None:
        super().__init__(WgpuNative(), host, TriedFormats(host))
