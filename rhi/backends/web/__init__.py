"""The web backend: WebGPU in a browser's page, through Pyodide.

`create_backend` is its entry point in the group `rhi.backends`. Pyodide's modules are imported only when it is
called. `request_device` and `prepare_device` are for engines whose Python can't wait for the page (no JSPI).
"""

from __future__ import annotations

import sys
from typing import TYPE_CHECKING, Any

from rhi.errors import DeviceError
from rhi.errors.rules import DEVICE_DRIVER

if TYPE_CHECKING:
    from rhi.backends.web.web_backend import WebBackend

__all__ = ["create_backend", "find_obstacle", "prepare_device", "request_device"]

_CALL = "rhi.create_device('web')"


def create_backend(*, validation: bool = False, device: Any = None) -> WebBackend:
    """Create a backend on the page's WebGPU.

    Args:
        validation: has no effect: WebGPU checks everything, and what it refuses is raised in any case.
        device: a `GPUDevice` of the page, as from `request_device`; None requests one, which waits.

    Raises:
        DeviceError: `device-driver` outside of a page, or if it has no WebGPU or no adapter; `device-wait` if
            Python can't wait here and `device` is None.
    """
    if sys.platform != "emscripten":
        given, tip = f"Python on {sys.platform}", 'the backend runs in a page; here, try "wgpu"'
        raise DeviceError(DEVICE_DRIVER, _CALL, given, "Python in a page (Pyodide)", tip)
    from rhi.backends.web.page import WebPage, open_host
    from rhi.backends.web.web_backend import WebBackend

    page = WebPage()
    return WebBackend(page, open_host(page, device))


async def request_device() -> Any:
    """Return a new `GPUDevice` of the page, with the features that this backend uses.

    Pass it to `rhi.create_device("web", device=…)` where Python can't wait for the page.

    Raises:
        DeviceError: `device-driver` if the page has no WebGPU, or no adapter, or refuses a device.
    """
    from rhi.backends.web.page import request

    return await request()


async def prepare_device() -> None:
    """Request a `GPUDevice` for the next `rhi.create_device("web")`, which then doesn't wait for the page.

    A page that awaits this first runs programs of the desk as they are, with JSPI or without.

    Raises:
        DeviceError: as `request_device`.
    """
    from rhi.backends.web.page import prepare

    await prepare()


def find_obstacle() -> str | None:
    """Return why this backend can't be used here, in one line, or None if it can."""
    try:
        create_backend().close()
    except DeviceError as error:
        return f"{error.given}; {error.tip}"
    return None
