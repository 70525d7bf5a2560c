"""The null backend: real memory, real time order, no GPU; draws are counted, not rasterised.

`create_backend()` gives the backend itself. A device made with `rhi.create_device("null")` always has a
`rhi.recorder.Recorder` in front of it.
"""

from rhi.backends.null.backend import NullBackend, Statistics
from rhi.backends.null.queries import Draw
from rhi.backends.null.resources import IndirectDraws

__rhi_internal__ = True

__all__ = ["Draw", "IndirectDraws", "NullBackend", "Statistics", "create_backend"]


def create_backend(*, validation: bool = False) -> NullBackend:
    """A new null backend. There is no driver whose messages `validation` could turn on."""
    return NullBackend()
