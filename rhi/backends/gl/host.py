"""Contexts of other code: a device beside one, whose textures both use, and the picture in what that code draws to.

- The device doesn't draw in a context that it didn't make. It makes one of its own, which **shares objects** with the
  other one, the host's. So states, bindings, framebuffers and vertex arrays of either side are never the other's, and
  nothing has to be put back or declared changed. Textures, buffers and programs have the same names in both.
- The price is a change of contexts when the device begins, and one when it hands back (`show`).
- Only the device's context must be of OpenGL 4.5. The host's may be older, so what is called in it, to copy a picture
  to its framebuffer, is OpenGL 3.2, and what that changes is put back.
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


class Place(NamedTuple):
    """A context and what it draws to: the arguments that make it current. Numbers are addresses or ids."""

    context: int
    display: int
    draw: int
    read: int


class ContextApi(ABC):
    """The platform's calls that make contexts current, of EGL or GLX.

    Attributes:
        current_context: the name of its function that returns the current context.
    """

    libraries: ClassVar[tuple[str, ...]]
    current_context: ClassVar[str]

    def __init__(self) -> None:
        """Raises OSError if no library is there."""
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
    def find_current(self) -> Place | None:
        """Return the place that is current on this thread."""

    @abstractmethod
    def make_current(self, place: Place) -> bool:
        """Make a place current; return whether that was possible."""

    @abstractmethod
    def share(self, host: Place) -> Place | None:
        """Create a context of OpenGL 4.5 that shares objects with the host's."""

    @abstractmethod
    def destroy(self, place: Place) -> None:
        """Destroy a context."""

    @abstractmethod
    def measure(self, place: Place) -> tuple[int, int]:
        """Return the (width, height) in pixels of what a place draws to; 0 for nothing."""

    @abstractmethod
    def swap(self, place: Place) -> None:
        """Show what was drawn in the window that is current."""

    @abstractmethod
    def find_address(self, name: str) -> int:
        """Return the address of a function of GL."""


_POINTER: Final = ctypes.c_void_p
_UNSIGNED: Final = ctypes.c_uint
_CONFIG_ID: Final = 0x8013  # GLX_FBCONFIG_ID


class Egl(ContextApi):
    """EGL. The device's context has no surface."""

    libraries = ("libEGL.so.1",)
    current_context = "eglGetCurrentContext"

    def find_current(self) -> Place | None:
        context = self._function("eglGetCurrentContext", _POINTER)()
        if not context:
            return None
        surface = self._function("eglGetCurrentSurface", _POINTER, ctypes.c_int)
        display = self._function("eglGetCurrentDisplay", _POINTER)()
        return Place(context, display or 0, surface(0x3059) or 0, surface(0x305A) or 0)  # EGL_DRAW, EGL_READ

    def make_current(self, place: Place) -> bool:
        make = self._function("eglMakeCurrent", _UNSIGNED, *[_POINTER] * 4)
        return bool(make(place.display, place.draw, place.read, place.context))

    def share(self, host: Place) -> Place | None:
        choose = self._function("eglChooseConfig", _UNSIGNED, _POINTER, _POINTER, _POINTER, ctypes.c_int, _POINTER)
        create = self._function("eglCreateContext", _POINTER, *[_POINTER] * 4)
        config, count = _POINTER(), ctypes.c_int()
        wanted = (ctypes.c_int * 5)(0x3033, 0, 0x3040, 8, 0x3038)  # any SURFACE_TYPE, RENDERABLE_TYPE: OPENGL
        choose(host.display, wanted, ctypes.byref(config), 1, ctypes.byref(count))
        if not count.value:
            return None
        asked = (ctypes.c_int * 7)(0x3098, _MAJOR, 0x30FB, _MINOR, 0x30FD, 1, 0x3038)  # a core profile
        context = create(host.display, config, host.context, asked)
        return Place(context, host.display, 0, 0) if context else None

    def destroy(self, place: Place) -> None:
        self._function("eglDestroyContext", _UNSIGNED, _POINTER, _POINTER)(place.display, place.context)

    def measure(self, place: Place) -> tuple[int, int]:
        if not place.draw:
            return 0, 0
        query = self._function("eglQuerySurface", _UNSIGNED, _POINTER, _POINTER, ctypes.c_int, _POINTER)
        width, height = ctypes.c_int(), ctypes.c_int()
        query(place.display, place.draw, 0x3057, ctypes.byref(width))
        query(place.display, place.draw, 0x3056, ctypes.byref(height))
        return width.value, height.value

    def swap(self, place: Place) -> None:
        self._function("eglSwapBuffers", _UNSIGNED, _POINTER, _POINTER)(place.display, place.draw)

    def find_address(self, name: str) -> int:
        return self._function("eglGetProcAddress", _POINTER, ctypes.c_char_p)(name.encode()) or 0


class Glx(ContextApi):
    """GLX, whose contexts need something to draw to. The device's has a hidden surface of one pixel."""

    libraries = ("libGL.so.1", "libGLX.so.0")
    current_context = "glXGetCurrentContext"

    def find_current(self) -> Place | None:
        context = self._function("glXGetCurrentContext", _POINTER)()
        if not context:
            return None
        display = self._function("glXGetCurrentDisplay", _POINTER)()
        draw, read = (
            self._function(name, ctypes.c_ulong)() for name in ("glXGetCurrentDrawable", "glXGetCurrentReadDrawable")
        )
        return Place(context, display, draw, read)

    def make_current(self, place: Place) -> bool:
        make = self._function("glXMakeContextCurrent", ctypes.c_int, _POINTER, ctypes.c_ulong, ctypes.c_ulong, _POINTER)
        return bool(make(place.display, place.draw, place.read, place.context))

    def share(self, host: Place) -> Place | None:
        # The host's own configuration: of others a driver may share nothing.
        query = self._function(
            "glXQueryContext", ctypes.c_int, _POINTER, _POINTER, ctypes.c_int, ctypes.POINTER(ctypes.c_int)
        )
        number, screen = ctypes.c_int(), ctypes.c_int()
        query(host.display, host.context, _CONFIG_ID, ctypes.byref(number))
        if number.value <= 0:  # of a context that was made from a visual, as SDL's are, Mesa says none
            draws = self._function("glXQueryDrawable", None, _POINTER, ctypes.c_ulong, ctypes.c_int, _POINTER)
            draws(host.display, host.draw, _CONFIG_ID, ctypes.byref(number))
        query(host.display, host.context, 0x800C, ctypes.byref(screen))  # GLX_SCREEN
        config = self._find_config(host.display, screen.value, number.value)
        create = ctypes.CFUNCTYPE(_POINTER, _POINTER, _POINTER, _POINTER, ctypes.c_int, _POINTER)(
            self.find_address("glXCreateContextAttribsARB")
        )
        if config is None or not create:
            return None
        asked = (ctypes.c_int * 7)(0x2091, _MAJOR, 0x2092, _MINOR, 0x9126, 1, 0)
        context = create(host.display, config, host.context, 1, asked)
        if not context:
            return None
        surface = self._function("glXCreatePbuffer", ctypes.c_ulong, _POINTER, _POINTER, _POINTER)
        hidden = surface(host.display, config, (ctypes.c_int * 5)(0x8041, 1, 0x8040, 1, 0))  # width, height
        return Place(context, host.display, hidden, hidden)

    def _find_config(self, display: int, screen: int, number: int) -> int | None:
        """Return the address of the configuration of this number. `glXChooseFBConfig` leaves out those that no window
        can have, and a context without a window may have one of them."""
        count, found = ctypes.c_int(), ctypes.c_int()
        list_all = self._function("glXGetFBConfigs", ctypes.POINTER(_POINTER), _POINTER, ctypes.c_int, _POINTER)
        read = self._function("glXGetFBConfigAttrib", ctypes.c_int, _POINTER, _POINTER, ctypes.c_int, _POINTER)
        configs = list_all(display, screen, ctypes.byref(count))
        for place in range(count.value):
            read(display, configs[place], _CONFIG_ID, ctypes.byref(found))
            if found.value == number:
                config: int = configs[place]
                return config
        return None

    def destroy(self, place: Place) -> None:
        self._function("glXDestroyContext", None, _POINTER, _POINTER)(place.display, place.context)
        self._function("glXDestroyPbuffer", None, _POINTER, ctypes.c_ulong)(place.display, place.draw)

    def measure(self, place: Place) -> tuple[int, int]:
        query = self._function("glXQueryDrawable", None, _POINTER, ctypes.c_ulong, ctypes.c_int, _POINTER)
        width, height = ctypes.c_uint(), ctypes.c_uint()
        query(place.display, place.draw, 0x801D, ctypes.byref(width))
        query(place.display, place.draw, 0x801E, ctypes.byref(height))
        return width.value, height.value

    def swap(self, place: Place) -> None:
        self._function("glXSwapBuffers", None, _POINTER, ctypes.c_ulong)(place.display, place.draw)

    def find_address(self, name: str) -> int:
        return self._function("glXGetProcAddressARB", _POINTER, ctypes.c_char_p)(name.encode()) or 0


class SharedContext:
    """The device's context, as moderngl uses contexts: entered, it is current; left, the host's is, or none on a thread
    where the host's never was. When it is left for the first time, what was current `before` it was made is.
    """

    def __init__(self, api: ContextApi, host: Place, own: Place, before: Place) -> None:
        self.api = api
        self.host = host
        self._own = own
        self._before: Place | None = before
        self._thread = get_ident()

    @property
    def returns(self) -> bool:
        """Whether the host's context is current on this thread after the device's."""
        return get_ident() == self._thread

    def load(self, name: str) -> int:
        """Return the address of a function."""
        return self.api.find_address(name)

    load_opengl_function = load

    def __enter__(self) -> None:
        current = self.api.find_current()
        if current is not None and current.context == self.host.context:
            self.host, self._thread = current, get_ident()  # it may draw to another window by now
        self.api.make_current(self._own)

    def __exit__(self, *_: object) -> None:
        place, self._before = self._before or self.host, None
        if not (self.returns and self.api.make_current(place)):
            self.api.make_current(Place(0, self._own.display, 0, 0))  # none

    def release(self) -> None:
        """Destroy the context."""
        self.api.destroy(self._own)


def open_shared_context(host: HostContext) -> tuple[moderngl.Context, SharedContext]:
    """Create a context that shares objects with the host's, and make it current until it is left. If that fails, what
    was current is.

    Raises:
        ValidationError: `device-argument` if `host` is nothing of that kind.
        DeviceError: `device-driver` if there is no current context, or none of OpenGL 4.5 can share with it.
    """
    current = _find_current()
    if isinstance(host, moderngl.Context):
        host.mglo.__enter__()
    elif host != "current":
        refuse(DEVICE_ARGUMENT, _CALL, repr(host), 'a moderngl.Context, or "current"')
    found = _find_current()
    if found is None:
        tip = "make the window's context current first, e.g. glfw.make_context_current(window)"
        raise DeviceError(DEVICE_DRIVER, _CALL, "no OpenGL context is current", "one made by EGL or GLX", tip)
    api, place = found
    before = current[1] if current is not None else Place(0, place.display, 0, 0)
    own = api.share(place)
    if own is None or not api.make_current(own):
        api.make_current(place)
        version = _describe_version(api)
        api.make_current(before)
        tip = "the host's own context may be of any version from 3.2"
        given = f"a context ({version}) whose driver shares none of OpenGL 4.5 with it"
        raise DeviceError(DEVICE_DRIVER, _CALL, given, "a driver for OpenGL 4.5", tip)
    shared = SharedContext(api, place, own, before)
    settings: Any = {"context": shared}
    return moderngl.create_context(100 * _MAJOR + 10 * _MINOR, **settings), shared


def _find_current() -> tuple[ContextApi, Place] | None:
    for kind in (Egl, Glx):
        try:
            api = kind()
        except OSError:
            continue
        place = api.find_current()
        if place is not None:
            return api, place
    return None


def _describe_version(api: ContextApi) -> str:
    get = ctypes.CFUNCTYPE(ctypes.c_char_p, _UNSIGNED)(api.find_address("glGetString"))
    return (get(enums.VERSION) or b"unknown version").decode(errors="replace")


class HostFramebuffer:
    """Copies pictures to what the host draws to, in its context: to the whole window, or, if it has bound a framebuffer
    of its own, to the viewport there.

    A picture is copied bit for bit, its top row uppermost, and scaled if the place has another size.

    Mesa gives a window's back buffer the size that the window has as its context becomes current, until buffers are
    swapped. So if it was current without a picture (`note_idle`) and the window was resized since, they are.
    """

    def __init__(self, gl: EntryPoints) -> None:
        self._gl = gl
        self._framebuffer = 0
        self._idle: tuple[int, int] | None = None

    def note_idle(self, api: ContextApi, host: Place) -> None:
        """Note that the host's context is current without a picture from the device."""
        self._idle = api.measure(host)

    def show(self, texture: int, size: tuple[int, int], api: ContextApi, host: Place) -> None:
        """Copy the texture of this name and (width, height) to a place that is current."""
        gl, window, idle = self._gl, api.measure(host), self._idle  # the viewport may not have the window's size yet
        self._idle = None
        read = gl.get_integer(enums.READ_FRAMEBUFFER_BINDING)
        switched = [each for each in (enums.SCISSOR_TEST, enums.FRAMEBUFFER_SRGB) if gl.IsEnabled(each)]
        area = (ctypes.c_int * 4)()
        if gl.get_integer(enums.DRAW_FRAMEBUFFER_BINDING):
            gl.GetIntegerv(enums.VIEWPORT, area)
        else:
            area[2:] = list(window)
            if idle not in (None, window):
                api.swap(host)
        x, y, width, height = area
        if not self._framebuffer:
            self._framebuffer = gl.create(gl.GenFramebuffers)
        gl.BindFramebuffer(enums.READ_FRAMEBUFFER, self._framebuffer)
        gl.FramebufferTexture2D(enums.READ_FRAMEBUFFER, enums.COLOR_ATTACHMENT0, enums.TEXTURE_2D, texture, 0)
        for each in switched:
            gl.Disable(each)
        scaled = (width, height) != size  # else no filter may round
        gl.BlitFramebuffer(
            0, 0, *size, x, y + height, x + width, y, enums.COLOR_BUFFER_BIT,
            enums.LINEAR if scaled else enums.NEAREST,
        )  # fmt: skip
        for each in switched:
            gl.Enable(each)
        gl.FramebufferTexture2D(enums.READ_FRAMEBUFFER, enums.COLOR_ATTACHMENT0, enums.TEXTURE_2D, 0, 0)
        gl.BindFramebuffer(enums.READ_FRAMEBUFFER, read)

    def destroy(self) -> None:
        """Delete the framebuffer, in the host's context."""
        if self._framebuffer:
            self._gl.delete(self._gl.DeleteFramebuffers, self._framebuffer)
            self._framebuffer = 0
