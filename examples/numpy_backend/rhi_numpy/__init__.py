"""The numpy backend of rhi: `rhi.create_device("numpy")`."""

from rhi.contract import Backend
from rhi_numpy.backend import NumpyBackend

__rhi_internal__ = True  # call sites name the line that called rhi, not ours

__all__ = ["NumpyBackend", "create_backend"]


def create_backend(*, validation: bool = False) -> Backend:
    """A new device. `validation` asks for the driver's own messages as exceptions.

    Raises:
        rhi.DeviceError: `device-driver` if the driver can't be used, with what to install.
    """
    return NumpyBackend()
