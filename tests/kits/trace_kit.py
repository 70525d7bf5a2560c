"""A recording that has something of everything, and ways to spoil a file."""

from __future__ import annotations

import json
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from testing_kit import Corner, SampleFrame, Tint

import rhi
import rhi.shading as sl
from rhi.trace import save

VERSION_1 = Path(__file__).parents[1] / "rhi/trace/version-1.zip"
VERSION_2 = Path(__file__).parents[1] / "rhi/trace/version-2.zip"


class Doubled(sl.Shader):
    source: sl.Storage[int]
    target: sl.StorageRW[int]
    work_group = (4, 1, 1)

    def compute(self) -> None:
        i = sl.global_id().x
        self.target[i] = self.source[i] * 2


class Textured(sl.Shader):
    albedo: sl.Texture2D

    def vertex(self, v: Corner) -> sl.vec4:
        return sl.vec4(v.position, 0.5, 1.0)

    def fragment(self) -> sl.vec4:
        return self.albedo.sample(sl.vec2(0.5, 0.5))


class ImageStore(sl.Shader):
    """Work on an image and on memory."""

    storage_image: sl.Image2D = sl.image(rhi.Format.R32F)
    numbers: sl.StorageRW[float]
    work_group = (4,)

    def compute(self) -> None:
        i = sl.global_id().x
        self.numbers[i] = 2.0
        self.storage_image.store(sl.ivec2(i, 0), sl.vec4(1.0))


class InstancedVertex(sl.Struct):
    position: sl.vec2
    offset: sl.vec2


class Instanced(sl.Shader):
    """Vertices, each instance at an offset of its own."""

    def vertex(self, v: InstancedVertex) -> sl.vec4:
        return sl.vec4(v.position + v.offset, 0.5, 1.0)

    def fragment(self) -> sl.vec4:
        return sl.vec4(1.0, 1.0, 1.0, 1.0)


class Tinted(sl.Shader):
    """A color that is bound."""

    tint: sl.Uniform[Tint]

    def vertex(self, v: Corner) -> sl.vec4:
        return sl.vec4(v.position, 0.5, 1.0)

    def fragment(self) -> sl.vec4:
        return self.tint.color


def record_much(device: rhi.Device) -> rhi.Texture:
    """A frame of the house, and a second one of what it leaves out; the presented image."""
    sample_frame = SampleFrame(device)
    sample_frame.render()
    albedo = device.texture(np.full((4, 4, 4), (10, 200, 30, 255), np.uint8), rhi.Format.RGBA8, levels=None)
    faces = device.texture((4, 4), rhi.Format.RGBA16F, kind=rhi.TextureKind.CUBE, label="faces")
    faces.write(np.ones((6, 4, 4, 4), np.float16))
    numbers = device.storage(int, np.arange(8, dtype=np.int32))
    doubled = device.storage(int, 8)
    device.dispatch(device.program(Doubled), 2, source=numbers, target=doubled)
    device.buffer(np.arange(4)).copy_to(device.buffer(4, np.int64))
    query = device.occlusion_query()
    stencil = device.texture((64, 48), rhi.Format.D32FS8)
    sampler = device.sampler(rhi.SamplerDescriptor(minify=rhi.Filter.NEAREST, magnify=rhi.Filter.NEAREST))
    with (
        device.event("second"),
        device.render_pass(sample_frame.image, stencil, clear=(0, 0, 1, 1), clear_depth=0, clear_stencil=3),
    ):
        with device.states(
            rhi.CullMode.NONE,
            rhi.StencilTest.ON,
            rhi.StencilFront(),
            rhi.Scissor(0, 0, 32, 48),
            rhi.Viewport(0, 0, 64, 48),
            rhi.BlendFunction.ALPHA.at(0),
            rhi.ColorWrite.OFF.at(3),
        ):
            with query:
                device.draw(device.program(Textured), sample_frame.walls, albedo=albedo.sampled(sampler))
            draws = sample_frame.walls.draws(np.zeros(2, int), np.full(2, 3))
            device.draw_many(
                device.program(Textured), sample_frame.walls, draws, albedo=albedo.sampled(sampler)
            )
            queries = device.query_set(2)
            device.draw_counted(
                device.program(Textured), sample_frame.walls, draws, queries, albedo=albedo.sampled(sampler)
            )
        with device.immediate(
            sample_frame.lit, rhi.Primitive.TRIANGLES, light=sample_frame.light, tint=sample_frame.tint
        ) as corners:
            for corner in ((-1, -1), (1, -1), (0, 1)):
                corners.vertex(position=corner)
    device.present(sample_frame.image)
    return sample_frame.image


def record(path: Path) -> Path:
    with rhi.create_device("null") as device:
        record_much(device)
        save(device, path)
    return path


def record_draws(path: Path) -> Path:
    """Indexed, instanced and indirect draws of a mesh of 4 vertices, 6 indices and 5 instances; a
    dispatch."""
    with rhi.create_device("null") as device:
        vertices = {"position": np.zeros((4, 2), np.float32)}
        mesh = device.mesh(
            vertices,
            np.array([0, 1, 2, 0, 2, 3], np.uint16),
            instances={"offset": np.zeros((5, 2), np.float32)},
        )
        plain = device.mesh(vertices)
        target = device.texture((8, 8), rhi.Format.RGBA8)
        tint = device.uniform(Tint(color=(1, 1, 1, 1)))
        arguments = device.buffer(mesh.draws([0, 3], 3))
        count = device.buffer(np.array([2], np.uint32))
        groups = device.buffer(np.array([1, 1, 1], np.uint32))
        storage_image, numbers = device.texture((8, 8), rhi.Format.R32F).image(), device.storage(float, 8)
        device.dispatch(device.program(ImageStore), 2, storage_image=storage_image, numbers=numbers)
        device.dispatch_indirect(
            device.program(ImageStore), groups, storage_image=storage_image, numbers=numbers
        )
        with device.render_pass(target, clear=(0, 0, 0, 1)), device.states(rhi.CullMode.NONE):
            device.draw(device.program(Instanced), mesh, 5)
            device.draw(device.program(Tinted), plain, tint=tint)
            device.draw_indirect(
                device.program(Instanced), mesh, rhi.IndirectDraws(arguments, 2, count=count)
            )
        device.present(target)
        save(device, path)
    return path


def rewrite(path: Path, members: Callable[[dict[str, bytes]], None]) -> Path:
    """The same file with its members changed."""
    with zipfile.ZipFile(path) as file:
        contents = {name: file.read(name) for name in file.namelist()}
    members(contents)
    changed = path.with_name("changed.zip")
    with zipfile.ZipFile(changed, "w", zipfile.ZIP_DEFLATED) as file:
        for name, data in contents.items():
            member = zipfile.ZipInfo()
            member.filename = name  # as it is: Windows would change its backslashes
            file.writestr(member, data, zipfile.ZIP_DEFLATED)
    return changed


def edit_line(path: Path, op: str, change: Callable[[dict[str, Any]], object], *, kind: str = "op") -> Path:
    """The same file with the first command `op` changed, or with the first line that has a `kind`."""

    def edit(members: dict[str, bytes]) -> None:
        lines = [json.loads(line) for line in members["commands.jsonl"].splitlines()]
        change(next(line for line in lines if kind in line and (not op or line["op"] == op)))
        members["commands.jsonl"] = "".join(json.dumps(line) + "\n" for line in lines).encode()

    return rewrite(path, edit)
