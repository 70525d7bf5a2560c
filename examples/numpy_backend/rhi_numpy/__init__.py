"""The numpy backend of rhi: `rhi.create_device("numpy")`."""

from rhi.contract import Backend
from rhi_numpy.backend import NumpyBackend

__rhi_internal__ = True  # errors name the line that called rhi, not one of this module

__all__ = ["NumpyBackend", "create_backend"]


def create_backend(*, validation: bool = False) -> Backend:
    """Create a device. `validation` is accepted and ignored: NumPy has no driver with messages of its own."""
    return NumpyBackend()
