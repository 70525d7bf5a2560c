"""Adapters, and the device that is opened on one of them.

Features are requested if the adapter has them. `RHI_WGPU_ADAPTER` names an adapter by a part of its description;
`RHI_WGPU_PROFILE=core` opens a device with the limits of the WebGPU specification and without features of this
implementation.
"""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import wgpu

from rhi.backends.wgpu.native import GpuObject, check_version, keep_callbacks
from rhi.errors import DeviceError
from rhi.errors.rules import DEVICE_DRIVER

_PLATFORMS: Final = ("Vulkan", "Metal", "D3D12")
_RANKS: Final = {"DiscreteGPU": 0, "IntegratedGPU": 1, "VirtualGPU": 2}
_STANDARD: Final = frozenset(
    [
        "depth-clip-control",
        "depth32float-stencil8",
        "timestamp-query",
        "indirect-first-instance",
        "rg11b10ufloat-renderable",
        "float32-filterable",
        "float32-blendable",
        "texture-compression-bc",
        "primitive-index",
        "texture-formats-tier1",
        "texture-formats-tier2",
    ]
)
"""Features of the WebGPU specification that are used."""
_NATIVE: Final = frozenset(
    [
        "texture-adapter-specific-format-features",
        "texture-format16bit-norm",
        "vertex-writable-storage",
        "polygon-mode-line",
        "multi-draw-indirect-count",
        "shader-draw-index",
        "shader-early-depth-test",
        "timestamp-query-inside-encoders",
        "timestamp-query-inside-passes",
        "address-mode-clamp-to-border",
        "clear-texture",
    ]
)
"""Features of wgpu's native implementation that are used."""
_TIP: Final = "a Vulkan driver: on Debian, apt install mesa-vulkan-drivers"


@dataclass(frozen=True)
class Host:
    """An open device, with the information, features and limits of its adapter."""

    device: GpuObject
    info: Mapping[str, str]
    features: frozenset[str]
    limits: Mapping[str, int]
    passed_over: tuple[str, ...] = ()


def open_host() -> Host:
    """Open a device on the best adapter.

    Raises:
        DeviceError: `device-driver` if there is no adapter, or none that can be opened.
    """
    call = "rhi.create_device('wgpu')"
    check_version()
    try:
        adapters = list(wgpu.gpu.enumerate_adapters_sync())
    except RuntimeError as error:
        raise DeviceError(DEVICE_DRIVER, call, str(error), tip=_TIP) from error
    wanted = os.environ.get("RHI_WGPU_ADAPTER", "").lower()
    found = [a for a in adapters if a.info["backend_type"] in _PLATFORMS and wanted in str(dict(a.info)).lower()]
    if not found:
        known = ", ".join(a.info["device"] for a in adapters) or "none"
        given = f"no adapter of {', '.join(_PLATFORMS)}" + (f" named {wanted!r}" if wanted else "")
        raise DeviceError(DEVICE_DRIVER, call, f"{given} (adapters: {known})", tip=_TIP)
    reasons: list[str] = []
    for adapter in sorted(found, key=lambda a: _RANKS.get(a.info["adapter_type"], len(_RANKS))):
        try:
            return _open(adapter, reasons)
        except (wgpu.GPUError, RuntimeError) as error:
            reasons.append(f"{adapter.info['device']}: {error}")
    raise DeviceError(DEVICE_DRIVER, call, "\n".join(reasons), tip=_TIP)


def _open(adapter: GpuObject, passed_over: Sequence[str]) -> Host:
    core = os.environ.get("RHI_WGPU_PROFILE") == "core"
    features = frozenset(adapter.features) & (_STANDARD if core else _STANDARD | _NATIVE)
    limits = {} if core else dict(adapter.limits)
    device = adapter.request_device_sync(required_features=sorted(features), required_limits=limits)
    keep_callbacks(device)
    return Host(device, dict(adapter.info), features, dict(device.limits), tuple(passed_over))
