"""Shared contexts: a device beside the context of other code, with shared textures, and images in its window.

- The device doesn't draw in a context that it didn't make. It makes one of its own, which **shares objects**
  with the other one, the host's. So each side has its own states, bindings, framebuffers and vertex arrays,
  and nothing has to be restored or declared changed. Textures, buffers and programs have the same names in
  both.
- The cost is a switch of contexts when the device begins, and one when it hands back (`show`).
- Only the device's context must be of OpenGL 4.5. The host's may be older, so an image is copied to its
  framebuffer with calls of OpenGL 3.2, and the states that these change are restored.
- EGL and GLX are known. A thread uses one of them, the one whose context is current.
"""

from __future__ import annotations

import ctypes
from abc import ABC, abstractmethod
from threading import get_ident
from typing import Any, ClassVar, Final, Literal, NamedTuple, TypeAlias

import moderngl

from rhi.backends.gl import enums
from rhi.backends.gl.entry_points import EntryPoints
from rhi.errors import DeviceError, refuse
from rhi.errors.rules import DEVICE_ARGUMENT, DEVICE_DRIVER

HostContext: TypeAlias = "moderngl.Context | Literal['current']"
"""A context of other code: moderngl's, or the one that is current on the calling thread."""

_CALL: Final = "rhi.create_device('gl', context=…)"
_MAJOR, _MINOR = 4, 5


class ContextBinding(NamedTuple):
    """A context and what it draws to: the arguments that make it current. Numbers are addresses or ids."""

    context: int
    display: int
    draw: int
    read: int


class ContextApi(ABC):
    """The platform's calls that make contexts current, of EGL or GLX.

    Attributes:
        current_context_function: the name of its function that returns the current context.
    """

    libraries: ClassVar[tuple[str, ...]]
    current_context_function: ClassVar[str]

    def __init__(self) -> None:
        """Load the library. Raises OSError if it isn't installed."""
        for name in self.libraries[:-1]:
            try:
                self._library = ctypes.CDLL(name)
                return
            except OSError:
                continue
        self._library = ctypes.CDLL(self.libraries[-1])

    def _function(self, name: str, result: Any, *arguments: Any) -> Any:
        function = self._library[name]
        function.restype, function.argtypes = result, arguments
        return function

    @abstractmethod
    def get_current(self) -> ContextBinding | None:
        """Return the context and surfaces that are current on this thread; None if there are none."""

    @abstractmethod
    def make_current(self, binding: ContextBinding) -> bool:
        """Make a context and its surfaces current; return whether that was possible."""

    @abstractmethod
    def create_shared(self, host: ContextBinding) -> ContextBinding | None:
        """Create a context of OpenGL 4.5 that shares objects with the host's."""

    @abstractmethod
    def destroy(self, binding: ContextBinding) -> None:
        """Destroy a context."""

    @abstractmethod
    def surface_size(self, binding: ContextBinding) -> tuple[int, int]:
        """Return the (width, height) in pixels of a binding's surface; (0, 0) without one."""

    @abstractmethod
    def swap_buffers(self, binding: ContextBinding) -> None:
        """Show what was drawn in the window that is current."""

    @abstractmethod
    def get_proc_address(self, name: str) -> int:
        """Return the address of a GL function."""


_POINTER: Final = ctypes.c_void_p
_UNSIGNED: Final = ctypes.c_uint
_CONFIG_ID: Final = 0x8013  # GLX_FBCONFIG_ID


class Egl(ContextApi):
    """EGL. The device's context has no surface."""

    libraries = ("libEGL.so.1",)
    current_context_function = "eglGetCurrentContext"

    def get_current(self) -> ContextBinding | None:
        context = self._function("eglGetCurrentContext", _POINTER)()
        if not context:
            return None
        surface = self._function("eglGetCurrentSurface", _POINTER, ctypes.c_int)
        display = self._function("eglGetCurrentDisplay", _POINTER)()
        return ContextBinding(
            context, display or 0, surface(0x3059) or 0, surface(0x305A) or 0
        )  # EGL_DRAW, EGL_READ

    def make_current(self, binding: ContextBinding) -> bool:
        make = self._function("eglMakeCurrent", _UNSIGNED, *[_POINTER] * 4)
        return bool(make(binding.display, binding.draw, binding.read, binding.context))

    def create_shared(self, host: ContextBinding) -> ContextBinding | None:
        choose = self._function(
            "eglChooseConfig", _UNSIGNED, _POINTER, _POINTER, _POINTER, ctypes.c_int, _POINTER
        )
        create = self._function("eglCreateContext", _POINTER, *[_POINTER] * 4)
        config, count = _POINTER(), ctypes.c_int()
        attributes = (ctypes.c_int * 5)(
            0x3033, 0, 0x3040, 8, 0x3038
        )  # any SURFACE_TYPE, RENDERABLE_TYPE: OPENGL
        choose(host.display, attributes, ctypes.byref(config), 1, ctypes.byref(count))
        if not count.value:
            return None
        asked = (ctypes.c_int * 7)(0x3098, _MAJOR, 0x30FB, _MINOR, 0x30FD, 1, 0x3038)  # a core profile
        context = create(host.display, config, host.context, asked)
        return ContextBinding(context, host.display, 0, 0) if context else None

    def destroy(self, binding: ContextBinding) -> None:
        self._function("eglDestroyContext", _UNSIGNED, _POINTER, _POINTER)(binding.display, binding.context)

    def surface_size(self, binding: ContextBinding) -> tuple[int, int]:
        if not binding.draw:
            return 0, 0
        query = self._function("eglQuerySurface", _UNSIGNED, _POINTER, _POINTER, ctypes.c_int, _POINTER)
        width, height = ctypes.c_int(), ctypes.c_int()
        query(binding.display, binding.draw, 0x3057, ctypes.byref(width))
        query(binding.display, binding.draw, 0x3056, ctypes.byref(height))
        return width.value, height.value

    def swap_buffers(self, binding: ContextBinding) -> None:
        self._function("eglSwapBuffers", _UNSIGNED, _POINTER, _POINTER)(binding.display, binding.draw)

    def get_proc_address(self, name: str) -> int:
        return self._function("eglGetProcAddress", _POINTER, ctypes.c_char_p)(name.encode()) or 0


class Glx(ContextApi):
    """GLX, whose contexts need something to draw to. The device's has a hidden surface of one pixel."""

    libraries = ("libGL.so.1", "libGLX.so.0")
    current_context_function = "glXGetCurrentContext"

    def get_current(self) -> ContextBinding | None:
        context = self._function("glXGetCurrentContext", _POINTER)()
        if not context:
            return None
        display = self._function("glXGetCurrentDisplay", _POINTER)()
        draw, read = (
            self._function(name, ctypes.c_ulong)()
            for name in ("glXGetCurrentDrawable", "glXGetCurrentReadDrawable")
        )
        return ContextBinding(context, display, draw, read)

    def make_current(self, binding: ContextBinding) -> bool:
        make = self._function(
            "glXMakeContextCurrent", ctypes.c_int, _POINTER, ctypes.c_ulong, ctypes.c_ulong, _POINTER
        )
        return bool(make(binding.display, binding.draw, binding.read, binding.context))

    def create_shared(self, host: ContextBinding) -> ContextBinding | None:
        # The host's own configuration: of others a driver may share nothing.
        query = self._function(
            "glXQueryContext", ctypes.c_int, _POINTER, _POINTER, ctypes.c_int, ctypes.POINTER(ctypes.c_int)
        )
        number, screen = ctypes.c_int(), ctypes.c_int()
        query(host.display, host.context, _CONFIG_ID, ctypes.byref(number))
        if number.value <= 0:  # Mesa reports none for a context that was created from a visual, as SDL's are
            draws = self._function("glXQueryDrawable", None, _POINTER, ctypes.c_ulong, ctypes.c_int, _POINTER)
            draws(host.display, host.draw, _CONFIG_ID, ctypes.byref(number))
        query(host.display, host.context, 0x800C, ctypes.byref(screen))  # GLX_SCREEN
        config = self._find_config(host.display, screen.value, number.value)
        create = ctypes.CFUNCTYPE(_POINTER, _POINTER, _POINTER, _POINTER, ctypes.c_int, _POINTER)(
            self.get_proc_address("glXCreateContextAttribsARB")
        )
        if config is None or not create:
            return None
        asked = (ctypes.c_int * 7)(0x2091, _MAJOR, 0x2092, _MINOR, 0x9126, 1, 0)
        context = create(host.display, config, host.context, 1, asked)
        if not context:
            return None
        surface = self._function("glXCreatePbuffer", ctypes.c_ulong, _POINTER, _POINTER, _POINTER)
        hidden = surface(host.display, config, (ctypes.c_int * 5)(0x8041, 1, 0x8040, 1, 0))  # width, height
        return ContextBinding(context, host.display, hidden, hidden)

    def _find_config(self, display: int, screen: int, number: int) -> int | None:
        """Return the address of the configuration with this number.

        `glXChooseFBConfig` omits configurations that no window can have, but a context without a window may
        have one of them."""
        count, value = ctypes.c_int(), ctypes.c_int()
        list_all = self._function(
            "glXGetFBConfigs", ctypes.POINTER(_POINTER), _POINTER, ctypes.c_int, _POINTER
        )
        read = self._function(
            "glXGetFBConfigAttrib", ctypes.c_int, _POINTER, _POINTER, ctypes.c_int, _POINTER
        )
        configs = list_all(display, screen, ctypes.byref(count))
        for index in range(count.value):
            read(display, configs[index], _CONFIG_ID, ctypes.byref(value))
            if value.value == number:
                config: int = configs[index]
                return config
        return None

    def destroy(self, binding: ContextBinding) -> None:
        self._function("glXDestroyContext", None, _POINTER, _POINTER)(binding.display, binding.context)
        self._function("glXDestroyPbuffer", None, _POINTER, ctypes.c_ulong)(binding.display, binding.draw)

    def surface_size(self, binding: ContextBinding) -> tuple[int, int]:
        query = self._function("glXQueryDrawable", None, _POINTER, ctypes.c_ulong, ctypes.c_int, _POINTER)
        width, height = ctypes.c_uint(), ctypes.c_uint()
        query(binding.display, binding.draw, 0x801D, ctypes.byref(width))
        query(binding.display, binding.draw, 0x801E, ctypes.byref(height))
        return width.value, height.value

    def swap_buffers(self, binding: ContextBinding) -> None:
        self._function("glXSwapBuffers", None, _POINTER, ctypes.c_ulong)(binding.display, binding.draw)

    def get_proc_address(self, name: str) -> int:
        return self._function("glXGetProcAddressARB", _POINTER, ctypes.c_char_p)(name.encode()) or 0


class SharedContext:
    """The device's context as a context manager, as moderngl uses contexts.

    Inside, it is current. Afterwards the host's context is, or none on a thread where the host's never was.
    The first exit makes current what was current before the context was created (`before`).
    """

    def __init__(
        self, api: ContextApi, host: ContextBinding, shared_binding: ContextBinding, before: ContextBinding
    ) -> None:
        self.api = api
        self.host = host
        self._own = shared_binding
        self._before: ContextBinding | None = before
        self._thread = get_ident()

    @property
    def restores_host(self) -> bool:
        """True if the host's context is current on this thread after the device's."""
        return get_ident() == self._thread

    def load(self, name: str) -> int:
        """Return the address of a function."""
        return self.api.get_proc_address(name)

    load_opengl_function = load

    def __enter__(self) -> None:
        current = self.api.get_current()
        if current is not None and current.context == self.host.context:
            self.host, self._thread = current, get_ident()  # the host may draw to another window by now
        self.api.make_current(self._own)

    def __exit__(self, *_: object) -> None:
        previous, self._before = self._before or self.host, None
        if not (self.restores_host and self.api.make_current(previous)):
            self.api.make_current(ContextBinding(0, self._own.display, 0, 0))  # none

    def release(self) -> None:
        """Destroy the context."""
        self.api.destroy(self._own)


def open_shared_context(host: HostContext) -> tuple[moderngl.Context, SharedContext]:
    """Create a context that shares objects with the host's, and make it current.

    If that fails, the context that was current before stays current.

    Raises:
        ValidationError: `device-argument` if `host` isn't a `HostContext`.
        DeviceError: `device-driver` if there is no current context, or none of OpenGL 4.5 can share with it.
    """
    current = _get_current()
    if isinstance(host, moderngl.Context):
        host.mglo.__enter__()
    elif host != "current":
        refuse(DEVICE_ARGUMENT, _CALL, repr(host), 'a moderngl.Context, or "current"')
    current_context = _get_current()
    if current_context is None:
        tip = "make the window's context current first, e.g. glfw.make_context_current(window)"
        raise DeviceError(
            DEVICE_DRIVER, _CALL, "no OpenGL context is current", "a context of EGL or GLX", tip
        )
    api, binding = current_context
    before = current[1] if current is not None else ContextBinding(0, binding.display, 0, 0)
    shared_binding = api.create_shared(binding)
    if shared_binding is None or not api.make_current(shared_binding):
        api.make_current(binding)
        version = _describe_version(api)
        api.make_current(before)
        tip = "the host's own context may be of any version from 3.2"
        given = f"a context ({version}) whose driver shares none of OpenGL 4.5 with it"
        raise DeviceError(DEVICE_DRIVER, _CALL, given, "a driver for OpenGL 4.5", tip)
    shared = SharedContext(api, binding, shared_binding, before)
    settings: Any = {"context": shared}
    return moderngl.create_context(100 * _MAJOR + 10 * _MINOR, **settings), shared


def _get_current() -> tuple[ContextApi, ContextBinding] | None:
    for kind in (Egl, Glx):
        try:
            api = kind()
        except OSError:
            continue
        binding = api.get_current()
        if binding is not None:
            return api, binding
    return None


def _describe_version(api: ContextApi) -> str:
    get = ctypes.CFUNCTYPE(ctypes.c_char_p, _UNSIGNED)(api.get_proc_address("glGetString"))
    return (get(enums.VERSION) or b"unknown version").decode(errors="replace")


class HostFramebuffer:
    """Copies images to the host's framebuffer, in the host's context.

    The target is the whole window, or, if the host has bound a framebuffer of its own, the viewport there. An
    image is copied bit for bit, its top row uppermost, and scaled if the target has another size.

    Mesa gives a window's back buffer the size that the window has as its context becomes current, until
    buffers are swapped. So buffers are swapped if the context was current without an image (`note_idle`) and
    the window was resized since.
    """

    def __init__(self, gl: EntryPoints) -> None:
        self._gl = gl
        self._framebuffer = 0
        self._idle: tuple[int, int] | None = None

    def note_idle(self, api: ContextApi, host: ContextBinding) -> None:
        """Note that the host's context is current without an image from the device."""
        self._idle = api.surface_size(host)

    def show(self, texture: int, size: tuple[int, int], api: ContextApi, host: ContextBinding) -> None:
        """Copy the texture with this GL name and (width, height) to the framebuffer of a current context."""
        gl, window, idle = (
            self._gl,
            api.surface_size(host),
            self._idle,
        )  # the viewport may not have the window's size yet
        self._idle = None
        read = gl.get_integer(enums.READ_FRAMEBUFFER_BINDING)
        switched = [switch for switch in (enums.SCISSOR_TEST, enums.FRAMEBUFFER_SRGB) if gl.IsEnabled(switch)]
        area = (ctypes.c_int * 4)()
        if gl.get_integer(enums.DRAW_FRAMEBUFFER_BINDING):
            gl.GetIntegerv(enums.VIEWPORT, area)
        else:
            area[2:] = list(window)
            if idle not in (None, window):
                api.swap_buffers(host)
        x, y, width, height = area
        if not self._framebuffer:
            self._framebuffer = gl.create(gl.GenFramebuffers)
        gl.BindFramebuffer(enums.READ_FRAMEBUFFER, self._framebuffer)
        gl.FramebufferTexture2D(enums.READ_FRAMEBUFFER, enums.COLOR_ATTACHMENT0, enums.TEXTURE_2D, texture, 0)
        for switch in switched:
            gl.Disable(switch)
        scaled = (width, height) != size  # unscaled images aren't filtered, so that nothing is rounded
        gl.BlitFramebuffer(
            0,
            0,
            *size,
            x,
            y + height,
            x + width,
            y,
            enums.COLOR_BUFFER_BIT,
            enums.LINEAR if scaled else enums.NEAREST,
        )
        for switch in switched:
            gl.Enable(switch)
        gl.FramebufferTexture2D(enums.READ_FRAMEBUFFER, enums.COLOR_ATTACHMENT0, enums.TEXTURE_2D, 0, 0)
        gl.BindFramebuffer(enums.READ_FRAMEBUFFER, read)

    def destroy(self) -> None:
        """Delete the framebuffer, in the host's context."""
        if self._framebuffer:
            self._gl.delete(self._gl.DeleteFramebuffers, self._framebuffer)
            self._framebuffer = 0
