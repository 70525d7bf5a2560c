"""The OpenGL backend: GL 4.5 core, headless through EGL.

`create_backend` is its entry point in the group `rhi.backends`. No GL library is imported before it is
called.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from rhi.backends.gl.platform_states import DepthClamp

if TYPE_CHECKING:
    from rhi.backends.gl.gl_backend import GlBackend
    from rhi.backends.gl.gl_host import HostContext

__all__ = ["DepthClamp", "create_backend"]


def create_backend(*, validation: bool = False, context: HostContext | None = None) -> GlBackend:
    """Create a backend with its own context.

    Args:
        validation: raise the errors that the driver reports as `DeviceError` (`device-debug`). This is
            slower.
        context: the context of other code to share textures with and to show images in: moderngl's, or
            `"current"`, the one that is current on this thread. None: the backend has no window and shares
            nothing.

    Raises:
        DeviceError: `device-driver` if moderngl, EGL or a driver for GL 4.5 is missing; its tip says what to
            install.
    """
    from rhi.backends.gl.gl_context import open_context

    shared = None
    if context is None:
        opened = open_context()
    else:
        from rhi.backends.gl.gl_host import open_shared_context

        opened, shared = open_shared_context(context)
    from rhi.backends.gl.gl_backend import GlBackend, release_dropped

    release_dropped()
    if validation:
        from rhi.backends.gl.debug import DebugGlBackend

        return DebugGlBackend(opened, shared)
    return GlBackend(opened, shared)
