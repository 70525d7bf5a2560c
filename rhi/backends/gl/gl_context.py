"""Creates a GL context without a window, through EGL, and finds out which context is current."""

from __future__ import annotations

import ctypes
from collections.abc import Callable
from typing import TYPE_CHECKING, Any, Final

from rhi.contract.interrupts import DeferredSignals
from rhi.errors import DeviceError
from rhi.errors.rules import DEVICE_DRIVER

if TYPE_CHECKING:
    import moderngl

_CALL: Final = "rhi.create_device('gl')"
_VERSION: Final = 450
"""The first version in which direct state access, clip control and inverted conditional rendering are
core."""

_INSTALL_DRIVER: Final = "on Debian: apt install libegl1 libegl-mesa0 libgl1-mesa-dri"
_INSTALL_MODERNGL: Final = "pip install moderngl"
_EGL: Final = "libEGL.so.1"
_MAX_EGL_DEVICES: Final = 16
"""Devices to try, in EGL's order, which has hardware before software. The user may lack the rights for the
first."""
_NO_SUCH_DEVICE: Final = "requested device index"
CURRENT_CONTEXT: Final = "eglGetCurrentContext"


def open_context() -> moderngl.Context:
    """Create a context and make it current.

    Raises:
        DeviceError: `device-driver`, with a tip that says what to install.
    """
    try:
        import moderngl  # noqa: F401
    except ImportError as error:
        raise DeviceError(DEVICE_DRIVER, _CALL, str(error), tip=_INSTALL_MODERNGL) from error
    # EGL finds GL's functions itself, so libGL and its X libraries aren't needed. The names are given
    # explicitly because glcontext would search for the libraries by running ldconfig and a compiler.
    settings: Any = {"backend": "egl", "libgl": _EGL, "libegl": _EGL}
    obstacles: list[str] = []
    with (
        DeferredSignals()
    ):  # see `Programs._link`; around the `except`, which would swallow what handlers raise
        context = _create_context(settings, obstacles)
    if context is not None:
        return context
    given = f"no OpenGL {_VERSION / 100:.1f} context: {obstacles[0]}"
    raise DeviceError(DEVICE_DRIVER, _CALL, given, "EGL and a driver for OpenGL 4.5", _INSTALL_DRIVER)


def _create_context(settings: dict[str, Any], obstacles: list[str]) -> moderngl.Context | None:
    """Return a context on the first device of EGL that has one; add the errors of the others to
    `obstacles`."""
    import moderngl

    for device in range(_MAX_EGL_DEVICES):
        try:
            settings["device_index"] = device
            return moderngl.create_context(_VERSION, standalone=True, **settings)
        except Exception as error:  # moderngl and glcontext raise plain Exceptions
            obstacles.append(str(error))
            if _NO_SUCH_DEVICE in str(error):
                break
    return None


def make_current_context_query(context: moderngl.Context, function: str) -> Callable[[], int | None]:
    """Return the function of EGL or GLX that returns the address of the context that is current on the
    calling thread, or None.

    A call takes 0.3 µs, since libglvnd asks the system for the process's id each time.
    """
    return ctypes.PYFUNCTYPE(ctypes.c_void_p)(context.mglo._context.load(function))
