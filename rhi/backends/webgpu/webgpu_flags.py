"""The flags of WebGPU's specification, whose numbers every implementation shares."""

from __future__ import annotations

from enum import IntFlag


class GpuBufferUsage(IntFlag):
    """The uses of a buffer (`GPUBufferUsage`)."""

    MAP_READ = 0x1
    MAP_WRITE = 0x2
    COPY_SRC = 0x4
    COPY_DST = 0x8
    INDEX = 0x10
    VERTEX = 0x20
    UNIFORM = 0x40
    STORAGE = 0x80
    INDIRECT = 0x100
    QUERY_RESOLVE = 0x200


class GpuTextureUsage(IntFlag):
    """The uses of a texture (`GPUTextureUsage`)."""

    COPY_SRC = 0x1
    COPY_DST = 0x2
    TEXTURE_BINDING = 0x4
    STORAGE_BINDING = 0x8
    RENDER_ATTACHMENT = 0x10


class GpuShaderStage(IntFlag):
    """The stages that see a binding (`GPUShaderStage`)."""

    VERTEX = 0x1
    FRAGMENT = 0x2
    COMPUTE = 0x4
