"""A render hardware interface for Python.

Write a renderer once against `Device`, and run it on OpenGL, on OpenCL, or on the null device, which records every
command.

    with rhi.create_device() as device:
        program = device.program(Triangle)
        image = device.texture((640, 480), rhi.Format.RGBA8)
        with device.render_pass(image, clear=(0, 0, 0, 1)):
            device.draw(program, mesh, tint=tint)
        pixels = image.read()

Drivers are loaded when a device is created, not when this package is imported.
"""

from rhi.commands.recorder import Recorder
from rhi.commands.stream import Command, Commands, CommandStream, Op, Refusal
from rhi.contract.backend import Backend, Capabilities
from rhi.contract.blocks import CompressedFormat
from rhi.contract.clip_space import convert_projection
from rhi.contract.descriptors import (
    DRAW,
    DRAW_UNINDEXED,
    Access,
    BufferUsage,
    Filter,
    Primitive,
    ProgramDescriptor,
    Region,
    SamplerDescriptor,
    Stage,
    StageText,
    TextureKind,
    VertexFormat,
    Wrap,
)
from rhi.contract.formats import Format, IndexFormat
from rhi.contract.states import (
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
    LineWidth,
    PlatformState,
    PolygonMode,
    PolygonOffset,
    Scissor,
    State,
    StateChange,
    StencilBack,
    StencilFront,
    StencilOperation,
    StencilReadMask,
    StencilReference,
    StencilTest,
    StencilWriteMask,
    Viewport,
)
from rhi.contract.texels import from_srgb, to_srgb
from rhi.device.command_buffer import CommandBuffer
from rhi.device.core.containers import FixedQueue, FixedStack
from rhi.device.core.core import Statistics
from rhi.device.core.state_cache import StateScope, StateVector
from rhi.device.device import Device
from rhi.device.encoder import Encoder, IndirectDraws
from rhi.device.immediate import Immediate
from rhi.device.passes import RenderPass
from rhi.device.preparation import DrawPlan, Preparation
from rhi.device.queries.occlusion import OcclusionQuery
from rhi.device.queries.sets import QuerySet
from rhi.device.queries.timers import TimerNode
from rhi.device.registry import backend_names, create_device, report
from rhi.device.reloading import Reloader
from rhi.device.resources.buffers import Buffer, StorageBuffer, UniformArray, UniformBuffer
from rhi.device.resources.meshes import Drawable, Mesh
from rhi.device.resources.programs import Program
from rhi.device.resources.readbacks import Readback
from rhi.device.resources.textures import Sampler, Texture, TextureTarget
from rhi.device.transient import TransientMemory, TransientMesh
from rhi.errors import RULES, CallSite, DeviceError, RhiError, Rule, ShaderError, ValidationError, refuse

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
    "Commands",
    "Comparison",
    "CompressedFormat",
    "CullMode",
    "DepthBias",
    "DepthFunction",
    "DepthTest",
    "DepthWrite",
    "Device",
    "DeviceError",
    "DrawPlan",
    "Drawable",
    "Encoder",
    "Filter",
    "FixedQueue",
    "FixedStack",
    "Format",
    "FrontFace",
    "Immediate",
    "IndexFormat",
    "IndirectDraws",
    "LineWidth",
    "Mesh",
    "OcclusionQuery",
    "Op",
    "PlatformState",
    "PolygonMode",
    "PolygonOffset",
    "Preparation",
    "Primitive",
    "Program",
    "ProgramDescriptor",
    "QuerySet",
    "Readback",
    "Recorder",
    "Refusal",
    "Region",
    "Reloader",
    "RenderPass",
    "RhiError",
    "Rule",
    "Sampler",
    "SamplerDescriptor",
    "Scissor",
    "ShaderError",
    "Stage",
    "StageText",
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
    "TransientMesh",
    "UniformArray",
    "UniformBuffer",
    "ValidationError",
    "VertexFormat",
    "Viewport",
    "Wrap",
    "backend_names",
    "convert_projection",
    "create_device",
    "from_srgb",
    "refuse",
    "report",
    "to_srgb",
]
