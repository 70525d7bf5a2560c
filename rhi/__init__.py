"""A render hardware interface for Python.

Write a renderer once against `Device`, and run it on OpenGL, on OpenCL, or on the null device, which records
every command.

    with rhi.create_device() as device:
        program = device.program(Triangle)
        image = device.texture((640, 480), rhi.Format.RGBA8)
        with device.render_pass(image, clear=(0, 0, 0, 1)):
            device.draw(program, mesh, tint=tint)
        pixels = image.read()

Drivers are loaded when a device is created, not when this package is imported.
"""

from importlib import import_module as _import_module
from typing import TYPE_CHECKING as _TYPE_CHECKING
from typing import Any as _Any

from rhi.commands.recorder import Recorder as Recorder
from rhi.commands.stream import Command as Command
from rhi.commands.stream import Commands as Commands
from rhi.commands.stream import CommandStream as CommandStream
from rhi.commands.stream import Op as Op
from rhi.commands.stream import Refusal as Refusal
from rhi.contract.backend import Backend as Backend
from rhi.contract.backend import Capabilities as Capabilities
from rhi.contract.blocks import CompressedFormat as CompressedFormat
from rhi.contract.blocks import decode_blocks as decode_blocks
from rhi.contract.clip_space import convert_projection as convert_projection
from rhi.contract.descriptors import DRAW as DRAW
from rhi.contract.descriptors import DRAW_UNINDEXED as DRAW_UNINDEXED
from rhi.contract.descriptors import Access as Access
from rhi.contract.descriptors import BufferUsage as BufferUsage
from rhi.contract.descriptors import Filter as Filter
from rhi.contract.descriptors import Primitive as Primitive
from rhi.contract.descriptors import ProgramDescriptor as ProgramDescriptor
from rhi.contract.descriptors import Region as Region
from rhi.contract.descriptors import SamplerDescriptor as SamplerDescriptor
from rhi.contract.descriptors import Stage as Stage
from rhi.contract.descriptors import StageText as StageText
from rhi.contract.descriptors import TextureKind as TextureKind
from rhi.contract.descriptors import VertexFormat as VertexFormat
from rhi.contract.descriptors import Wrap as Wrap
from rhi.contract.formats import Format as Format
from rhi.contract.formats import IndexFormat as IndexFormat
from rhi.contract.persistence import PersistentDict as PersistentDict
from rhi.contract.states import AlphaFunction as AlphaFunction
from rhi.contract.states import AlphaReference as AlphaReference
from rhi.contract.states import AlphaTest as AlphaTest
from rhi.contract.states import AlphaToCoverage as AlphaToCoverage
from rhi.contract.states import BlendColor as BlendColor
from rhi.contract.states import BlendFactor as BlendFactor
from rhi.contract.states import BlendFunction as BlendFunction
from rhi.contract.states import BlendOperation as BlendOperation
from rhi.contract.states import ColorWrite as ColorWrite
from rhi.contract.states import Comparison as Comparison
from rhi.contract.states import CullMode as CullMode
from rhi.contract.states import DepthBias as DepthBias
from rhi.contract.states import DepthFunction as DepthFunction
from rhi.contract.states import DepthTest as DepthTest
from rhi.contract.states import DepthWrite as DepthWrite
from rhi.contract.states import FrontFace as FrontFace
from rhi.contract.states import LineWidth as LineWidth
from rhi.contract.states import PlatformState as PlatformState
from rhi.contract.states import PolygonMode as PolygonMode
from rhi.contract.states import PolygonOffset as PolygonOffset
from rhi.contract.states import Scissor as Scissor
from rhi.contract.states import State as State
from rhi.contract.states import StateChange as StateChange
from rhi.contract.states import StencilBack as StencilBack
from rhi.contract.states import StencilFront as StencilFront
from rhi.contract.states import StencilOperation as StencilOperation
from rhi.contract.states import StencilReadMask as StencilReadMask
from rhi.contract.states import StencilReference as StencilReference
from rhi.contract.states import StencilTest as StencilTest
from rhi.contract.states import StencilWriteMask as StencilWriteMask
from rhi.contract.states import Viewport as Viewport
from rhi.contract.texels import from_srgb as from_srgb
from rhi.contract.texels import to_srgb as to_srgb
from rhi.device.command_buffer import CommandBuffer as CommandBuffer
from rhi.device.core.containers import FixedQueue as FixedQueue
from rhi.device.core.containers import FixedStack as FixedStack
from rhi.device.core.core import Statistics as Statistics
from rhi.device.core.memory_ledger import MemoryUse as MemoryUse
from rhi.device.core.state_cache import StateScope as StateScope
from rhi.device.core.state_cache import StateVector as StateVector
from rhi.device.device import Device as Device
from rhi.device.encoder import Encoder as Encoder
from rhi.device.encoder import IndirectDraws as IndirectDraws
from rhi.device.immediate import Immediate as Immediate
from rhi.device.passes import RenderPass as RenderPass
from rhi.device.preparation import DrawPlan as DrawPlan
from rhi.device.preparation import Preparation as Preparation
from rhi.device.queries.occlusion import OcclusionQuery as OcclusionQuery
from rhi.device.queries.sets import QuerySet as QuerySet
from rhi.device.queries.timers import TimerNode as TimerNode
from rhi.device.registry import backend_names as backend_names
from rhi.device.registry import create_device as create_device
from rhi.device.registry import report as report
from rhi.device.resources.buffers import Buffer as Buffer
from rhi.device.resources.buffers import StorageBuffer as StorageBuffer
from rhi.device.resources.buffers import UniformArray as UniformArray
from rhi.device.resources.buffers import UniformBuffer as UniformBuffer
from rhi.device.resources.image_decoding import decode_colors as decode_colors
from rhi.device.resources.image_decoding import open_image as open_image
from rhi.device.resources.images import load_image as load_image
from rhi.device.resources.meshes import Drawable as Drawable
from rhi.device.resources.meshes import Mesh as Mesh
from rhi.device.resources.programs import Program as Program
from rhi.device.resources.readbacks import Readback as Readback
from rhi.device.resources.texture_tables import TextureTable as TextureTable
from rhi.device.resources.textures import Sampler as Sampler
from rhi.device.resources.textures import Texture as Texture
from rhi.device.resources.textures import TextureTarget as TextureTarget
from rhi.device.transient import TransientMemory as TransientMemory
from rhi.device.transient import TransientMesh as TransientMesh
from rhi.errors import RULES as RULES
from rhi.errors import DeviceError as DeviceError
from rhi.errors import RhiError as RhiError
from rhi.errors import Rule as Rule
from rhi.errors import ShaderError as ShaderError
from rhi.errors import ShaderWarning as ShaderWarning
from rhi.errors import ValidationError as ValidationError
from rhi.errors import refuse as refuse
from rhi.errors.call_sites import CallSite as CallSite
from rhi.errors.exports import list_public as _list_public
from rhi.errors.namesakes import warn_of_namesake as _warn_of_namesake
from rhi.shading.language.builtins import Precision as Precision

if _TYPE_CHECKING:
    from rhi import math as math
    from rhi.device.fallback import install_fallback as install_fallback
    from rhi.device.reloading import Reloader as Reloader

__version__ = "0.1.0"

_LATER = {"Reloader": "rhi.device.reloading", "install_fallback": "rhi.device.fallback"}
"""Names whose modules are imported on first use: they need the shaders' compiler, which is slow to import."""

__all__ = sorted([*_list_public(globals()), *_LATER])


def __getattr__(name: str) -> _Any:
    if name in _LATER:
        return getattr(_import_module(_LATER[name]), name)
    if name != "math":  # which is imported when it is asked for
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return _import_module("rhi.math")


_warn_of_namesake("renderer", "rhi-renderer")
