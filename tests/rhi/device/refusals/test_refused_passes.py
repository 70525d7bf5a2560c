"""Rules of render passes and states."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import rhi
from rhi.conformance.shaders import Colored, Loads, Positions
from rhi.conformance.shapes import rectangle
from rhi.conformance.validation.refusal import refuses
from rhi.errors import rules
from rhi.shading import Image2D, image, ivec2, vec4

SIZE = (4, 4)


def test_a_pass_needs_a_target(recording: rhi.Device) -> None:
    with refuses(rules.PASS_EMPTY, recording):
        recording.render_pass()
    with refuses(rules.PASS_EMPTY, recording):
        recording.render_pass([])


def test_a_target_is_a_texture(recording: rhi.Device) -> None:
    with recording.buffer(4) as buffer:
        for wrong in (buffer, "image", 3):
            with refuses(rules.PASS_TARGET, recording):
                recording.render_pass(wrong)  # type: ignore[arg-type]


def test_a_color_target_has_a_color_format(recording: rhi.Device) -> None:
    with recording.texture(SIZE, rhi.Format.D32F) as depth:
        with refuses(rules.PASS_TARGET, recording):
            recording.render_pass(depth)
        recording.render_pass(depth=depth)


def test_a_depth_target_has_a_depth_format(recording: rhi.Device) -> None:
    with recording.texture(SIZE, rhi.Format.R32F) as image:
        with refuses(rules.PASS_TARGET, recording):
            recording.render_pass(depth=image)
        recording.render_pass(image)


def test_a_texture_is_one_target_at_a_time(recording: rhi.Device) -> None:
    with recording.texture(SIZE, rhi.Format.R8) as image:
        with refuses(rules.PASS_TARGET, recording):
            recording.render_pass([image, image])
    with recording.texture(SIZE, rhi.Format.R8, kind=rhi.TextureKind.D2_ARRAY, layers=2) as image:
        with refuses(rules.PASS_TARGET, recording):
            recording.render_pass([image.at(layer=1), image.at(layer=1)])
        recording.render_pass([image.at(layer=0), image.at(layer=1)])


@pytest.mark.parametrize("kind", [rhi.TextureKind.D2_ARRAY, rhi.TextureKind.CUBE, rhi.TextureKind.D3])
def test_a_texture_with_several_layers_is_a_target_by_one_layer(
    recording: rhi.Device, kind: rhi.TextureKind
) -> None:
    with recording.texture(SIZE, rhi.Format.RGBA8, kind=kind, layers=6) as layered:
        for color in (layered, [layered]):
            with refuses(rules.PASS_TARGET, recording):
                recording.render_pass(color)
        recording.render_pass(layered.at(layer=5))
        with recording.render_pass(layered.at(), clear=(1, 0, 0, 1)):
            pass
    with recording.texture(SIZE, rhi.Format.D32F, kind=rhi.TextureKind.D2_ARRAY, layers=2) as layered:
        with refuses(rules.PASS_TARGET, recording):
            recording.render_pass(depth=layered)
        recording.render_pass(depth=layered.at(layer=1))
    with recording.texture(SIZE, rhi.Format.R8, kind=rhi.TextureKind.D2_ARRAY, layers=1) as single:
        recording.render_pass(single)


def test_all_layers_are_those_of_all_targets_of_one_kind(recording: rhi.Device) -> None:
    arrays, cube = rhi.TextureKind.D2_ARRAY, rhi.TextureKind.CUBE
    with (
        recording.texture(SIZE, rhi.Format.RGBA8, kind=arrays, layers=6) as image,
        recording.texture(SIZE, rhi.Format.D32F, kind=arrays, layers=6) as depth,
        recording.texture(SIZE, rhi.Format.D32F, kind=arrays, layers=5) as fewer,
        recording.texture(SIZE, rhi.Format.D32F, kind=cube, layers=6) as other,
        recording.texture(SIZE, rhi.Format.RGBA8) as flat,
    ):
        colors = image.at(layer=None)
        for target in (fewer.at(layer=None), other.at(layer=None), depth.at(), depth.at(layer=3)):
            with refuses(rules.PASS_TARGET, recording):
                recording.render_pass(colors, target)
        for target in (flat.at(layer=None), [colors, image.at(layer=1)], [image.at(), colors]):
            with refuses(rules.PASS_TARGET, recording):
                recording.render_pass(target)
        with recording.render_pass(colors, depth.at(layer=None), clear=(1, 0, 0, 1), clear_depth=0.0):
            pass
        assert (image.read_layers() == (255, 0, 0, 255)).all()


def test_a_device_without_layered_rendering_names_the_loop() -> None:
    with rhi.create_device("null", profile="webgpu") as device:
        cube = device.texture(SIZE, rhi.Format.RGBA8, kind=rhi.TextureKind.CUBE)
        with pytest.raises(
            rhi.ValidationError, match=r"a pass for each layer: texture\.at\(layer=…\)"
        ) as refused:
            device.render_pass(cube.at(layer=None))
        assert refused.value.rule is rules.DEVICE_CAPABILITY
        device.render_pass(cube.at(layer=3))


def test_samples_are_resolved_to_a_texture_with_one_layer(recording: rhi.Device) -> None:
    with recording.texture(SIZE, rhi.Format.RGBA8, samples=2) as image:
        for layers, fits in ((1, True), (2, False)):
            with recording.texture(
                SIZE, rhi.Format.RGBA8, kind=rhi.TextureKind.D2_ARRAY, layers=layers
            ) as end:
                if fits:
                    recording.render_pass(image, resolve=end)
                    continue
                with refuses(rules.PASS_TARGET, recording):
                    recording.render_pass(image, resolve=end)


@pytest.mark.parametrize("other", [(4, 5), (5, 4), (8, 8)], ids=str)
def test_targets_have_one_size(recording: rhi.Device, other: tuple[int, int]) -> None:
    with (
        recording.texture(SIZE, rhi.Format.R8) as image,
        recording.texture(other, rhi.Format.R8) as second,
        recording.texture(other, rhi.Format.D32F, levels=None) as depth,
    ):
        with refuses(rules.PASS_SIZE, recording):
            recording.render_pass([image, second])
        with refuses(rules.PASS_SIZE, recording):
            recording.render_pass(image, depth)
        recording.render_pass(second, depth)
        if other == (8, 8):
            recording.render_pass(image, depth.at(level=1))


def test_targets_have_one_number_of_samples(recording: rhi.Device) -> None:
    with (
        recording.texture(SIZE, rhi.Format.R8, samples=2) as image,
        recording.texture(SIZE, rhi.Format.D32F) as depth,
        recording.texture(SIZE, rhi.Format.D32F, samples=2) as fitting,
    ):
        with refuses(rules.PASS_SAMPLES, recording):
            recording.render_pass(image, depth)
        recording.render_pass(image, fitting)


@pytest.mark.parametrize(
    "clear",
    [
        (0, 0, 0),
        (0, 0, 0, 0, 0),
        (float("nan"), 0, 0, 0),
        (float("inf"), 0, 0, 0),
        [(0, 0, 0, 0)] * 2,
        ("a", 0, 0, 0),
        0,
    ],
    ids=str,
)
def test_a_clear_is_four_finite_numbers_per_target(
    recording: rhi.Device, clear: Any, image: rhi.Texture
) -> None:
    with refuses(rules.PASS_CLEAR, recording):
        recording.render_pass(image, clear=clear)
    recording.render_pass(image, clear=(0, 0, 0, 0))
    recording.render_pass(image, clear=[(0, 0, 0, 0)])
    recording.render_pass(image, clear=np.zeros(4, np.float32))
    recording.render_pass(image, clear=np.zeros((1, 4), np.float32))


@pytest.mark.parametrize(
    ("format", "clear", "wrong", "minimum", "maximum"),
    [(rhi.Format.D32F, "clear_depth", value, 0.0, 1.0) for value in (-0.001, 1.001, float("nan"))]
    + [(rhi.Format.D24S8, "clear_stencil", value, 0, 255) for value in (-1, 256)],
)
def test_a_clear_of_depth_is_0_to_1_and_of_stencil_a_byte(
    recording: rhi.Device, format: rhi.Format, clear: str, wrong: float, minimum: float, maximum: float
) -> None:
    with recording.texture(SIZE, format) as depth:
        with refuses(rules.PASS_CLEAR, recording):
            recording.render_pass(depth=depth, **{clear: wrong})  # type: ignore[arg-type]
        for fitting in (minimum, maximum):
            recording.render_pass(depth=depth, **{clear: fitting})  # type: ignore[arg-type]


def test_a_depth_clear_needs_a_depth_target(recording: rhi.Device) -> None:
    with recording.texture(SIZE, rhi.Format.R8) as image, refuses(rules.PASS_CLEAR, recording):
        recording.render_pass(image, clear_depth=0.0)


def test_a_stencil_clear_needs_stencil(recording: rhi.Device) -> None:
    with recording.texture(SIZE, rhi.Format.D32F) as depth, refuses(rules.PASS_CLEAR, recording):
        recording.render_pass(depth=depth, clear_stencil=0)


def test_a_resolve_fits_its_target(recording: rhi.Device) -> None:
    with (
        recording.texture(SIZE, rhi.Format.RGBA8, samples=2) as image,
        recording.texture(SIZE, rhi.Format.RGBA8) as fitting,
        recording.texture((8, 8), rhi.Format.RGBA8) as larger,
        recording.texture(SIZE, rhi.Format.RGBA16F) as other,
    ):
        for wrong in (larger, other, image):
            with refuses(rules.PASS_TARGET, recording):
                recording.render_pass(image, resolve=wrong)
        with refuses(rules.PASS_TARGET, recording):
            recording.render_pass(fitting, resolve=fitting)
        with refuses(rules.PASS_TARGET, recording):
            recording.render_pass(image, resolve=[fitting, fitting])
        recording.render_pass(image, resolve=fitting)
        recording.render_pass(image, resolve=[None])


def test_a_target_destroyed_before_its_pass_opens_is_refused(recording: rhi.Device) -> None:
    image = recording.texture(SIZE, rhi.Format.R8)
    prepared = recording.render_pass(image)
    image.destroy()
    with refuses(rules.RESOURCE_DESTROYED, recording), prepared:
        pass


def test_a_resolve_destroyed_before_its_pass_opens_is_refused(recording: rhi.Device) -> None:
    with recording.texture(SIZE, rhi.Format.R8, samples=2) as image:
        single = recording.texture(SIZE, rhi.Format.R8)
        prepared = recording.render_pass(image, resolve=single)
        with prepared:
            pass
        single.destroy()
        with refuses(rules.RESOURCE_DESTROYED, recording), prepared:
            pass


# -- feedback ----------------------------------------------------------------------------------------------


class Stored(Positions):
    """An image written by fragments."""

    target: Image2D = image(rhi.Format.RGBA8)

    def fragment(self) -> vec4:
        self.target.store(ivec2(0, 0), vec4(1.0))
        return vec4(1.0)


def test_a_pass_does_not_sample_its_target(recording: rhi.Device, mesh: rhi.Mesh) -> None:
    with (
        recording.texture(SIZE, rhi.Format.RGBA8, levels=2) as image,
        recording.texture(SIZE, rhi.Format.RGBA8) as other,
    ):
        program = recording.program(Loads)
        with recording.render_pass(other):
            recording.draw(program, mesh, source=image)  # the same binding, not yet a target
        with recording.render_pass(image):
            with refuses(rules.PASS_FEEDBACK, recording):
                recording.draw(program, mesh, source=image)
            recording.draw(program, mesh, source=other)
        with recording.render_pass(image.at(level=1)):
            with refuses(rules.PASS_FEEDBACK, recording):
                recording.draw(program, mesh, source=image)


def test_a_pass_does_not_store_to_its_target(recording: rhi.Device, mesh: rhi.Mesh) -> None:
    with (
        recording.texture(SIZE, rhi.Format.RGBA8) as image,
        recording.texture(SIZE, rhi.Format.RGBA8) as other,
    ):
        program = recording.program(Stored)
        with recording.render_pass(image):
            with refuses(rules.PASS_FEEDBACK, recording):
                recording.draw(program, mesh, target=image.image())
            recording.draw(program, mesh, target=other.image())


# -- states ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("wrong", ["CullMode.NONE", rhi.CullMode, 3, None, {}, rhi.Format.R8], ids=str)
def test_a_scope_takes_states_only(recording: rhi.Device, wrong: Any) -> None:
    with refuses(rules.STATE_TYPE, recording), recording.states(rhi.CullMode.NONE, wrong):
        pass
    with recording.states(rhi.CullMode.NONE):
        pass


def test_a_scope_sets_a_state_once(recording: rhi.Device) -> None:
    with refuses(rules.STATE_DUPLICATE, recording), recording.states(rhi.CullMode.NONE, rhi.CullMode.FRONT):
        pass
    with (
        refuses(rules.STATE_DUPLICATE, recording),
        recording.states(rhi.ColorWrite.OFF.at(1), rhi.ColorWrite.ON.at(1)),
    ):
        pass
    with recording.states(rhi.ColorWrite.OFF.at(1), rhi.ColorWrite.ON.at(2)):
        pass


def test_a_refused_scope_leaves_no_trace(recording: rhi.Device) -> None:
    before = recording.statistics
    with (
        refuses(rules.STATE_DUPLICATE, recording),
        recording.states(rhi.Scissor(0, 0, 1, 1), rhi.CullMode.NONE, rhi.CullMode.NONE),
    ):
        pass
    after = recording.statistics
    assert after.software_state_changes == before.software_state_changes
    with recording.texture(SIZE, rhi.Format.R8) as image, recording.mesh(rectangle()) as mesh:
        with recording.render_pass(image):
            recording.draw(recording.program(Colored), mesh)
    states = recording.stream.draws()[-1].states
    assert states[rhi.Scissor] == rhi.Scissor.OFF
    assert states[rhi.CullMode] == rhi.CullMode.BACK


@pytest.mark.parametrize(
    ("wrong", "fitting"),
    [
        (lambda: rhi.Viewport(0, 0, -1, 1), lambda: rhi.Viewport(0, 0, 0, 1)),
        (lambda: rhi.Viewport(float("nan"), 0, 1, 1), lambda: rhi.Viewport(-4, 0, 1, 1)),
        (lambda: rhi.Viewport(0, 0, 1, 1, -0.1), lambda: rhi.Viewport(0, 0, 1, 1, 0.0)),
        (lambda: rhi.Viewport(0, 0, 1, 1, 0, 1.1), lambda: rhi.Viewport(0, 0, 1, 1, 1, 0)),
        (lambda: rhi.Scissor(0, 0, -1, 0), lambda: rhi.Scissor(0, 0, 0, 0)),
        (lambda: rhi.Scissor(0, 0, 0, -1), lambda: rhi.Scissor(-9, -9, 0, 0)),
        (lambda: rhi.StencilReference(256), lambda: rhi.StencilReference(255)),
        (lambda: rhi.StencilReference(0, -1), lambda: rhi.StencilReference(0, 0)),
        (lambda: rhi.DepthBias(float("inf")), lambda: rhi.DepthBias(-1e6)),
        (lambda: rhi.BlendColor(float("nan")), lambda: rhi.BlendColor(-1.0, 2.0)),
        (lambda: rhi.BlendFunction.ALPHA.at(8), lambda: rhi.BlendFunction.ALPHA.at(7)),
        (lambda: rhi.ColorWrite.OFF.at(-1), lambda: rhi.ColorWrite.OFF.at(0)),
        (lambda: rhi.ColorWrite.OFF.at(True), lambda: rhi.ColorWrite.OFF.at(np.int64(1))),
        (lambda: rhi.ColorWrite(1), lambda: rhi.ColorWrite(np.bool_(True))),
        (lambda: rhi.Scissor(0.5, 0, 1, 1), lambda: rhi.Scissor(np.int32(5), 0, 1, 1)),
        (lambda: rhi.Scissor(0, 0, 4 / 2, 1), lambda: rhi.Scissor(0, 0, 4 // 2, 1)),
        (lambda: rhi.Viewport(0, 0, 1e30, 10), lambda: rhi.Viewport(0, 0, 16_384, 10)),
        (lambda: rhi.Viewport(0, 0, 10, 16_385), lambda: rhi.Viewport(-32_767, 32_767.0, 10, 0.5)),
        (lambda: rhi.Viewport(-32_768, 0, 10, 10), lambda: rhi.Viewport(np.float32(0.5), 0, 10, 10)),
        (lambda: rhi.StencilFront(1), lambda: rhi.StencilFront(rhi.Comparison.LESS)),
        (
            lambda: rhi.StencilBack(depth_fail=rhi.Comparison.LESS),
            lambda: rhi.StencilBack(depth_fail=rhi.StencilOperation.KEEP),
        ),
        (lambda: rhi.BlendFunction("one"), lambda: rhi.BlendFunction(rhi.BlendFactor.ONE)),
        (
            lambda: rhi.BlendFunction(source_alpha=1),
            lambda: rhi.BlendFunction(source_alpha=rhi.BlendFactor.ONE),
        ),
    ],
)
def test_a_state_s_numbers_are_checked_when_it_is_made(
    recording: rhi.Device, wrong: Any, fitting: Any
) -> None:
    with refuses(rules.STATE_VALUE, recording):
        wrong()
    fitting()
