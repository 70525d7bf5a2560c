"""Opening a GL context without a window."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from rhi.errors import DeviceError
from rhi.rules import DEVICE_DRIVER

if TYPE_CHECKING:
    import moderngl

__rhi_internal__ = True

_CALL: Final = "rhi.create_device('gl')"
_VERSION: Final = 450
"""Direct state access, clip control and inverted conditional rendering are core from here on."""

_INSTALL_DRIVER: Final = "on Debian: apt install libegl1 libegl-mesa0 libgl1-mesa-dri"
_INSTALL_MODERNGL: Final = "pip install moderngl"
_EGL: Final = "libEGL.so.1"


def open_context() -> moderngl.Context:
    """A new context, made current.

    Raises:
        DeviceError: `device-driver`, with what to install.
    """
    try:
        import moderngl
    except ImportError as error:
        raise DeviceError(DEVICE_DRIVER, _CALL, str(error), tip=_INSTALL_MODERNGL) from error
    try:
        # EGL finds GL's functions itself, so there is no need for libGL and its X libraries. Named outright
        # because glcontext would look for the libraries by running ldconfig and a compiler.
        return moderngl.create_context(
            require=_VERSION, standalone=True, backend="egl", libgl=_EGL, libegl=_EGL  # type: ignore[arg-type]
        )
    except Exception as error:  # moderngl and glcontext raise plain Exceptions
        given = f"no OpenGL {_VERSION / 100:.1f} context: {error}"
        raise DeviceError(DEVICE_DRIVER, _CALL, given, "EGL and a driver for OpenGL 4.5", _INSTALL_DRIVER) from error
