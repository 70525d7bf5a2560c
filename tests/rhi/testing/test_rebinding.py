"""The reasons of binding commands, and inline bindings of textures, which bind no more than kept ones."""

from __future__ import annotations

import gc
import weakref
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pytest
from testing_kit import backend_works

import rhi
import rhi.shading as sl
from rhi import Device, Filter, Format, Op, SamplerDescriptor, TextureKind
from rhi.testing import BindReason, needless_bindings, why_bound
from rhi.testing.portability import check_portability

NEAREST = SamplerDescriptor(Filter.NEAREST, Filter.NEAREST)
BINDS = frozenset({Op.BIND_UNIFORM, Op.BIND_STORAGE, Op.BIND_TEXTURE, Op.BIND_IMAGE})


class Sampling(sl.FullScreen):
    source: sl.Texture2D

    def fragment(self) -> sl.vec4:
        return self.source.sample(sl.vec2(0.5))


class Tinting(sl.FullScreen):
    tint: sl.Uniform[sl.vec4]

    def fragment(self) -> sl.vec4:
        return self.tint


class Scene:
    def __init__(self, device: Device) -> None:
        self.device = device
        self.program, self.tinting = device.program(Sampling), device.program(Tinting)
        self.screen = device.mesh(3)
        self.image = device.texture((8, 8), Format.RGBA8)
        self.source = device.texture((4, 4), Format.RGBA8)
        self.other = device.texture((4, 4), Format.RGBA8)
        self.sampler = device.sampler(NEAREST)
        self.tint = device.uniform(sl.vec4(1.0))

    def count(self, inline: Callable[[], Any], passes: int = 1) -> int:
        start = len(self.device.stream)
        for _ in range(passes):
            with self.device.render_pass(self.image):
                for _ in range(3):
                    self.device.draw(self.program, self.screen, source=inline())
        return len(self.device.stream[start:].filter(Op.BIND_TEXTURE))


@pytest.fixture
def scene(null_device: Device) -> Scene:
    return Scene(null_device)


@pytest.fixture(params=["null", "gl", "cl", "wgpu"])
def any_scene(request: pytest.FixtureRequest) -> Iterator[Scene]:
    if not backend_works(request.param):
        pytest.skip(f"no device of {request.param} here")
    with rhi.create_device(request.param, record=True) as device:
        yield Scene(device)


@pytest.mark.parametrize("passes", [1, 3])
def test_an_inline_binding_binds_no_more_than_a_kept_one(any_scene: Scene, passes: int) -> None:
    source = any_scene.source
    bindings = [source.sampled(NEAREST)]
    expected = any_scene.count(lambda: bindings[0], passes)
    assert expected == passes  # a new pass binds again
    bindings.clear()
    assert any_scene.count(lambda: source.sampled(NEAREST), passes) == expected
    assert any_scene.count(lambda: source.sampled(any_scene.sampler), passes) == expected
    assert any_scene.count(lambda: source, passes) == expected


def test_other_samplers_and_textures_are_bound(scene: Scene) -> None:
    descriptors = iter([NEAREST, SamplerDescriptor(), NEAREST])
    assert scene.count(lambda: scene.source.sampled(next(descriptors))) == 3
    textures = iter([scene.source, scene.other, scene.source])
    assert scene.count(lambda: next(textures).sampled(NEAREST)) == 3


def test_equal_images_are_one_binding(null_device: Device) -> None:
    texture = null_device.texture((4, 4), Format.RGBA8, kind=TextureKind.D2_ARRAY, layers=3, levels=2)
    bindings = [texture.image(level, layer) for level in (0, 1) for layer in (None, 0, 2)]
    again = [texture.image(level, layer) for level in (0, 1) for layer in (None, 0, 2)]
    assert [a is b for a, b in zip(bindings, again, strict=True)] == [True] * 6
    assert len(set(map(id, bindings))) == 6


def test_a_texture_is_freed_with_the_last_reference_to_it_and_its_bindings(null_device: Device) -> None:
    """Without the garbage collector: the binding that a texture remembers is no circle."""
    gc.disable()
    try:
        texture = null_device.texture((4, 4), Format.RGBA8)
        binding = texture.sampled(NEAREST)
        image = texture.image()
        freed = weakref.ref(texture)
        del texture, image
        assert freed() is not None
        del binding
        assert freed() is None
    finally:
        gc.enable()


def test_a_binding_of_a_destroyed_texture_is_refused(scene: Scene) -> None:
    binding = scene.source.sampled(NEAREST)
    scene.source.destroy()
    with pytest.raises(rhi.ValidationError, match="resource-destroyed"):
        scene.source.sampled(NEAREST)
    with pytest.raises(rhi.ValidationError, match="resource-destroyed"):
        scene.count(lambda: binding)


def test_a_sampler_that_the_device_lacks_is_refused_each_time(null_device: Device) -> None:
    texture = null_device.texture((4, 4), Format.RGBA8)
    wide = SamplerDescriptor(max_anisotropy=null_device.capabilities.max_anisotropy * 2)
    for _ in range(2):
        with pytest.raises(rhi.ValidationError, match="device-capability"):
            texture.sampled(wide)


# -- reasons -----------------------------------------------------------------------------------------------


def reasons(device: Device, op: Op) -> list[BindReason]:
    return [why_bound(command).reason for command in device.stream.filter(op)]


def test_a_new_pass_binds_program_and_bindings_again(scene: Scene) -> None:
    scene.count(lambda: scene.source, passes=3)
    expected = [BindReason.FIRST, BindReason.NEW_PASS, BindReason.NEW_PASS]
    assert reasons(scene.device, Op.BIND_PROGRAM) == expected
    assert reasons(scene.device, Op.BIND_TEXTURE) == expected


def test_another_program_in_between_binds_again(scene: Scene) -> None:
    device = scene.device
    with device.render_pass(scene.image):
        for _ in range(2):
            device.draw(scene.program, scene.screen, source=scene.source)
            device.draw(scene.tinting, scene.screen, tint=scene.tint)
    assert reasons(device, Op.BIND_PROGRAM) == [BindReason.FIRST] + [BindReason.NEW_PROGRAM] * 3
    assert reasons(device, Op.BIND_TEXTURE) == [BindReason.FIRST, BindReason.NEW_PROGRAM]
    assert not needless_bindings(device)


def test_other_resources_are_a_change(scene: Scene) -> None:
    textures = iter([scene.source, scene.other, scene.other])
    scene.count(lambda: next(textures))
    assert reasons(scene.device, Op.BIND_TEXTURE) == [BindReason.FIRST, BindReason.CHANGED]


def test_a_destroyed_resource_binds_everything_again(scene: Scene) -> None:
    device = scene.device
    with device.render_pass(scene.image):
        device.draw(scene.program, scene.screen, source=scene.source)
        scene.other.destroy()
        device.draw(scene.program, scene.screen, source=scene.source)
    assert reasons(device, Op.BIND_PROGRAM) == [BindReason.FIRST, BindReason.LOST]
    assert reasons(device, Op.BIND_TEXTURE) == [BindReason.FIRST, BindReason.LOST]


def bind_needlessly(device: Device, keeps: bool = False) -> None:
    """Draw with a new range for the same bytes each time."""
    scene = Scene(device)
    buffer = device.buffer(np.zeros(64, np.float32))
    ranges = [sl.UniformRange(buffer.id, 0, 16, sl.vec4, buffer) for _ in range(3)]
    with device.render_pass(scene.image):
        for bound in ranges:
            device.draw(scene.tinting, scene.screen, tint=ranges[0] if keeps else bound)


@pytest.mark.parametrize("keeps", [False, True])
def test_the_same_range_through_another_object_is_needless(null_device: Device, keeps: bool) -> None:
    bind_needlessly(null_device, keeps)
    needless = needless_bindings(null_device)
    assert len(needless) == (0 if keeps else 2)
    assert all(warning.name == "tint" and "keep the range" in str(warning) for warning in needless)
    portability = check_portability(lambda device: bind_needlessly(device, keeps))
    assert len(portability.warnings) == len(needless)
    assert ("bound needlessly: 2" in str(portability)) != keeps
    assert len(portability.runs_on) > 0


@pytest.mark.parametrize("command", [None, 3, "draw"])
def test_only_commands_that_bind_have_a_reason(null_device: Device, command: object) -> None:
    null_device.signal()
    with pytest.raises(rhi.ValidationError, match="assertion-argument"):
        why_bound(null_device.stream[0] if command is None else command)  # type: ignore[arg-type]
