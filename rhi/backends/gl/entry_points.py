"""GL's entry points, called through ctypes: all functions that moderngl doesn't offer.

- A declaration in `EntryPoints` is the whole binding. mypy reads it as a callable, and the ctypes prototype
  is created from the same annotation when a context is opened.
- Entry points that take only 32-bit integers and ctypes objects get no `argtypes`. ctypes then passes each
  Python integer as a C int: 55 ns a call instead of 115 (with five typed arguments: 470).
- They keep the GIL, which saves 35 ns a call, except those that may wait (`_WAITS`).
- Mesa returns a non-null address for any name, so an address doesn't show whether a function exists. GL 4.5
  core is required. Functions of later versions or extensions are called only where a capability says so.
"""

from __future__ import annotations

import ctypes
import typing
from collections.abc import Callable
from functools import cache
from typing import TYPE_CHECKING, Annotated, Any, Final, TypeAlias

if TYPE_CHECKING:
    from ctypes import _CArgObject
else:
    _CArgObject = type(ctypes.byref(ctypes.c_int()))

Int: TypeAlias = Annotated[int, ctypes.c_int]
"""Any 32-bit integer: GLint, GLuint, GLenum, GLsizei, GLbitfield, GLboolean."""
Size: TypeAlias = Annotated[int, ctypes.c_ssize_t]
Wide: TypeAlias = Annotated[int, ctypes.c_uint64]
Real: TypeAlias = Annotated[float, ctypes.c_float]
Pointer: TypeAlias = Annotated[_CArgObject | ctypes.Array[Any] | ctypes.c_void_p | None, ctypes.c_void_p]
"""A pointer to a ctypes object."""
Address: TypeAlias = Annotated[int | None, ctypes.c_void_p]
"""A pointer as a number; None is null."""
Text: TypeAlias = Annotated[bytes, ctypes.c_char_p]

_WAITS: Final = "may wait, so it releases the GIL"

DEBUG_CALLBACK: Final = ctypes.CFUNCTYPE(
    None, *[ctypes.c_uint] * 4, ctypes.c_int, ctypes.c_void_p, ctypes.c_void_p
)
"""(source, type, id, severity, length, message, user data); the message is an address of `length` bytes."""


class EntryPoints:
    """The functions of one context, with their GL names without the prefix."""

    # context
    GetError: Callable[[], Int]
    GetIntegerv: Callable[[Int, Pointer], None]
    GetInternalformativ: Callable[[Int, Int, Int, Size, Pointer], None]
    GetIntegeri_v: Callable[[Int, Int, Pointer], None]
    GetInteger64v: Callable[[Int, Pointer], None]
    GetFloatv: Callable[[Int, Pointer], None]
    GetString: Callable[[Int], Text]
    Flush: Annotated[Callable[[], None], _WAITS]
    Finish: Annotated[Callable[[], None], _WAITS]
    PixelStorei: Callable[[Int, Int], None]
    ClipControl: Callable[[Int, Int], None]

    # states
    Enable: Callable[[Int], None]
    Disable: Callable[[Int], None]
    Enablei: Callable[[Int, Int], None]
    Disablei: Callable[[Int, Int], None]
    CullFace: Callable[[Int], None]
    FrontFace: Callable[[Int], None]
    DepthFunc: Callable[[Int], None]
    DepthMask: Callable[[Int], None]
    DepthRangef: Callable[[Real, Real], None]
    ColorMask: Callable[[Int, Int, Int, Int], None]
    ColorMaski: Callable[[Int, Int, Int, Int, Int], None]
    BlendColor: Callable[[Real, Real, Real, Real], None]
    BlendFuncSeparate: Callable[[Int, Int, Int, Int], None]
    BlendFuncSeparatei: Callable[[Int, Int, Int, Int, Int], None]
    BlendEquationSeparate: Callable[[Int, Int], None]
    BlendEquationSeparatei: Callable[[Int, Int, Int], None]
    StencilFuncSeparate: Callable[[Int, Int, Int, Int], None]
    StencilOpSeparate: Callable[[Int, Int, Int, Int], None]
    StencilMaskSeparate: Callable[[Int, Int], None]
    Scissor: Callable[[Int, Int, Int, Int], None]
    Viewport: Callable[[Int, Int, Int, Int], None]
    ViewportIndexedf: Callable[[Int, Real, Real, Real, Real], None]
    LineWidth: Callable[[Real], None]
    PolygonMode: Callable[[Int, Int], None]
    PolygonOffset: Callable[[Real, Real], None]
    PolygonOffsetClamp: Callable[[Real, Real, Real], None]  # 4.6 or EXT_polygon_offset_clamp
    PointParameteri: Callable[[Int, Int], None]
    ProvokingVertex: Callable[[Int], None]

    # buffers
    CreateBuffers: Callable[[Int, Pointer], None]
    DeleteBuffers: Callable[[Int, Pointer], None]
    BindBuffer: Callable[[Int, Int], None]
    BindBufferBase: Callable[[Int, Int, Int], None]
    BufferData: Callable[[Int, Size, Pointer, Int], None]
    NamedBufferStorage: Callable[[Int, Size, Pointer, Int], None]
    MapNamedBufferRange: Callable[[Int, Size, Size, Int], Address]
    GetNamedBufferSubData: Annotated[Callable[[Int, Size, Size, Pointer], None], _WAITS]
    CopyNamedBufferSubData: Callable[[Int, Int, Size, Size, Size], None]
    ClearNamedBufferSubData: Callable[[Int, Int, Size, Size, Int, Int, Pointer], None]
    MemoryBarrier: Callable[[Int], None]

    # textures and samplers
    CreateTextures: Callable[[Int, Int, Pointer], None]
    DeleteTextures: Callable[[Int, Pointer], None]
    TextureStorage2D: Callable[[Int, Int, Int, Int, Int], None]
    TextureStorage3D: Callable[[Int, Int, Int, Int, Int, Int], None]
    TextureStorage2DMultisample: Callable[[Int, Int, Int, Int, Int, Int], None]
    TextureParameteri: Callable[[Int, Int, Int], None]
    TextureSubImage2D: Callable[[Int, Int, Int, Int, Int, Int, Int, Int, Address], None]
    TextureSubImage3D: Callable[[Int, Int, Int, Int, Int, Int, Int, Int, Int, Int, Address], None]
    CompressedTextureSubImage2D: Callable[[Int, Int, Int, Int, Int, Int, Int, Int, Address], None]
    CompressedTextureSubImage3D: Callable[[Int, Int, Int, Int, Int, Int, Int, Int, Int, Int, Address], None]
    GetTextureSubImage: Annotated[
        Callable[[Int, Int, Int, Int, Int, Int, Int, Int, Int, Int, Int, Address], None], _WAITS
    ]
    ClearTexImage: Callable[[Int, Int, Int, Int, Pointer], None]
    CopyImageSubData: Callable[
        [Int, Int, Int, Int, Int, Int, Int, Int, Int, Int, Int, Int, Int, Int, Int], None
    ]
    IsTexture: Callable[[Int], Int]
    GetTextureParameteriv: Callable[[Int, Int, Pointer], None]
    GetTextureLevelParameteriv: Callable[[Int, Int, Int, Pointer], None]
    GenTextures: Callable[[Int, Pointer], None]
    TextureView: Callable[[Int, Int, Int, Int, Int, Int, Int, Int], None]
    BindTextureUnit: Callable[[Int, Int], None]
    BindImageTexture: Callable[[Int, Int, Int, Int, Int, Int, Int], None]
    CreateSamplers: Callable[[Int, Pointer], None]
    DeleteSamplers: Callable[[Int, Pointer], None]
    SamplerParameteri: Callable[[Int, Int, Int], None]
    SamplerParameterf: Callable[[Int, Int, Real], None]
    SamplerParameterfv: Callable[[Int, Int, Pointer], None]
    BindSampler: Callable[[Int, Int], None]

    # framebuffers
    CreateFramebuffers: Callable[[Int, Pointer], None]
    DeleteFramebuffers: Callable[[Int, Pointer], None]
    NamedFramebufferTexture: Callable[[Int, Int, Int, Int], None]
    NamedFramebufferTextureLayer: Callable[[Int, Int, Int, Int, Int], None]
    NamedFramebufferDrawBuffers: Callable[[Int, Int, Pointer], None]
    NamedFramebufferParameteri: Callable[[Int, Int, Int], None]
    CheckNamedFramebufferStatus: Callable[[Int, Int], Int]
    BindFramebuffer: Callable[[Int, Int], None]
    BlitNamedFramebuffer: Callable[[Int, Int, Int, Int, Int, Int, Int, Int, Int, Int, Int, Int], None]
    ClearBufferfv: Callable[[Int, Int, Pointer], None]
    ClearBufferiv: Callable[[Int, Int, Pointer], None]
    ClearBufferuiv: Callable[[Int, Int, Pointer], None]
    ClearBufferfi: Callable[[Int, Int, Real, Int], None]

    # in the host's context, which may be older
    GenFramebuffers: Callable[[Int, Pointer], None]
    FramebufferTexture2D: Callable[[Int, Int, Int, Int, Int], None]
    BlitFramebuffer: Callable[[Int, Int, Int, Int, Int, Int, Int, Int, Int, Int], None]
    IsEnabled: Callable[[Int], Int]
    WaitSync: Callable[[Address, Int, Wide], None]

    # programs, vertex arrays, draws
    UseProgram: Callable[[Int], None]
    GetUniformLocation: Callable[[Int, Text], Int]
    ProgramUniform1f: Callable[[Int, Int, Real], None]
    ProgramUniform1i: Callable[[Int, Int, Int], None]
    BindVertexArray: Callable[[Int], None]
    VertexArrayVertexBuffer: Callable[[Int, Int, Int, Size, Int], None]
    VertexArrayElementBuffer: Callable[[Int, Int], None]
    VertexArrayBindingDivisor: Callable[[Int, Int, Int], None]
    VertexArrayAttribBinding: Callable[[Int, Int, Int], None]
    VertexArrayAttribFormat: Callable[[Int, Int, Int, Int, Int, Int], None]
    VertexArrayAttribIFormat: Callable[[Int, Int, Int, Int, Int], None]
    EnableVertexArrayAttrib: Callable[[Int, Int], None]
    DrawArraysInstancedBaseInstance: Callable[[Int, Int, Int, Int, Int], None]
    DrawElementsInstancedBaseVertexBaseInstance: Callable[[Int, Int, Int, Pointer, Int, Int, Int], None]
    MultiDrawArraysIndirect: Callable[[Int, Size, Int, Int], None]
    MultiDrawElementsIndirect: Callable[[Int, Int, Size, Int, Int], None]
    MultiDrawArraysIndirectCountARB: Callable[[Int, Size, Size, Int, Int], None]  # ARB_indirect_parameters
    MultiDrawElementsIndirectCountARB: Callable[[Int, Int, Size, Size, Int, Int], None]

    # queries and fences
    CreateQueries: Callable[[Int, Int, Pointer], None]
    DeleteQueries: Callable[[Int, Pointer], None]
    BeginQuery: Callable[[Int, Int], None]
    EndQuery: Callable[[Int], None]
    QueryCounter: Callable[[Int, Int], None]
    GetQueryiv: Callable[[Int, Int, Pointer], None]
    GetQueryObjectui64v: Callable[[Int, Int, Pointer], None]
    BeginConditionalRender: Callable[[Int, Int], None]
    EndConditionalRender: Callable[[], None]
    FenceSync: Callable[[Int, Int], Address]
    ClientWaitSync: Annotated[Callable[[Address, Int, Wide], Int], _WAITS]
    DeleteSync: Callable[[Address], None]

    # debug output
    DebugMessageCallback: Callable[[Pointer, Pointer], None]
    PushDebugGroup: Callable[[Int, Int, Int, Text], None]
    PopDebugGroup: Callable[[], None]
    ObjectLabel: Callable[[Int, Int, Int, Text], None]

    def __init__(self, address_of: Callable[[str], int]) -> None:
        for name, prototype in _prototypes().items():
            setattr(self, name, prototype(address_of("gl" + name)))

    def create(self, creator: Callable[..., None], *target: int) -> int:
        """Create one object and return its name: `gl.create(gl.CreateTextures, TEXTURE_2D)`."""
        name = ctypes.c_uint()
        creator(*target, 1, ctypes.byref(name))
        return name.value

    def delete(self, deleter: Callable[[int, _CArgObject], None], name: int) -> None:
        deleter(1, ctypes.byref(ctypes.c_uint(name)))

    def get_integer(self, name: int, index: int | None = None) -> int:
        value = ctypes.c_int64()
        if index is None:
            self.GetInteger64v(name, ctypes.byref(value))
        else:
            self.GetIntegeri_v(name, index, ctypes.byref(value))
        return value.value

    def get_float(self, name: int) -> float:
        value = ctypes.c_float()
        self.GetFloatv(name, ctypes.byref(value))
        return value.value


@cache
def _prototypes() -> dict[str, Any]:
    """Return the ctypes function types of all entry points, by name. They are created once, from the
    annotations."""
    hints = typing.get_type_hints(EntryPoints, include_extras=True)
    return {name: _make_prototype(hint) for name, hint in hints.items()}


def _make_prototype(hint: Any) -> Any:
    waits = typing.get_origin(hint) is Annotated
    arguments, result = typing.get_args(typing.get_args(hint)[0] if waits else hint)
    factory = ctypes.CFUNCTYPE if waits else ctypes.PYFUNCTYPE
    if all(argument in (Int, Pointer) for argument in arguments):
        return factory(_ctype(result))
    return factory(_ctype(result), *map(_ctype, arguments))


def _ctype(hint: Any) -> Any:
    return None if hint in (None, type(None)) else typing.get_args(hint)[1]
