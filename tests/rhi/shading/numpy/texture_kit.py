"""Reads one texture by one shader in every way: OpenGL, OpenCL with one lane and with 16, NumPy."""

from __future__ import annotations

import builtins
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray
from opencl_runner import run_opencl

import rhi.shading as sl
from rhi import Device, Format, SamplerDescriptor, TextureKind
from rhi.conformance.shaders import Corner
from rhi.conformance.shapes import rectangle
from rhi.contract.descriptors import BindingKind
from rhi.contract.states import DepthTest
from rhi.contract.texels import encode

LANES = ("1 lane", "16 lanes")
Results = dict[str, NDArray[Any]]


class Slice(sl.Struct):
    """The index of a layer in the array of depths."""

    layer: int


class Bare(sl.Struct):
    clip: sl.vec4


class Depth(sl.Struct):
    depth: sl.FragmentDepth


class WriteDepth(sl.Shader):
    """A shader that writes depths texel by texel."""

    depths: sl.Texture2DArray
    which: sl.Uniform[Slice]

    def vertex(self, v: Corner) -> Bare:
        return Bare(clip=v.position)

    def fragment(self) -> Depth:
        at = sl.fragment_coordinate()
        return Depth(depth=self.depths.load(sl.ivec3(int(at.x), int(at.y), self.which.layer)).x)


def random_levels(
    format: Format,
    width: int,
    height: int,
    layers: int = 1,
    kind: TextureKind = TextureKind.D2,
    seed: int = 0,
    levels: int | None = None,
) -> list[NDArray[Any]]:
    """Generate texels of all levels: fractions, or integers of the whole range."""
    rng = np.random.default_rng([seed, width, height, layers])
    solid = kind is TextureKind.D3
    full = builtins.max(width, height, layers if solid else 1).bit_length()
    result = []
    for level in range(levels or full):
        depth = builtins.max(1, layers >> level) if solid else layers
        shape = (depth, builtins.max(1, height >> level), builtins.max(1, width >> level), format.components)
        if format is Format.R11G11B10F:
            result.append(encode(format, rng.uniform(0, 1, (*shape[:3], 3))))
        elif format.dtype.kind == "f":
            result.append(rng.uniform(0, 1, shape).astype(format.dtype))
        else:
            limits = np.iinfo(format.dtype)
            result.append(
                rng.integers(builtins.max(limits.min, -limits.max), limits.max, shape, format.dtype, True)
            )
    return result


def read_everywhere(
    device: Device,
    shader: type[sl.Shader],
    textures: Mapping[str, sl.HostTexture],
    count: int,
    **bindings: Any,
) -> Results:
    """Run `count` work-groups and return the contents of `results` for "opengl", "1 lane", "16 lanes",
    "float32" and "float64"."""
    results = {"opengl": read_opengl(device, shader, textures, count, bindings)}
    for width in (1, 16):
        values = {**textures, **bindings}
        results[f"{width} lane{'s' * (width > 1)}"] = run_opencl(shader, width, count, **values)["results"]
    for dtype in (np.float32, np.float64):
        run = sl.run_compute(shader, count, dtype=dtype, **textures, **bindings)
        results[np.dtype(dtype).name] = run["results"]
    return results


def read_opengl(
    device: Device,
    shader: type[sl.Shader],
    textures: Mapping[str, sl.HostTexture],
    count: int,
    bindings: dict[str, Any],
) -> NDArray[Any]:
    """Run on a device, creating and destroying textures and buffers (of vec4)."""
    program = device.program(shader)
    arguments: dict[str, Any] = {}
    resources: list[Any] = []
    for binding in sl.compile_shader(shader).bindings:
        name = binding.name
        if binding.kind is BindingKind.TEXTURE:
            resources.append(upload(device, textures[name]))
            arguments[name] = resources[-1].sampled(textures[name].sampler)
        elif binding.kind is BindingKind.IMAGE:
            resources.append(upload(device, textures[name]))
            arguments[name] = resources[-1].image()
        else:
            resources.append(device.storage(sl.vec4, bindings[name]))
            arguments[name] = resources[-1]
    device.dispatch(program, count, **arguments)
    result: NDArray[Any] = arguments["results"].read()
    for resource in resources:
        resource.destroy()
    return result


def upload(device: Device, texture: sl.HostTexture) -> Any:
    """Create a device texture with the same texels; depths are drawn."""
    layers, height, width, _ = texture.levels[0].shape
    created = device.texture(
        (width, height), texture.format, kind=texture.kind, layers=layers, levels=len(texture.levels)
    )
    for level, texels in enumerate(texture.levels):
        if not texture.format.is_depth:
            created.write(texels, level=level)
            continue
        shape = (texels.shape[2], texels.shape[1])
        with (
            device.texture(shape, Format.R32F, kind=TextureKind.D2_ARRAY, layers=layers) as depths,
            device.mesh(rectangle()) as mesh,
        ):
            depths.write(texels)
            for layer in range(layers):
                which = device.uniform(Slice(layer=layer))
                with (
                    device.render_pass(depth=created.at(level, layer), clear_depth=0.0),
                    device.states(DepthTest.OFF),
                ):
                    device.draw(device.program(WriteDepth), mesh, depths=depths, which=which)
                which.destroy()
    return created


def assert_agree(results: Results, opengl: float, lanes: float = 2e-6, reason: str = "") -> None:
    """Check that all results are within a tolerance of float64, with NaN only where float64 has it."""
    expected = results["float64"].astype(np.float64)
    for way, texels in results.items():
        slack = opengl if way == "opengl" else lanes
        np.testing.assert_allclose(
            texels.astype(np.float64), expected, rtol=0, atol=slack, err_msg=f"{way} {reason}", equal_nan=True
        )


def nearest(wrap: Any = None, **more: Any) -> SamplerDescriptor:
    """Return a sampler without filters."""
    from rhi import Filter, Wrap

    wrap = wrap or Wrap.REPEAT
    return SamplerDescriptor(Filter.NEAREST, Filter.NEAREST, None, wrap, wrap, wrap, **more)
