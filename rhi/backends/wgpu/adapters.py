"""Adapters, and the device that is opened on one of them.

Features are requested if the adapter has them. `RHI_WGPU_ADAPTER` names an adapter by a part of its
description; `RHI_WGPU_PROFILE=core` opens a device with the limits of the WebGPU specification and without
features of this implementation.
"""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from typing import Final

import wgpu
from wgpu.backends.wgpu_native.extras import set_instance_extras

from rhi.backends.webgpu.implementation import GpuObject, Host
from rhi.backends.webgpu.webgpu_limits import CORE_LIMITS
from rhi.backends.wgpu.native import check_version, retain_callbacks
from rhi.contract.renderdoc import get_renderdoc_library
from rhi.errors import DeviceError
from rhi.errors.rules import DEVICE_DRIVER
from rhi.errors.shared_caches import make_shared_lock

_PLATFORMS: Final = ("Vulkan", "Metal", "D3D12")
_RANKS: Final = {"DiscreteGPU": 0, "IntegratedGPU": 1, "VirtualGPU": 2}
_USED: Final = frozenset(
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
"""Features to request: of the WebGPU specification, and of wgpu's native implementation."""
_DISPLAY: Final = "WAYLAND_DISPLAY"
_LOCK: Final = make_shared_lock()  # the environment and contexts of OpenGL belong to all threads
_TIP: Final = "a Vulkan driver: on Debian, apt install mesa-vulkan-drivers"


def open_host() -> Host:
    """Open a device on the best adapter.

    Raises:
        DeviceError: `device-driver` if there is no adapter, or none that can be opened.
    """
    call = "rhi.create_device('wgpu')"
    check_version()
    name = os.environ.get("RHI_WGPU_ADAPTER", "").lower()
    try:
        matching, available = _list_adapters(name)
    except RuntimeError as error:
        raise DeviceError(DEVICE_DRIVER, call, str(error), tip=_TIP) from error
    if not matching:
        given = f"no adapter of {', '.join(_PLATFORMS)}" + (f" named {name!r}" if name else "")
        raise DeviceError(DEVICE_DRIVER, call, f"{given} (adapters: {available or 'none'})", tip=_TIP)
    reasons: list[str] = []
    for adapter in sorted(matching, key=lambda a: _RANKS.get(a.info["adapter_type"], len(_RANKS))):
        try:
            return _open(adapter, reasons)
        except (wgpu.GPUError, RuntimeError) as error:
            reasons.append(f"{adapter.info['device']}: {error}")
    raise DeviceError(DEVICE_DRIVER, call, "\n".join(reasons), tip=_TIP)


def _list_adapters(name: str) -> tuple[list[GpuObject], str]:
    """Return the adapters of usable platforms that have `name` in their description, and the names of all.

    The others are released before another thread lists its own: those of OpenGL make their context current
    then, and wgpu-native ends the process where a second thread has done so.
    """
    with _LOCK:
        if get_renderdoc_library() is not None:  # it would capture the context with which wgpu asks OpenGL
            with suppress(RuntimeError):  # this process has listed adapters already
                set_instance_extras(backends=("Vulkan", "DX12"))
        with _quiet_without_wayland():
            adapters = list(wgpu.gpu.enumerate_adapters_sync())
        available = ", ".join(adapter.info["device"] for adapter in adapters)
        usable = [adapter for adapter in adapters if adapter.info["backend_type"] in _PLATFORMS]
        del adapters
        return [adapter for adapter in usable if name in str(dict(adapter.info)).lower()], available


@contextmanager
def _quiet_without_wayland() -> Iterator[None]:
    """Keep drivers that look for a compositor from complaining that there can be none.

    Without `XDG_RUNTIME_DIR`, as on servers, libwayland prints a line for each try. It needs that folder only
    for a display whose name is no path, so the display is named by one for the moment.
    """
    display = os.environ.get(_DISPLAY)
    if os.path.isabs(os.environ.get("XDG_RUNTIME_DIR", "")) or os.path.isabs(display or ""):
        yield
        return
    os.environ[_DISPLAY] = os.devnull  # where no compositor answers
    try:
        yield
    finally:
        if display is None:
            del os.environ[_DISPLAY]
        else:
            os.environ[_DISPLAY] = display


def _open(adapter: GpuObject, rejected_devices: Sequence[str]) -> Host:
    core = os.environ.get("RHI_WGPU_PROFILE") == "core"
    features = frozenset() if core else frozenset(adapter.features) & _USED
    limits = CORE_LIMITS if core else dict(adapter.limits)
    device = adapter.request_device_sync(required_features=sorted(features), required_limits=limits)
    retain_callbacks(device)
    return Host(device, dict(adapter.info), features, dict(device.limits), tuple(rejected_devices))
