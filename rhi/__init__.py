"""A render hardware interface for Python.

Write a renderer once against `Device`; run it on OpenGL, or on the null device that records every command.

    with rhi.create_device() as device:
        program = device.program(Triangle)
        image = device.texture((640, 480), rhi.Format.RGBA8)
        with device.render_pass(image, clear=(0, 0, 0, 1)):
            device.draw(program, mesh, tint=tint)
        pixels = image.read()

Drivers are loaded when a device is made, not when this package is imported.
"""

from rhi.backend import Backend, Capabilities
from rhi.buffers import Buffer, StorageBuffer, UniformArray, UniformBuffer
from rhi.command_buffer import CommandBuffer
from rhi.commands import Command, CommandStream, Op, Refusal
from rhi.containers import FixedQueue, FixedStack
from rhi.core import Statistics
from rhi.descriptors import (
    Access,
    BufferUsage,
    Filter,
    Primitive,
    ProgramDescriptor,
    Region,
    SamplerDescriptor,
    Stage,
    TextureKind,
    VertexFormat,
    Wrap,
)
from rhi.device import Device
from rhi.encoder import Encoder, IndirectDraws
from rhi.errors import RULES, CallSite, DeviceError, RhiError, Rule, ShaderError, ValidationError, refuse
from rhi.formats import Format, IndexFormat
from rhi.immediate import Immediate, TransientMemory
from rhi.mesh import DRAW, DRAW_UNINDEXED, Mesh
from rhi.passes import RenderPass
from rhi.program import Program
from rhi.queries import OcclusionQuery, TimerNode
from rhi.query_sets import QuerySet
from rhi.recorder import Recorder
from rhi.registry import backend_names, create_device, report
from rhi.state_cache import StateChange, StateScope, StateVector
from rhi.states import (
    AlphaFunction,
    AlphaReference,
    AlphaTest,
    AlphaToCoverage,
    BlendColor,
    BlendFactor,
    BlendFunction,
    BlendOperation,
    ColorWrite,
    Comparison,
    CullMode,
    DepthBias,
    DepthFunction,
    DepthTest,
    DepthWrite,
    FrontFace,
    PolygonOffset,
    Scissor,
    State,
    StencilBack,
    StencilFront,
    StencilOperation,
    StencilReadMask,
    StencilReference,
    StencilTest,
    StencilWriteMask,
    Viewport,
)
from rhi.textures import Sampler, Texture, TextureTarget

__version__ = "0.1.0"

__all__ = [
    "DRAW",
    "DRAW_UNINDEXED",
    "RULES",
    "Access",
    "AlphaFunction",
    "AlphaReference",
    "AlphaTest",
    "AlphaToCoverage",
    "Backend",
    "BlendColor",
    "BlendFactor",
    "BlendFunction",
    "BlendOperation",
    "Buffer",
    "BufferUsage",
    "CallSite",
    "Capabilities",
    "ColorWrite",
    "Command",
    "CommandBuffer",
    "CommandStream",
    "Comparison",
    "CullMode",
    "DepthBias",
    "DepthFunction",
    "DepthTest",
    "DepthWrite",
    "Device",
    "DeviceError",
    "Encoder",
    "Filter",
    "FixedQueue",
    "FixedStack",
    "Format",
    "FrontFace",
    "Immediate",
    "IndexFormat",
    "IndirectDraws",
    "Mesh",
    "OcclusionQuery",
    "Op",
    "PolygonOffset",
    "Primitive",
    "Program",
    "ProgramDescriptor",
    "QuerySet",
    "Recorder",
    "Refusal",
    "Region",
    "RenderPass",
    "RhiError",
    "Rule",
    "Sampler",
    "SamplerDescriptor",
    "Scissor",
    "ShaderError",
    "Stage",
    "State",
    "StateChange",
    "StateScope",
    "StateVector",
    "Statistics",
    "StencilBack",
    "StencilFront",
    "StencilOperation",
    "StencilReadMask",
    "StencilReference",
    "StencilTest",
    "StencilWriteMask",
    "StorageBuffer",
    "Texture",
    "TextureKind",
    "TextureTarget",
    "TimerNode",
    "TransientMemory",
    "UniformArray",
    "UniformBuffer",
    "ValidationError",
    "VertexFormat",
    "Viewport",
    "Wrap",
    "backend_names",
    "create_device",
    "refuse",
    "report",
]
