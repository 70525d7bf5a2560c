"""Rules of what is bound to a program."""

from __future__ import annotations

import re
from typing import Any

import pytest
from null_kit import Camera, hand_made_program
from refused_shaders import Everything, Shift

import rhi.shading as sl
from rhi import Access, Comparison, Device, Format, SamplerDescriptor, Texture, TextureKind
from rhi.conformance.operation.test_samples import ReadSample, Sample
from rhi.conformance.shaders import Tint
from rhi.conformance.shapes import rectangle
from rhi.conformance.validation.refusal import refuses
from rhi.contract.descriptors import Binding, BindingKind
from rhi.errors import rules

SIZE = (4, 4)


class Kit:
    """A device with all that `Everything` binds."""

    def __init__(self, device: Device) -> None:
        self.device = device
        self.program = device.program(Everything)
        self.mesh = device.mesh(rectangle())
        self.image = device.texture(SIZE, Format.RGBA8)
        self.depth = device.texture(SIZE, Format.D32F)
        self.bindings: dict[str, Any] = {
            "tint": device.uniform(Tint(color=(1, 1, 1, 1))),
            "weights": device.storage(float, 4),
            "albedo": device.texture(SIZE, Format.RGBA8),
            "shadow": self.depth.sampled(SamplerDescriptor(compare=Comparison.LESS)),
            "target": device.texture(SIZE, Format.RGBA8).image(),
        }

    def draw(self, **changes: Any) -> None:
        """Draw in a pass with some bindings changed; None leaves one out."""
        bindings = {name: value for name, value in (self.bindings | changes).items() if value is not None}
        self.device.draw(self.program, self.mesh, **bindings)


@pytest.fixture
def kit(recording: Device) -> Any:
    kit = Kit(recording)
    yield kit
    for thing in (
        kit.mesh,
        kit.image,
        kit.depth,
        *(kit.bindings[name] for name in ("tint", "weights", "albedo")),
    ):
        thing.destroy()


@pytest.mark.parametrize("name", ["tint", "weights", "albedo", "shadow", "target"])
def test_a_missing_binding_is_refused(kit: Kit, name: str) -> None:
    with kit.device.render_pass(kit.image):
        with refuses(rules.BINDING_MISSING, kit.device) as refusal:
            kit.draw(**{name: None})
        assert name in str(refusal.error)
        kit.draw()
        with refuses(rules.BINDING_MISSING, kit.device):  # also when everything is bound already
            kit.draw(**{name: None})


def test_an_unknown_binding_is_refused(kit: Kit) -> None:
    with kit.device.render_pass(kit.image):
        with refuses(rules.BINDING_UNKNOWN, kit.device) as refusal:
            kit.draw(tints=kit.bindings["tint"])
        assert "tints" in str(refusal.error)
        kit.draw()


@pytest.mark.parametrize("name", ["tint", "weights", "albedo", "shadow", "target"])
def test_a_binding_must_be_of_its_kind(kit: Kit, name: str) -> None:
    with kit.device.render_pass(kit.image):
        for other in ("tint", "weights", "albedo", "target"):
            if other != name:
                with refuses(rules.BINDING_TYPE, kit.device) as refusal:
                    kit.draw(**{name: kit.bindings[other]})
                assert name in str(refusal.error)
        for wrong in (3, "text", (1, 2, 3), kit.mesh):
            with refuses(rules.BINDING_TYPE, kit.device):
                kit.draw(**{name: wrong})
        kit.draw()


def test_a_uniform_must_be_of_the_shader_s_struct(kit: Kit) -> None:
    with kit.device.uniform(Shift(by=(0, 0, 0, 0))) as shift, kit.device.render_pass(kit.image):
        with refuses(rules.BINDING_TYPE, kit.device) as refusal:
            kit.draw(tint=shift)
        assert re.search(r"Shift[\s\S]*Tint", str(refusal.error))
        kit.draw()


def test_storage_must_be_of_the_shader_s_element(kit: Kit) -> None:
    with kit.device.storage(sl.uint, 4) as numbers, kit.device.render_pass(kit.image):
        with refuses(rules.BINDING_TYPE, kit.device):
            kit.draw(weights=numbers)
        kit.draw()


def test_a_texture_must_have_the_shader_s_kind_and_type(kit: Kit) -> None:
    device = kit.device
    wrong = [
        device.texture(SIZE, Format.RGBA8, kind=TextureKind.D2_ARRAY, layers=1),
        device.texture(SIZE, Format.RGBA8, kind=TextureKind.CUBE),
        device.texture(SIZE, Format.RGBA8UI),
        device.texture(SIZE, Format.R32I),
        device.texture(SIZE, Format.RGBA8, samples=2),
    ]
    with device.render_pass(kit.image):
        for texture in wrong:
            with refuses(rules.BINDING_TYPE, device):
                kit.draw(albedo=texture)
        kit.draw(albedo=kit.depth)
    for texture in wrong:
        texture.destroy()


def test_samples_are_read_of_textures_that_have_several(recording: Device) -> None:
    fitting = [recording.texture(SIZE, format, samples=2) for format in (Format.RGBA8, Format.D32F)]
    single, whole = recording.texture(SIZE, Format.RGBA8), recording.texture(SIZE, Format.R32UI, samples=2)
    with recording.mesh(rectangle()) as mesh:
        program = recording.program(ReadSample)

        def draw(source: Texture) -> None:
            recording.draw(program, mesh, source=source, sample=Sample(number=0, origin=(0, 0)))

        with recording.render_pass(single):
            for texture in fitting:
                draw(texture)
            with refuses(rules.BINDING_TYPE, recording):
                draw(whole)  # integers
        with recording.render_pass(fitting[0]):
            with refuses(rules.BINDING_TYPE, recording) as refusal:
                draw(single)
            assert "several samples" in str(refusal.error)
            with refuses(rules.PASS_FEEDBACK, recording):
                draw(fitting[0])
    for texture in (*fitting, single, whole):
        texture.destroy()


def test_a_comparison_needs_a_comparing_sampler_and_depth(kit: Kit) -> None:
    with kit.device.render_pass(kit.image):
        with refuses(rules.BINDING_TYPE, kit.device):
            kit.draw(shadow=kit.depth)
        with refuses(rules.BINDING_TYPE, kit.device):
            kit.draw(shadow=kit.bindings["albedo"].sampled(SamplerDescriptor(compare=Comparison.LESS)))
        with refuses(rules.BINDING_TYPE, kit.device):
            kit.draw(albedo=kit.depth.sampled(SamplerDescriptor(compare=Comparison.LESS)))
        kit.draw()


def test_an_image_must_have_the_shader_s_format_and_kind(kit: Kit) -> None:
    device = kit.device
    other = device.texture(SIZE, Format.RGBA8_SNORM)
    array = device.texture(SIZE, Format.RGBA8, kind=TextureKind.D2_ARRAY, layers=2)
    with device.render_pass(kit.image):
        with refuses(rules.BINDING_TYPE, device):
            kit.draw(target=other.image())
        with refuses(rules.BINDING_TYPE, device):
            kit.draw(target=array.image())
        kit.draw(target=array.image(0, 1))
    other.destroy()
    array.destroy()


@pytest.mark.parametrize("name", ["tint", "weights", "albedo"])
def test_a_destroyed_resource_is_not_bound(kit: Kit, name: str) -> None:
    with kit.device.render_pass(kit.image):
        kit.draw()
        kit.bindings[name].destroy()
        with refuses(rules.RESOURCE_DESTROYED, kit.device):
            kit.draw()


@pytest.mark.parametrize("name", ["weights", "albedo"])
def test_a_locked_resource_is_not_bound(kit: Kit, name: str) -> None:
    with kit.device.render_pass(kit.image):
        kit.draw()
        with kit.bindings[name].lock(Access.WRITE), refuses(rules.LOCK_OPEN, kit.device):
            kit.draw()
        kit.draw()


@pytest.mark.parametrize("name", ["tint", "weights", "albedo", "shadow", "target"])
def test_a_resource_of_another_device_is_not_bound(kit: Kit, device: Device, name: str) -> None:
    other = Kit(device)
    with kit.device.render_pass(kit.image):
        kit.draw()
        with refuses(rules.RESOURCE_FOREIGN, kit.device):
            kit.draw(**{name: other.bindings[name]})
        kit.draw()


def test_a_uniform_in_a_buffer_must_be_aligned_and_large_enough(kit: Kit) -> None:
    from rhi.shading import UniformRange

    buffer = kit.device.buffer(1024)
    alignment = kit.device.capabilities.uniform_alignment
    with kit.device.render_pass(kit.image):
        for offset, size in ((0, 8), (alignment // 2, 16)):
            with refuses(rules.BINDING_SIZE, kit.device):
                kit.draw(tint=UniformRange(buffer.id, offset, size, Tint, buffer))
        kit.draw(tint=UniformRange(buffer.id, alignment, 16, Tint, buffer))
    buffer.destroy()


@pytest.mark.parametrize("name", ["class", "self"])
def test_a_binding_whose_name_cannot_be_a_keyword_argument_is_refused(recording: Device, name: str) -> None:
    bad, good = (
        Binding(binding_name, BindingKind.UNIFORM, 0, False, Camera, 16) for binding_name in (name, "mesh")
    )
    with refuses(rules.BINDING_NAME, recording):
        recording.program(hand_made_program("bad", bad))
    recording.program(hand_made_program("good", good))
