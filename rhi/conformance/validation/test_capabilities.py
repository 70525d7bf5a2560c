"""Calls that a device refuses because of its capabilities: each limit, with the largest value that passes,
and each feature that it lacks."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import rhi
import rhi.shading as sl
from rhi.conformance.shaders import Colored, Count
from rhi.conformance.validation.refusal import refuses
from rhi.contract.descriptors import Binding, BindingKind
from rhi.errors import rules

SIZE = (4, 4)


@pytest.fixture
def image(recording: rhi.Device) -> Any:
    with recording.texture(SIZE, rhi.Format.R8) as image:
        yield image


def test_a_texture_is_no_larger_than_the_device_says(recording: rhi.Device) -> None:
    most = recording.capabilities.max_texture_size
    for size in ((most + 1, 1), (1, most + 1)):
        with refuses(rules.TEXTURE_SIZE, recording):
            recording.texture(size, rhi.Format.R8)
    for size in ((most, 1), (1, most)):
        recording.texture(size, rhi.Format.R8).destroy()


def test_an_array_has_no_more_layers_than_the_device_says(recording: rhi.Device) -> None:
    most = recording.capabilities.max_texture_layers
    with refuses(rules.TEXTURE_SIZE, recording):
        recording.texture((1, 1), rhi.Format.R8, kind=rhi.TextureKind.D2_ARRAY, layers=most + 1)
    recording.texture((1, 1), rhi.Format.R8, kind=rhi.TextureKind.D2_ARRAY, layers=most).destroy()


@pytest.mark.parametrize("samples", [-1, 0, 1, 2, 3, 4, 5, 8, 16])
def test_samples_are_of_a_number_that_the_device_has(recording: rhi.Device, samples: int) -> None:
    if samples in recording.capabilities.sample_counts:
        recording.texture((4, 4), rhi.Format.R8, samples=samples).destroy()
    else:
        with refuses(rules.TEXTURE_SAMPLES, recording):
            recording.texture((4, 4), rhi.Format.R8, samples=samples)


def test_numbers_of_samples_ascend_from_1(recording: rhi.Device) -> None:
    counts = recording.capabilities.sample_counts
    assert counts[0] == 1
    assert list(counts) == sorted(set(counts) & {1, 2, 4, 8})


def test_a_border_is_refused_where_samplers_have_none(recording: rhi.Device) -> None:
    border = rhi.SamplerDescriptor(wrap_v=rhi.Wrap.BORDER)
    if recording.capabilities.border_colors:
        recording.sampler(border)
    else:
        with refuses(rules.DEVICE_CAPABILITY, recording):
            recording.sampler(border)
    recording.sampler(rhi.SamplerDescriptor(border=(1, 1, 1, 1)))


@pytest.mark.parametrize("state", [rhi.StencilReference, rhi.StencilReadMask, rhi.StencilWriteMask])
def test_faces_share_stencil_bytes_where_the_device_has_no_others(recording: rhi.Device, state: Any) -> None:
    if recording.capabilities.stencil_per_face:
        with recording.states(state(1, 2)):
            pass
    else:
        with refuses(rules.STATE_CAPABILITY, recording), recording.states(state(1, 2)):
            pass
    with recording.states(state(2, 2)):
        pass


def test_copies_are_aligned_as_the_device_says(recording: rhi.Device) -> None:
    alignment = recording.capabilities.copy_alignment
    with (
        recording.buffer(4 * alignment, np.dtype("u1")) as a,
        recording.buffer(4 * alignment, np.dtype("u1")) as b,
    ):
        a.copy_to(b, size=alignment, offset=alignment, target_offset=2 * alignment)
        for moved in ({"size": 1}, {"offset": 1}, {"target_offset": 1}):
            copy: dict[str, int] = {"size": alignment, "offset": 0, "target_offset": 0} | moved
            if alignment == 1:
                a.copy_to(b, **copy)
            else:
                with refuses(rules.BUFFER_ALIGNMENT, recording):
                    a.copy_to(b, **copy)


def test_a_sampler_is_no_more_anisotropic_than_the_device_says(recording: rhi.Device) -> None:
    most = recording.capabilities.max_anisotropy
    with refuses(rules.DEVICE_CAPABILITY, recording):
        recording.sampler(rhi.SamplerDescriptor(max_anisotropy=most + 0.5))
    with recording.texture((1, 1), rhi.Format.RGBA8) as texture:
        with refuses(rules.DEVICE_CAPABILITY, recording):
            texture.sampled(rhi.SamplerDescriptor(max_anisotropy=most + 0.5))
    recording.sampler(rhi.SamplerDescriptor(max_anisotropy=most))


def test_a_copy_between_a_texture_and_a_buffer_is_aligned_as_the_device_says(recording: rhi.Device) -> None:
    limits = recording.capabilities
    offset, row = max(4, limits.copy_offset_alignment), max(4, limits.copy_row_alignment)
    with (
        recording.texture((1, 3), rhi.Format.RGBA8) as texture,
        recording.buffer(8 * (offset + row)) as buffer,
    ):
        if not limits.texture_buffer_copies:
            with refuses(rules.DEVICE_CAPABILITY, recording):
                texture.copy_to_buffer(buffer)
            return
        wrong: list[dict[str, Any]] = [{"offset": offset + offset // 2}, {"row_bytes": row + row // 2}]
        for bad in wrong:
            with refuses(rules.BUFFER_ALIGNMENT, recording):
                texture.copy_to_buffer(buffer, **bad)
            with refuses(rules.BUFFER_ALIGNMENT, recording):
                texture.copy_from_buffer(buffer, **bad)
        texture.copy_to_buffer(buffer, offset=offset, row_bytes=row)
        texture.copy_from_buffer(buffer, offset=offset, row_bytes=row)


def test_formats_that_the_device_lacks_are_refused(recording: rhi.Device) -> None:
    for format in recording.capabilities.unsupported_formats:
        with refuses(rules.DEVICE_CAPABILITY, recording):
            recording.texture((4, 4), format)


def test_formats_that_cannot_be_drawn_to_are_refused(recording: rhi.Device) -> None:
    lacking = recording.capabilities.unrenderable_formats - recording.capabilities.unsupported_formats
    for format in lacking:
        with recording.texture(SIZE, format) as texture, refuses(rules.PASS_TARGET, recording):
            recording.render_pass(texture)


@pytest.mark.parametrize(
    ("format", "limit", "count"),
    [(rhi.Format.R8, "max_color_targets", 1), (rhi.Format.RGBA32F, "max_target_bytes", 16)],
)
def test_targets_are_no_more_than_the_device_says(
    recording: rhi.Device, format: rhi.Format, limit: str, count: int
) -> None:
    most = getattr(recording.capabilities, limit) // count
    targets = [recording.texture(SIZE, format) for _ in range(most + 1)]
    with refuses(rules.DEVICE_CAPABILITY, recording):
        recording.render_pass(targets)
    recording.render_pass(targets[:most])
    for target in targets:
        target.destroy()


def test_states_that_the_device_lacks_are_refused(recording: rhi.Device) -> None:
    capabilities = recording.capabilities
    for state, lacking in (
        (rhi.AlphaTest.ON, not capabilities.alpha_test),
        (rhi.StencilTest.ON, not capabilities.stencil),
        (rhi.PolygonMode.LINE, not capabilities.wireframe),
    ):
        if lacking:
            with refuses(rules.STATE_CAPABILITY, recording), recording.states(state):
                pass
        else:
            with recording.states(state):
                pass
    with recording.states(rhi.AlphaTest.OFF):
        pass


def test_lines_are_as_wide_as_the_device_says_and_no_wider(recording: rhi.Device) -> None:
    most = recording.capabilities.max_line_width
    for width in (1.0, most):
        with recording.states(rhi.LineWidth(width)):
            pass
    with refuses(rules.STATE_CAPABILITY, recording), recording.states(rhi.LineWidth(most + 0.5)):
        pass


class Dot(sl.Struct):
    """A position and a point size."""

    clip: sl.vec4
    size: sl.PointSize


class Dots(sl.Shader):
    """Draws points of two texels."""

    def vertex(self) -> Dot:
        return Dot(clip=sl.vec4(0.0, 0.0, 0.0, 1.0), size=2.0)

    def fragment(self) -> sl.vec4:
        return sl.vec4(1.0)


class Inside(sl.Shader):
    """Writes the place inside a point."""

    def vertex(self) -> sl.vec4:
        return sl.vec4(0.0, 0.0, 0.0, 1.0)

    def fragment(self) -> sl.vec4:
        return sl.vec4(sl.point_coordinate(), sl.vec2(0.0))


class Numbered(sl.Shader):
    """Reads the index of the draw."""

    def vertex(self) -> sl.vec4:
        return sl.vec4(float(sl.draw_index()), 0.0, 0.0, 1.0)

    def fragment(self) -> sl.vec4:
        return sl.vec4(1.0)


class Early(Colored):
    """Tests depth before it shades."""

    early_depth = True


class StoresInVertexStage(sl.Shader):
    """Stores in the vertex stage."""

    values: sl.StorageRW[float]

    def vertex(self) -> sl.vec4:
        self.values[0] = 1.0
        return sl.vec4(0.0)

    def fragment(self) -> sl.vec4:
        return sl.vec4(1.0)


class Slice(sl.Struct):
    """A position and a layer."""

    clip: sl.vec4
    layer: sl.TargetLayer


class ChoosesLayer(sl.Shader):
    """Draws to the third layer."""

    def vertex(self) -> Slice:
        return Slice(clip=sl.vec4(0.0, 0.0, 0.0, 1.0), layer=2)

    def fragment(self) -> sl.vec4:
        return sl.vec4(1.0)


@pytest.mark.requires("draws")
@pytest.mark.parametrize(
    ("shader", "feature"),
    [
        (Dots, "max_point_size"),
        (Inside, "max_point_size"),
        (Numbered, "draw_index"),
        (Early, "early_depth"),
        (StoresInVertexStage, "vertex_writes"),
        (ChoosesLayer, "layered_rendering"),
    ],
)
def test_programs_need_a_device_with_the_capabilities_that_they_use(
    recording: rhi.Device, shader: type[sl.Shader], feature: str
) -> None:
    if float(getattr(recording.capabilities, feature)) > (1.0 if feature == "max_point_size" else 0.0):
        recording.program(shader).destroy()
    else:
        with refuses(rules.DEVICE_CAPABILITY, recording):
            recording.program(shader)


@pytest.mark.requires("compute")
@pytest.mark.parametrize("axis", [0, 1, 2])
def test_groups_are_no_more_than_the_device_says(recording: rhi.Device, axis: int) -> None:
    groups = [1, 1, 1]
    groups[axis] = recording.capabilities.max_dispatch[axis] + 1
    with recording.storage(sl.uint, 1) as total, refuses(rules.DISPATCH_SIZE, recording):
        recording.dispatch(recording.program(Count), groups, total=total)


@pytest.mark.requires("compute")
def test_groups_are_no_more_in_all_than_the_device_says(recording: rhi.Device) -> None:
    """Drivers that count them in 32 bits end the process, or run what is left: of 2³² groups none. That the
    most are taken is shown by a null device with the same limits, which doesn't execute them for hours."""
    rows = recording.capabilities.max_dispatch_groups >> 16
    with rhi.create_device("null", profile=recording.capabilities) as null, null.storage(sl.uint, 1) as total:
        null.dispatch(null.program(Count), (1 << 15, rows, 2), total=total)
    with recording.storage(sl.uint, 1) as total, refuses(rules.DISPATCH_SIZE, recording):
        recording.dispatch(recording.program(Count), (1 << 15, rows // 2 + 1, 4), total=total)


@pytest.mark.requires("draws")
@pytest.mark.parametrize(
    ("kind", "limit"),
    [
        (BindingKind.UNIFORM, "max_uniform_slots"),
        (BindingKind.STORAGE, "max_storage_slots"),
        (BindingKind.TEXTURE, "max_texture_slots"),
        (BindingKind.IMAGE, "max_image_slots"),
    ],
    ids=lambda value: value.name.lower() if isinstance(value, BindingKind) else "",
)
def test_bindings_are_no_more_than_the_device_says(
    recording: rhi.Device, kind: BindingKind, limit: str
) -> None:
    def program(count: int) -> rhi.ProgramDescriptor:
        bindings = tuple(Binding(f"b{i}", kind, i, False, None, 16) for i in range(count))
        return replace(sl.compile_shader(Colored), bindings=bindings)

    most = getattr(recording.capabilities, limit)
    with refuses(rules.DEVICE_CAPABILITY, recording):
        recording.program(program(most + 1))
    recording.program(program(most)).destroy()


@pytest.mark.requires("compute")
def test_a_work_group_shares_no_more_than_the_device_says(recording: rhi.Device) -> None:
    most = recording.capabilities.max_shared_bytes // 4

    class Sharing(sl.Shader):
        """Shares a little too much."""

        results: sl.StorageRW[float]
        numbers = sl.shared(float, most + 1)

        def compute(self) -> None:
            self.numbers[0] = 1.0
            self.results[0] = self.numbers[0]

    with refuses(rules.DEVICE_CAPABILITY, recording):
        recording.program(Sharing)


def test_timing_needs_timestamps(recording: rhi.Device) -> None:
    if not recording.capabilities.timestamps:
        with refuses(rules.DEVICE_CAPABILITY, recording):
            recording.timing = True


def test_an_emulated_query_needs_a_counter(recording: rhi.Device) -> None:
    if recording.capabilities.sample_counter:
        recording.occlusion_query(emulated=True).destroy()
    else:
        with refuses(rules.DEVICE_CAPABILITY, recording):
            recording.occlusion_query(emulated=True)


def test_an_emulated_set_needs_a_counter(recording: rhi.Device) -> None:
    if recording.capabilities.sample_counter:
        recording.query_set(2, emulated=True).destroy()
    else:
        with refuses(rules.DEVICE_CAPABILITY, recording):
            recording.query_set(2, emulated=True)


@pytest.mark.requires("sample_counter", "conditional_rendering")
def test_a_condition_needs_a_native_query(recording: rhi.Device, image: Any) -> None:
    query = recording.occlusion_query(emulated=True)
    with recording.render_pass(image):
        with query:
            pass
        with refuses(rules.DEVICE_CAPABILITY, recording):
            recording.conditional(query)
