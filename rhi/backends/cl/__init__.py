"""The OpenCL backend: memory, compute and draws on any OpenCL device, such as the CPU through PoCL.

`create_backend` is its entry point in the group `rhi.backends`. pyopencl is imported only when it is called.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from rhi.errors import DeviceError
from rhi.errors.rules import DEVICE_DRIVER

if TYPE_CHECKING:
    from rhi.backends.cl.cl_backend import ClBackend


def create_backend(*, validation: bool = False) -> ClBackend:
    """Create a backend on the first OpenCL device that works, or on the one that `RHI_CL_DEVICE` names.

    `validation` has no effect, since OpenCL has no debug layer.

    Raises:
        DeviceError: `device-driver` if pyopencl or a working device is missing; the tip says what to install.
            `device-out-of-memory`.
    """
    try:
        import pyopencl
    except ImportError as error:
        raise DeviceError(
            DEVICE_DRIVER, "rhi.create_device('cl')", str(error), tip="pip install pyopencl"
        ) from error
    from rhi.backends.cl.pocl.driver_loader import DriverLoader
    from rhi.backends.cl.pocl.kernel_cache import settle_folder

    settle_folder()
    loading = DriverLoader(pyopencl._cl.__file__)
    import rhi.shading.opencl.opencl_stages  # noqa: F401  # what the first shader needs
    from rhi.backends.cl.cl_backend import ClBackend
    from rhi.backends.cl.cl_context import open_context
    from rhi.backends.cl.cl_errors import translate_errors

    context = open_context(loading)
    with translate_errors("rhi.create_device('cl')"):
        return ClBackend(context)
