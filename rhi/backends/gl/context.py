"""Opening a GL context without a window."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final

from rhi.errors import DeviceError
from rhi.errors.rules import DEVICE_DRIVER

if TYPE_CHECKING:
    import moderngl

__rhi_internal__ = True

_CALL: Final = "rhi.create_device('gl')"
_VERSION: Final = 450
"""Direct state access, clip control and inverted conditional rendering are core from here on."""

_INSTALL_DRIVER: Final = "on Debian: apt install libegl1 libegl-mesa0 libgl1-mesa-dri"
_INSTALL_MODERNGL: Final = "pip install moderngl"
_EGL: Final = "libEGL.so.1"
_MAX_EGL_DEVICES: Final = 16
"""Tried in EGL's order, hardware before software: the first may be one that this user may not open."""
_NO_SUCH_DEVICE: Final = "requested device index"


def open_context() -> moderngl.Context:
    """A new context, made current.

    Raises:
        DeviceError: `device-driver`, with what to install.
    """
    try:
        import moderngl
    except ImportError as error:
        raise DeviceError(DEVICE_DRIVER, _CALL, str(error), tip=_INSTALL_MODERNGL) from error
    # EGL finds GL's functions itself, so there is no need for libGL and its X libraries. Named outright because
    # glcontext would look for the libraries by running ldconfig and a compiler.
    settings: Any = {"backend": "egl", "libgl": _EGL, "libegl": _EGL}
    obstacles = []
    for device in range(_MAX_EGL_DEVICES):
        try:
            settings["device_index"] = device
            return moderngl.create_context(_VERSION, standalone=True, **settings)
        except Exception as error:  # moderngl and glcontext raise plain Exceptions
            obstacles.append(str(error))
            if _NO_SUCH_DEVICE in str(error):
                break
    given = f"no OpenGL {_VERSION / 100:.1f} context: {obstacles[0]}"
    raise DeviceError(DEVICE_DRIVER, _CALL, given, "EGL and a driver for OpenGL 4.5", _INSTALL_DRIVER)
