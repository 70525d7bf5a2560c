"""Texture tables: refusals, lifetime, memory, recordings and traces, beyond the conformance kit."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import rhi
import rhi.shading as sl
from rhi import Device, Filter, Format, SamplerDescriptor, TextureKind, ValidationError
from rhi.contract.descriptors import Stage
from rhi.errors import ShaderError
from rhi.trace import load, replay, save

IMAGE = np.zeros((3, 5, 4), np.uint8)


class Numbered(sl.FullScreen):
    """Draws the image that a number names."""

    number: sl.Uniform[int]
    images: sl.TextureTable
    tint: sl.Uniform[sl.vec4]

    def fragment(self) -> sl.vec4:
        return self.images[self.number].sample_lod(sl.vec2(0.5), 0.0) * self.tint


class Layered(sl.FullScreen):
    """Reads a plain array."""

    layers: sl.Texture2DArray

    def fragment(self) -> sl.vec4:
        return self.layers.sample_lod(sl.vec3(0.5), 0.0)


class Lean(sl.Shader):
    """Reads a table behind a switch."""

    lean = True
    reads = False
    counts = False
    images: sl.TextureTable
    results: sl.StorageRW[float]

    def compute(self) -> None:
        value = 0.0
        if self.reads:
            value = self.images[0].load(sl.ivec2(0, 0)).x
        if self.counts:
            value += float(len(self.images))
        self.results[0] = value


class LeanReads(Lean):
    reads = True


class LeanCounts(Lean):
    counts = True


@pytest.fixture
def device() -> Iterator[Device]:
    with rhi.create_device("null", validation=True) as device:
        yield device


REFUSALS: dict[str, tuple[str, Callable[[Device], object]]] = {
    "no images": ("device-argument", lambda device: device.texture_table([])),
    "a single image": ("device-argument", lambda device: device.texture_table(IMAGE)),  # type: ignore[arg-type]
    "a number": ("device-argument", lambda device: device.texture_table([3])),  # type: ignore[list-item]
    "integers": ("texture-format", lambda device: device.texture_table([IMAGE.astype(np.uint32)])),
    "integers by name": ("texture-format", lambda device: device.texture_table([IMAGE], Format.R8UI)),
    "depth": (
        "texture-format",
        lambda device: device.texture_table([device.texture((4, 4), Format.D32F)]),
    ),
    "another format": (
        "texture-format",
        lambda device: device.texture_table([IMAGE, device.texture((4, 4), Format.R8)]),
    ),
    "an array": (
        "texture-format",
        lambda device: device.texture_table(
            [device.texture((4, 4), Format.R8, kind=TextureKind.D2_ARRAY, layers=2)]
        ),
    ),
    "samples": (
        "texture-samples",
        lambda device: device.texture_table([device.texture((4, 4), Format.RGBA8, samples=4)]),
    ),
    "too many samplers": (
        "device-argument",
        lambda device: device.texture_table([IMAGE], samplers=[SamplerDescriptor()] * 2),
    ),
    "a sampler that compares": (
        "device-argument",
        lambda device: device.texture_table([IMAGE], samplers=SamplerDescriptor(compare=rhi.Comparison.LESS)),
    ),
    "no sampler": (
        "device-argument",
        lambda device: device.texture_table([IMAGE], samplers=Filter.LINEAR),  # type: ignore[arg-type]
    ),
    "another dtype": (
        "texture-data",
        lambda device: device.texture_table([IMAGE, IMAGE.astype(np.uint16)]),
    ),
    "too large": (
        "texture-size",
        lambda device: device.texture_table(
            [device.texture((device.capabilities.max_texture_size, 1), Format.R8)]
        ),
    ),
    "an image beyond the table": (
        "texture-levels",
        lambda device: device.texture_table([IMAGE]).copy_from(device.texture(IMAGE, levels=None), 1),
    ),
    "another size": (
        "texture-size",
        lambda device: device.texture_table([IMAGE]).copy_from(
            device.texture((4, 3), Format.RGBA8, levels=3), 0
        ),
    ),
    "fewer levels": (
        "texture-size",
        lambda device: device.texture_table([IMAGE]).copy_from(device.texture(IMAGE), 0),
    ),
}


@pytest.mark.parametrize("name", REFUSALS)
def test_a_table_refuses_images_that_it_cant_hold(device: Device, name: str) -> None:
    rule, call = REFUSALS[name]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ResourceWarning)
        with pytest.raises(ValidationError) as error:
            call(device)
    assert error.value.rule.id == rule, str(error.value)
    assert "buffers" not in device.memory().kinds or "copy_from" in str(error.value)
    table = device.texture_table([IMAGE])  # what is right is still accepted
    table.copy_from(device.texture(IMAGE, levels=None), 0)
    table.destroy()


def test_a_format_that_the_device_cant_filter_is_refused() -> None:
    unfilterable = rhi.create_device("null", profile="webgpu")
    with unfilterable as device:
        assert Format.RGBA32F in device.capabilities.unfilterable_formats
        with pytest.raises(ValidationError, match="unfilterable_formats"):
            device.texture_table([np.zeros((2, 2, 4), np.float32)])
        device.texture_table([np.zeros((2, 2, 4), np.float16)]).destroy()


def draw(device: Device, program: Any, target: Any, **bindings: Any) -> None:
    with device.mesh(3) as mesh, device.render_pass(target):
        device.draw(program, mesh, **bindings)


def test_a_draw_passes_a_table_as_one_value(device: Device) -> None:
    program = device.program(Numbered)
    tint = np.ones(4, np.float32)
    with device.texture((4, 4), Format.RGBA8) as target, device.texture_table([IMAGE]) as table:
        draw(device, program, target, number=0, images=table, tint=tint)
        array = device.texture((4, 4), Format.RGBA8, kind=TextureKind.D2_ARRAY, layers=2)
        for images in (array, array.sampled(SamplerDescriptor()), IMAGE, table.words, 3):
            with pytest.raises(ValidationError) as error:
                draw(device, program, target, number=0, images=images, tint=tint)
            assert error.value.rule.id == "binding-type"
            assert "images=" in str(error.value)
            assert "texture_table" in str(error.value) or "TextureTable" in str(error.value)
        for images in (None, ...):
            bindings = {"number": 0, "tint": tint} | ({} if images is ... else {"images": images})
            with pytest.raises(ValidationError) as error:
                draw(device, program, target, **bindings)
            assert error.value.rule.id == "binding-missing"
            assert "words" not in str(error.value)
        with pytest.raises(ValidationError) as error:
            draw(device, program, target, number=0, images=table, tint=tint, images_words=table.words)
        assert error.value.rule.id == "binding-unknown"
        draw(device, program, target, number=0, images=table, tint=tint)
        array.destroy()


def test_a_destroyed_table_is_refused(device: Device) -> None:
    program = device.program(Numbered)
    with device.texture((4, 4), Format.RGBA8) as target:
        table = device.texture_table([IMAGE], label="stones")
        bindings = {"number": 0, "images": table, "tint": np.ones(4, np.float32)}
        draw(device, program, target, **bindings)
        table.destroy()
        table.destroy()
        with pytest.raises(ValidationError, match="stones"):
            draw(device, program, target, **bindings)


def test_a_table_says_its_images_and_its_memory(device: Device) -> None:
    images = [np.zeros((height, width, 4), np.uint8) for width, height in ((300, 200), (64, 64), (33, 100))]
    before = device.memory().total
    table = device.texture_table(images, label="stones")
    device.finish()
    assert len(table) == 3
    assert table.sizes == ((300, 200), (64, 64), (33, 100))
    assert table.levels == (9, 7, 7)
    assert table.format is Format.RGBA8
    assert table.bytes <= 1.3 * table.image_bytes
    assert device.memory().total - before == table.bytes
    assert repr(table) == "TextureTable('stones', 3 images, RGBA8)"
    table.destroy()


def test_a_sampled_texture_brings_its_sampler(device: Device) -> None:
    nearest = SamplerDescriptor(Filter.NEAREST, Filter.NEAREST, None)
    mirrored = device.sampler(SamplerDescriptor(wrap_u=rhi.Wrap.MIRROR))
    with device.texture((4, 4), Format.RGBA8) as texture:
        table = device.texture_table([texture.sampled(nearest), texture, IMAGE], samplers=mirrored)
        assert table.samplers == (nearest, mirrored.descriptor, mirrored.descriptor)
        table.destroy()


def test_lean_programs_bind_a_table_where_they_read_it(device: Device) -> None:
    assert [binding.name for binding in sl.compile_shader(Lean).bindings] == ["results"]
    for shader in (LeanReads, LeanCounts):
        bindings = sl.compile_shader(shader).bindings
        assert [binding.name for binding in bindings] == ["images", "images_words", "results"]
    table = sl.HostTextureTable([sl.HostTexture(IMAGE + 51, Format.RGBA8)] * 3)
    assert sl.run_compute(LeanReads, 1, images=table, results=1)["results"][0] == pytest.approx(0.2)
    assert sl.run_compute(LeanCounts, 1, images=table, results=1)["results"][0] == 3.0


SHADER_ERRORS = {
    "self.images.sample(sl.vec2(0.0))": "its images",
    "self.images[0]": "its images",
    "self.images[0].gather(sl.vec2(0.0))": "sample_lod",
    "self.images[0].sampel(sl.vec2(0.0))": "did you mean 'sample'",
    "self.images[0.5].sample(sl.vec2(0.0))": "int or uint",
    "self.images[-1].sample(sl.vec2(0.0))": "0 or more",
    "self.images[0:1].sample(sl.vec2(0.0))": "one index",
    "self.images[0].sample(sl.vec3(0.0))": "vec2",
    "self.images[0].sample()": "at",
    "self.images[0].sample(sl.vec2(0.0), 1.0)": "at",
    "self.images[0].sample_bias(sl.vec2(0.0), 1.0)": "fragment",
    "read(self.images)": "its images",
}


@pytest.mark.parametrize("expression", SHADER_ERRORS)
def test_a_wrong_use_of_a_table_is_refused_at_its_line(expression: str) -> None:
    text = f"""
import rhi.shading as sl

@sl.function
def read(images: sl.Texture2D) -> sl.vec4:
    return images.sample_lod(sl.vec2(0.0), 0.0)

class Wrong(sl.Shader):
    images: sl.TextureTable
    results: sl.StorageRW[sl.vec4]

    def compute(self) -> None:
        self.results[0] = {expression}
"""
    with pytest.raises(ShaderError) as error:
        sl.compile_shader(sl.from_source(text))
    assert SHADER_ERRORS[expression] in str(error.value)
    assert error.value.site is not None
    assert error.value.site.line == 13
    right = sl.from_source(text.replace(expression, "self.images[0].sample(sl.vec2(0.0))"))
    assert Stage.COMPUTE in sl.compile_shader(right).stages


@pytest.mark.parametrize(
    ("field", "part"),
    [
        ("images_words: sl.Storage[float]", "the words of images"),
        ("def f(self, t: sl.TextureTable) -> float: return 0.0", "make the function a method"),
    ],
)
def test_a_table_keeps_its_names_and_is_no_parameter(field: str, part: str) -> None:
    text = f"""
import rhi.shading as sl

class Wrong(sl.Shader):
    images: sl.TextureTable
    results: sl.StorageRW[sl.vec4]
    {field}

    def compute(self) -> None:
        self.results[0] = self.images[0].sample(sl.vec2(0.0))
        CALL
"""
    with pytest.raises(ShaderError, match=part):
        sl.compile_shader(sl.from_source(text.replace("CALL", "self.f(1)" if "def" in field else "")))


@pytest.mark.parametrize("backend", ["gl", "cl", "wgpu"])
def test_recorded_and_replayed_draws_read_a_table(backend: str, tmp_path: Path) -> None:
    path = tmp_path / "table.zip"
    colors = [np.full((n, 9 - n, 4), 60 * n, np.uint8) for n in (1, 2, 3, 4)]
    with rhi.create_device(backend, record=True) as device:
        target = device.texture((8, 8), Format.RGBA8, label="target")
        table, mesh = device.texture_table(colors), device.mesh(3)
        with device.record() as commands, commands.render_pass(target):
            program = device.program(Numbered)
            commands.draw(program, mesh, number=2, images=table, tint=np.ones(4, np.float32))
        device.submit(commands)
        expected = target.read()
        device.present(target)
        save(device, path)
    assert (expected == 180).all()
    with rhi.create_device(backend) as device:
        image = replay(load(path, trusted=True), on=device).image
        assert image is not None
        assert (image == expected).all()
