"""The wgpu backend: Vulkan, Metal and Direct3D 12 through WebGPU's native implementation (wgpu-py).

`create_backend` is its entry point in the group `rhi.backends`. wgpu is imported only when it is called.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from rhi.errors import DeviceError
from rhi.errors.rules import DEVICE_DRIVER

if TYPE_CHECKING:
    from rhi.backends.wgpu.wgpu_backend import WgpuBackend

__all__ = ["create_backend", "find_obstacle"]


def create_backend(*, validation: bool = False) -> WgpuBackend:
    """Create a backend on the best adapter, or on the first whose description contains `RHI_WGPU_ADAPTER`.

    `validation` has no effect: WebGPU checks everything, and what it refuses is raised in any case.

    Raises:
        DeviceError: `device-driver` if wgpu or an adapter is missing; the tip says what to install.
    """
    try:
        import wgpu.backends.wgpu_native  # noqa: F401
    except (ImportError, OSError, RuntimeError) as error:
        call, tip = "rhi.create_device('wgpu')", 'pip install "rhi[wgpu]"'
        raise DeviceError(DEVICE_DRIVER, call, str(error), tip=tip) from error
    from rhi.backends.wgpu.adapters import open_host
    from rhi.backends.wgpu.wgpu_backend import WgpuBackend

    return WgpuBackend(open_host())


def find_obstacle() -> str | None:
    """Return why wgpu can't be used on this machine, in one line, or None if it can."""
    try:
        create_backend().close()
    except DeviceError as error:
        return f"{error.given}; {error.tip}"
    return None
