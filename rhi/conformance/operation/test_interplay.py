"""Side effects that must not happen: of states on copies, of conditions on clears, of devices on each other,
and of writes between two draws on the first draw."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from typing import Any

import numpy as np
import pytest

import rhi
import rhi.shading as sl
from rhi import (
    BlendFunction,
    ColorWrite,
    Comparison,
    CullMode,
    DepthFunction,
    DepthWrite,
    Device,
    Format,
    Mesh,
    Primitive,
    Region,
    Scissor,
    State,
    StencilFront,
    StencilTest,
    Viewport,
)
from rhi.conformance.compare import assert_near, assert_same
from rhi.conformance.formats import require_samples
from rhi.conformance.shaders import Colored, Corner, Count, Loads, Shade, Tint, Tinted, Weighted
from rhi.conformance.shapes import centers, corners, rectangle
from rhi.conformance.single_draws import draw_once

pytestmark = [pytest.mark.requires("draws", "shading"), pytest.mark.recorded_too]

SIZE = (8, 8)
HOSTILE = {
    "scissor": Scissor(0, 0, 1, 1),
    "color write": ColorWrite.OFF,
    "depth write": DepthWrite.OFF,
    "culling": CullMode.FRONT,
    "depth test": DepthFunction.NEVER,
    "blending": BlendFunction.ADDITIVE,
    "stencil test": StencilTest.ON,
}
"""States that would break a copy, a clear or a dispatch that is implemented as a draw."""
NOTHING_PASSES = StencilFront(Comparison.NEVER)
"""What the stencil test compares when it is the hostile state."""
each_state = pytest.mark.parametrize("state", HOSTILE.values(), ids=HOSTILE)
"""Runs a test once for each hostile state, so that the name of a failure says which state leaks."""


class Fill(sl.Shader):
    """Stores one color everywhere."""

    target: sl.Image2D = sl.image(Format.RGBA8)

    def compute(self) -> None:
        self.target.store(sl.global_id().xy, sl.vec4(1.0))


@contextmanager
def hostile(device: Device, state: State) -> Iterator[None]:
    """Open a scope with a hostile state that a draw has already set in the driver."""
    states = [state]
    if state is StencilTest.ON:
        if not device.capabilities.stencil:
            pytest.skip(f"{device.backend_name} declares no stencil")
        states.append(NOTHING_PASSES)
    with device.states(*states):
        with (
            device.texture(SIZE, Format.RGBA8) as image,
            device.texture(SIZE, Format.D24S8) as depth,
            device.mesh(rectangle()) as mesh,
            device.render_pass(image, depth),
        ):
            device.draw(device.program(Colored), mesh)
        yield


def filled_texture(device: Device, **options: Any) -> rhi.Texture:
    """Create a texture with 60 in each byte of level 0, so that blending would change what is written."""
    texture = device.texture(SIZE, Format.RGBA8, **options)
    texture.write(np.full((8, 8, 4), 60, "u1"))
    return texture


RANDOM_TEXELS = np.random.default_rng(0).integers(0, 256, (8, 8, 4), dtype="u1")


# -- states and operations that aren't draws ---------------------------------------------------------------


@each_state
def test_states_do_not_touch_resolves_at_the_end_of_a_pass(device: Device, state: State) -> None:
    require_samples(device, 4)
    outside = rectangle(2, 2, 3, 3)
    with (
        device.texture(SIZE, Format.RGBA8, samples=4) as source,
        filled_texture(device) as target,
        device.mesh(outside) as mesh,
        hostile(device, state),
    ):
        with device.render_pass(source, clear=(0.2, 0.4, 0.6, 0.8), resolve=target):
            device.draw(device.program(Colored), mesh)  # covers nothing, and sets the state in this pass
        assert_same(target.read(), (51, 102, 153, 204))


@each_state
def test_states_do_not_touch_resolves_by_themselves(device: Device, state: State) -> None:
    require_samples(device, 4)
    with device.texture(SIZE, Format.RGBA8, samples=4) as source, filled_texture(device) as target:
        with device.render_pass(source, clear=(0.2, 0.4, 0.6, 0.8)):
            pass
        with hostile(device, state):
            source.resolve_to(target)
            assert_same(target.read(), (51, 102, 153, 204))


@each_state
def test_states_do_not_touch_writes_and_reads(device: Device, state: State) -> None:
    with filled_texture(device) as texture, hostile(device, state):
        texture.write(RANDOM_TEXELS)
        assert_same(texture.read(), RANDOM_TEXELS)


@each_state
def test_states_do_not_touch_copies(device: Device, state: State) -> None:
    with device.texture(RANDOM_TEXELS, Format.RGBA8) as texture, filled_texture(device) as copy:
        with hostile(device, state):
            texture.copy_to(copy, region=Region(0, 0, 8, 8))
        assert_same(copy.read(), RANDOM_TEXELS)


@each_state
def test_states_do_not_touch_mipmaps(device: Device, state: State) -> None:
    with filled_texture(device, levels=2) as texture:
        texture.generate_mipmaps()
        texture.write(RANDOM_TEXELS)
        with hostile(device, state):
            texture.generate_mipmaps()
        means = RANDOM_TEXELS.reshape(4, 2, 4, 2, 4).mean(axis=(1, 3))
        assert_near(texture.read(1), means, 1, "one unit of rounding")


@each_state
def test_states_do_not_touch_clears_of_color(device: Device, state: State) -> None:
    with filled_texture(device) as image:
        with hostile(device, state), device.render_pass(image, clear=(0.6, 0.6, 0.6, 0.6)):
            pass
        assert_same(image.read(), 153)


@each_state
def test_states_do_not_touch_clears_of_depth(device: Device, state: State) -> None:
    with device.texture(SIZE, Format.D24S8) as depth:
        with hostile(device, state), device.render_pass(depth=depth, clear_depth=0.25):
            pass
        assert_near(depth.read(), 0.25, 2.0**-24, "24 bits of depth")


@each_state
def test_states_do_not_touch_clears_of_stencil_values(device: Device, state: State) -> None:
    with device.texture(SIZE, Format.D24S8) as depth:
        with hostile(device, state), device.render_pass(depth=depth, clear_stencil=7):
            pass
        assert_same(depth.read_stencil(), 7)


@each_state
@pytest.mark.requires("compute")
def test_states_do_not_touch_dispatches(device: Device, state: State) -> None:
    with filled_texture(device) as target, hostile(device, state):
        device.dispatch(device.program(Fill), SIZE, target=target.image())
        assert_same(target.read(), 255)


def test_srgb_samples_are_averaged_in_linear_light(device: Device) -> None:
    require_samples(device, 4)
    rows = np.concatenate(
        [
            corners([(-1, 1), (-1, -1), (1, -1)], (1, 1, 1, 1)),
            corners([(-1, 1), (1, -1), (1, 1)], (0, 0, 0, 1)),
        ]
    )
    with (
        device.texture(SIZE, Format.RGBA8_SRGB, samples=4) as source,
        device.texture(SIZE, Format.RGBA8_SRGB) as target,
        device.texture(SIZE, Format.RGBA16F, samples=4) as linear_source,
        device.texture(SIZE, Format.RGBA16F) as linear,
        device.mesh(rows) as mesh,
    ):
        for image, resolved in ((source, target), (linear_source, linear)):
            with device.render_pass(image, clear=(0, 0, 0, 0), resolve=resolved):
                device.draw(device.program(Colored), mesh)
        light = linear.read()[..., 0].astype(np.float64)
        srgb = np.where(
            light <= 0.0031308, light * 12.92, 1.055 * np.maximum(light, 0.0031308) ** (1 / 2.4) - 0.055
        )
        assert_near(target.read()[..., 0], srgb * 255, 1.5, "sRGB curves may be approximated")


# -- conditional rendering ---------------------------------------------------------------------------------


@pytest.fixture
def dropped(device: Device) -> Iterator[AbstractContextManager[Any]]:
    """A condition that isn't met: a query that no draw has counted for."""
    query = device.occlusion_query()
    with device.texture(SIZE, Format.RGBA8) as image, device.render_pass(image), query:
        pass
    yield device.conditional(query)
    query.destroy()


conditional = pytest.mark.requires("occlusion_queries", "conditional_rendering")


@conditional
def test_a_condition_drops_draws_but_not_the_clear_of_their_pass(
    device: Device, mesh: Mesh, dropped: AbstractContextManager[Any]
) -> None:
    with device.texture(SIZE, Format.RGBA8) as image:
        with dropped, device.render_pass(image, clear=(0.2, 0.2, 0.2, 0.2)):
            device.draw(device.program(Colored), mesh)
        assert_same(image.read(), 51)


@conditional
def test_a_condition_does_not_drop_resolves(device: Device, dropped: AbstractContextManager[Any]) -> None:
    require_samples(device, 4)
    with (
        device.texture(SIZE, Format.RGBA8, samples=4) as source,
        device.texture(SIZE, Format.RGBA8) as resolved,
    ):
        with dropped, device.render_pass(source, clear=(0.4, 0.4, 0.4, 0.4), resolve=resolved):
            pass
        assert_same(resolved.read(), 102)


@conditional
def test_a_condition_does_not_drop_writes(device: Device, dropped: AbstractContextManager[Any]) -> None:
    with device.texture(SIZE, Format.RGBA8) as texture:
        with dropped:
            texture.write(RANDOM_TEXELS)
        assert_same(texture.read(), RANDOM_TEXELS)


@conditional
def test_a_condition_does_not_drop_mipmaps(device: Device, dropped: AbstractContextManager[Any]) -> None:
    with filled_texture(device, levels=2) as texture:
        with dropped:
            texture.generate_mipmaps()
        assert_same(texture.read(1), 60)


@conditional
def test_a_condition_does_not_drop_copies(device: Device, dropped: AbstractContextManager[Any]) -> None:
    with device.texture(RANDOM_TEXELS, Format.RGBA8) as texture, device.texture(SIZE, Format.RGBA8) as copy:
        with dropped:
            texture.copy_to(copy, region=Region(0, 0, 8, 8))
        assert_same(copy.read(), RANDOM_TEXELS)


@conditional
@pytest.mark.requires("compute")
def test_a_condition_does_not_drop_dispatches(device: Device, dropped: AbstractContextManager[Any]) -> None:
    with device.storage(sl.uint, 1) as total:
        with dropped:
            device.dispatch(device.program(Count), 3, total=total)
        assert_same(total.read(), 3)


# -- each draw sees what was written before it -------------------------------------------------------------


def steps(device: Device, write: Any, shader: Any, **bindings: Any) -> Any:
    """Draw eight columns in one pass, with `write(i)` before each draw and no wait between."""
    columns = [rectangle(-1 + i / 4, -1, -1 + (i + 1) / 4, 1) for i in range(8)]
    with device.texture(SIZE, Format.R32F) as image, device.mesh(np.concatenate(columns)) as mesh:
        program = device.program(shader)
        with device.render_pass(image, clear=(-1, 0, 0, 0)):
            for i in range(8):
                write(i)
                device.draw(program, mesh.view(6 * i, 6), **bindings)
        return image.read()


COLUMNS = np.broadcast_to(np.arange(8.0), (8, 8))


def test_a_draw_sees_the_constants_of_its_time(device: Device) -> None:
    with device.uniform(Tint(color=(0, 0, 0, 0))) as tint:
        assert_same(steps(device, lambda i: tint.write(Tint(color=(i, 0, 0, 0))), Tinted, tint=tint), COLUMNS)


def test_a_draw_sees_the_storage_of_its_time(device: Device) -> None:
    with device.storage(sl.vec4, 1) as weights:
        rows = np.zeros((1, 4), "f4")

        def write(i: int) -> None:
            rows[0, 0] = i
            weights.write(rows)

        assert_same(steps(device, write, Weighted, weights=weights), COLUMNS)


def test_a_draw_sees_the_copies_of_its_time(device: Device) -> None:
    numbers = np.zeros((8, 4), "f4")
    numbers[:, 0] = np.arange(8)
    with device.storage(sl.vec4, numbers) as source, device.storage(sl.vec4, 1) as weights:
        image = steps(
            device,
            lambda i: source.owner.copy_to(weights.owner, size=16, offset=16 * i),
            Weighted,
            weights=weights,
        )
        assert_same(image, COLUMNS)


def test_a_draw_sees_the_texels_of_its_time(device: Device) -> None:
    with device.texture(SIZE, Format.R32F) as source:
        image = steps(device, lambda i: source.write(np.full((8, 8), i, "f4")), Loads, source=source)
        assert_same(image, COLUMNS)


def test_each_draw_reads_its_own_element_of_a_uniform_array(device: Device) -> None:
    columns = [rectangle(-1 + i / 4, -1, -1 + (i + 1) / 4, 1) for i in range(8)]
    with (
        device.uniform_array(Tint, 8) as tints,
        device.texture(SIZE, Format.R32F) as image,
        device.mesh(np.concatenate(columns)) as mesh,
    ):
        rows = np.zeros(8, tints.dtype)
        rows["color"][:, 0] = np.arange(8)
        tints.write(rows)
        program = device.program(Tinted)
        with device.render_pass(image, clear=(-1, 0, 0, 0)):
            for i in (3, 1, 0, 2, 7, 5, 4, 6):
                device.draw(program, mesh.view(6 * i, 6), tint=tints[i])
        assert_same(image.read(), COLUMNS)


def test_a_target_can_be_read_in_its_pass(device: Device) -> None:
    """All commands, reads included, execute in the order of the calls."""
    with device.texture(SIZE, Format.R16F) as image, device.mesh(rectangle(color=(2, 0, 0, 0))) as mesh:
        with device.render_pass(image, clear=(1, 0, 0, 0)):
            assert_same(image.read(), 1)
            device.draw(device.program(Colored), mesh)
            assert_same(image.read(), 2)
            with device.states(BlendFunction.ADDITIVE):
                device.draw(device.program(Colored), mesh)
        assert_same(image.read(), 4)


def test_work_between_two_draws_of_a_pass_leaves_the_pass_as_it_was(device: Device) -> None:
    """Creations, writes, copies, mipmaps and reads in the middle of a pass."""
    with device.texture(SIZE, Format.R16F) as image, device.mesh(rectangle(color=(1, 0, 0, 0))) as mesh:
        program = device.program(Colored)
        with device.render_pass(image), device.states(BlendFunction.ADDITIVE, Viewport(0, 0, 4, 8)):
            device.draw(program, mesh)
            with device.texture(np.full((16, 16, 4), 9, "u1"), Format.RGBA8, levels=None) as other:
                other.generate_mipmaps()
                with device.texture((16, 16), Format.RGBA8, levels=None) as copy:
                    other.copy_to(copy)
                    assert_same(copy.read(), 9)
                assert_same(other.read(3), 9)
            with device.buffer(np.arange(4, dtype="u4")) as buffer:
                assert_same(buffer.read(), [0, 1, 2, 3])
            device.finish()
            device.draw(program, mesh)
        assert_same(image.read(), np.where(np.arange(8) < 4, 2, 0)[None])


# -- devices -----------------------------------------------------------------------------------------------


def test_draws_of_two_devices_may_alternate(device: Device, backend: str) -> None:
    """Neither device sees the other's programs, bindings, states or passes, although no draw rebinds
    anything."""
    columns = np.concatenate([rectangle(-1 + i / 4, -1, -1 + (i + 1) / 4, 1) for i in range(8)])
    with rhi.create_device(backend, validation=True) as other:
        parts = []
        for number, drawing_device in enumerate((device, other)):
            tints = drawing_device.uniform_array(Tint, 8)
            rows = np.zeros(8, tints.dtype)
            rows["color"][:, 0] = np.arange(8) + 100 * number
            tints.write(rows)
            parts.append(
                (
                    drawing_device,
                    drawing_device.program(Tinted),
                    drawing_device.texture(SIZE, Format.R32F),
                    drawing_device.mesh(columns),
                    tints,
                )
            )
        passes = [
            drawing_device.render_pass(image, clear=(-1, 0, 0, 0)) for drawing_device, _, image, _, _ in parts
        ]
        with passes[0], passes[1], other.states(Scissor(0, 4, 8, 4)):
            for i in range(8):
                for drawing_device, program, _, mesh, tints in parts:
                    drawing_device.draw(program, mesh.view(6 * i, 6), tint=tints[i])
        assert_same(parts[0][2].read(), COLUMNS)
        assert_same(parts[1][2].read(), np.where(np.arange(8)[:, None] < 4, -1, COLUMNS + 100))
        for resource in parts[0][2:]:
            resource.destroy()


def test_points_of_two_devices_are_counted_by_their_own_queries(device: Device, backend: str) -> None:
    """Draws alternate, and a device is created and closed while both queries are active."""
    if not device.capabilities.occlusion_queries:
        pytest.skip(f"{backend} declares no occlusion_queries")
    rows = corners(centers([(i, 0) for i in range(8)], SIZE))
    with rhi.create_device(backend) as other:
        counted = []
        for drawing_device, count in ((device, 3), (other, 5)):
            image, mesh = (
                drawing_device.texture(SIZE, Format.R8),
                drawing_device.mesh(rows, primitive=Primitive.POINTS),
            )
            counted.append(
                (
                    drawing_device,
                    drawing_device.program(Colored),
                    image,
                    mesh,
                    drawing_device.occlusion_query(),
                    count,
                )
            )
        (a, pa, ia, ma, qa, na), (b, pb, ib, mb, qb, nb) = counted
        with a.render_pass(ia), b.render_pass(ib), qa, qb:
            a.draw(pa, ma.view(0, na))
            b.draw(pb, mb.view(0, nb))
        assert (qa.wait(), qb.wait()) == (na, nb)
        with a.render_pass(ia), b.render_pass(ib), qa, qb:
            for i in range(na):
                a.draw(pa, ma.view(i, 1))
                b.draw(pb, mb.view(i, 2))
            with rhi.create_device(backend):
                b.draw(pb, mb.view(0, 1))
            a.draw(pa, ma.view(0, 2))
        assert (qa.wait(), qb.wait()) == (na + 2, 2 * na + 1)
        with a.render_pass(ia), qa:  # and once more alone
            a.draw(pa, ma.view(0, 4))
        assert qa.wait() == 4
        for resource in (ia, ma, qa):
            resource.destroy()


# -- draws that aren't finished -----------------------------------------------------------------------------


class SlowlyLoaded(Loads):
    """Loads a texel and takes its time, so that the pass is still running when the next commands are
    issued."""

    def fragment(self, v: Shade) -> sl.vec4:
        color = self.source.load(sl.ivec2(sl.fragment_coordinate().xy))
        for _ in range(2000):
            color = color * 0.5 + v.color
        return color


class LoadedByVertices(Colored):
    """Loads its color from a texture in the vertex stage."""

    source: sl.Texture2D

    def vertex(self, v: Corner) -> Shade:
        return Shade(clip=v.position, color=self.source.load(sl.ivec2(3, 3)))


class LoadedByGroups(sl.Shader):
    """Stores a texel of a texture in a buffer."""

    source: sl.Texture2D
    texels: sl.StorageRW[sl.vec4]

    def compute(self) -> None:
        self.texels[0] = self.source.load(sl.ivec2(3, 3))


LARGE = (128, 128)


@pytest.fixture
def slow(device: Device) -> Iterator[Callable[[rhi.Texture], None]]:
    """Begin a pass that samples a texture and isn't finished for a while."""
    with device.texture(LARGE, Format.RGBA32F) as image, device.mesh(rectangle()) as mesh:

        def sample(texture: rhi.Texture) -> None:
            with device.render_pass(image):
                device.draw(device.program(SlowlyLoaded), mesh, source=texture)

        yield sample


def draw_color(device: Device, target: rhi.Texture, red: float, **passed: Any) -> None:
    """Draw `red` to each texel, as color or as depth, and then something else to another target."""
    rows = rectangle(depth=red, color=(red,) * 4)
    with device.mesh(rows) as mesh, device.texture((1, 1), Format.RGBA8) as other:
        if target.format.is_depth:
            with device.render_pass(depth=target), device.states(DepthFunction.ALWAYS):
                device.draw(device.program(Colored), mesh)
        else:
            with device.render_pass(target, **passed):
                device.draw(device.program(Colored), mesh)
        with device.render_pass(other):
            device.draw(device.program(Colored), mesh)


def read_by_copy(device: Device, texture: rhi.Texture) -> Any:
    with device.texture(LARGE, texture.format) as copy:
        texture.copy_to(copy)
        return copy.read()


def read_by_buffer(device: Device, texture: rhi.Texture) -> Any:
    with device.buffer(4 * LARGE[0] * LARGE[1]) as buffer:
        texture.copy_to_buffer(buffer)
        return np.frombuffer(buffer.read(), np.float32)


def read_by_vertices(device: Device, texture: rhi.Texture) -> Any:
    return draw_once(device, SIZE, Format.R32F, rectangle(), shader=LoadedByVertices, source=texture)


def read_by_dispatch(device: Device, texture: rhi.Texture) -> Any:
    with device.storage(sl.vec4, 1) as texels:
        device.dispatch(device.program(LoadedByGroups), 1, source=texture, texels=texels)
        return np.array(texels.read().tolist()).ravel()[0]


def read_by_indirect_dispatch(device: Device, texture: rhi.Texture) -> Any:
    with device.storage(sl.vec4, 1) as texels, device.buffer(np.ones(3, np.uint32)) as groups:
        program = device.program(LoadedByGroups)
        device.dispatch_indirect(program, groups, source=texture, texels=texels)
        return np.array(texels.read().tolist()).ravel()[0]


READS = [
    pytest.param(lambda _, texture: texture.read(), id="read"),
    pytest.param(lambda _, texture: texture.read_async().result(), id="asynchronous read"),
    pytest.param(read_by_copy, id="copy"),
    pytest.param(read_by_buffer, id="copy to a buffer", marks=pytest.mark.requires("texture_buffer_copies")),
    pytest.param(read_by_vertices, id="vertex stage"),
    pytest.param(read_by_dispatch, id="work group", marks=pytest.mark.requires("compute")),
    pytest.param(read_by_indirect_dispatch, id="indirect work group", marks=pytest.mark.requires("compute")),
]


@pytest.mark.requires("max_texture_slots")
@pytest.mark.parametrize("format", [Format.R32F, Format.D32F], ids=["color", "depth"])
@pytest.mark.parametrize("read", READS)
def test_a_read_sees_the_last_draw_while_an_older_pass_samples_the_texture(
    device: Device,
    slow: Callable[[rhi.Texture], None],
    read: Callable[[Device, rhi.Texture], Any],
    format: Format,
) -> None:
    with device.texture(LARGE, format) as texture:
        for red in (0.25, 0.5, 0.75):  # the first pass may wait for a compiler
            slow(texture)
            draw_color(device, texture, red)
            assert_same(read(device, texture), red)


@pytest.mark.requires("max_texture_slots")
def test_generated_levels_are_read_while_an_older_pass_samples_them(
    device: Device, slow: Callable[[rhi.Texture], None]
) -> None:
    with device.texture(LARGE, Format.R32F, levels=2) as texture:
        for red in (0.25, 0.5, 0.75):  # the first pass may wait for a compiler
            slow(texture)
            draw_color(device, texture, red)
            texture.generate_mipmaps()
            with device.texture((1, 1), Format.RGBA8) as other, device.render_pass(other, clear=(0, 0, 0, 0)):
                pass
            assert_same(texture.read(level=1), red)


@pytest.mark.requires("max_texture_slots")
def test_a_resolved_texture_is_read_while_an_older_pass_samples_it(
    device: Device, slow: Callable[[rhi.Texture], None]
) -> None:
    require_samples(device, 4)
    with (
        device.texture(LARGE, Format.R16F) as texture,
        device.texture(LARGE, Format.R16F, samples=4) as samples,
    ):
        for red in (0.25, 0.5, 0.75):  # the first pass may wait for a compiler
            slow(texture)
            draw_color(device, samples, red, resolve=texture)
            assert_same(texture.read(), red)


# -- reads that aren't finished -----------------------------------------------------------------------------


class ReadsLate(Colored):
    """Takes a while before it reads, so that the next commands are issued before."""

    def wait(self, zero: float) -> int:
        """Return 0, given 0."""
        waited = zero
        for _ in range(2000):
            waited = waited * 0.5 + 0.5 * zero
        return int(sl.min(waited, 0.0))


class ReadsElementLate(ReadsLate):
    """Loads an element of a buffer."""

    elements: sl.Storage[sl.vec4]

    def fragment(self, v: Shade) -> sl.vec4:
        return self.elements[self.wait(v.color.x)]


class ReadsTexelLate(ReadsLate):
    """Loads a texel."""

    source: sl.Texture2D

    def fragment(self, v: Shade) -> sl.vec4:
        return self.source.load(sl.ivec2(sl.fragment_coordinate().xy) + sl.ivec2(self.wait(v.color.x), 0))


class StoredByGroups(sl.Shader):
    """Stores 7 in the first element."""

    elements: sl.StorageRW[sl.vec4]

    def compute(self) -> None:
        self.elements[0] = sl.vec4(7.0)


class StoredByVertices(Colored):
    """Stores 7 in the first element, in the vertex stage."""

    elements: sl.StorageRW[sl.vec4]

    def vertex(self, v: Corner) -> Shade:
        self.elements[0] = sl.vec4(7.0)
        return Shade(clip=v.position, color=v.color)


class ImageFilled(sl.Shader):
    """Stores 7 in each texel."""

    target: sl.Image2D = sl.image(Format.R32F)

    def compute(self) -> None:
        self.target.store(sl.global_id().xy, sl.vec4(7.0))


BLACK = (0.0, 0.0, 0.0, 0.0)
SEVENS = np.full(4, 7, np.float32)


def write_elements(device: Device, elements: rhi.StorageBuffer[sl.vec4]) -> None:
    elements.owner.write(SEVENS)


def write_all_elements(device: Device, elements: rhi.StorageBuffer[sl.vec4]) -> None:
    elements.write(np.full((elements.count, 4), 7, np.float32))


def copy_elements(device: Device, elements: rhi.StorageBuffer[sl.vec4]) -> None:
    with device.buffer(SEVENS) as sevens:
        sevens.copy_to(elements.owner)


def clear_elements(device: Device, elements: rhi.StorageBuffer[sl.vec4]) -> None:
    elements.owner.clear(int(SEVENS.view(np.uint32)[0]))


def store_elements(device: Device, elements: rhi.StorageBuffer[sl.vec4]) -> None:
    device.dispatch(device.program(StoredByGroups), 1, elements=elements)


def store_elements_by_vertices(device: Device, elements: rhi.StorageBuffer[sl.vec4]) -> None:
    with device.texture((1, 1), Format.RGBA8) as other, device.mesh(rectangle()) as mesh:
        with device.render_pass(other):
            device.draw(device.program(StoredByVertices), mesh, elements=elements)


BUFFER_WRITES = [
    pytest.param(write_elements, 4, id="write"),
    pytest.param(write_all_elements, 4, id="write of all"),
    pytest.param(copy_elements, 4, id="copy"),
    pytest.param(clear_elements, 4, id="clear"),
    pytest.param(store_elements, 4, id="work group", marks=pytest.mark.requires("compute")),
    pytest.param(
        store_elements_by_vertices, 4, id="vertex stage", marks=pytest.mark.requires("vertex_writes")
    ),
    pytest.param(write_all_elements, 100_000, id="write of all of many"),
]


@pytest.mark.requires("max_storage_slots")
@pytest.mark.parametrize(("write", "count"), BUFFER_WRITES)
def test_a_buffer_is_written_after_an_older_pass_has_read_it(
    device: Device, write: Callable[[Device, rhi.StorageBuffer[sl.vec4]], None], count: int
) -> None:
    with (
        device.texture(LARGE, Format.R32F) as image,
        device.texture((1, 1), Format.RGBA8) as other,
        device.mesh(rectangle(color=BLACK)) as mesh,
    ):
        for _ in range(3):  # the first pass may wait for a compiler
            with device.storage(sl.vec4, count) as elements:
                with device.render_pass(image):
                    device.draw(device.program(ReadsElementLate), mesh, elements=elements)
                with device.render_pass(other, clear=BLACK):
                    pass
                write(device, elements)
                assert_same(image.read(), 0)
                assert np.asarray(elements.owner.read()).tobytes()[:16] == SEVENS.tobytes()


def write_texels(device: Device, texture: rhi.Texture) -> None:
    texture.write(np.full(LARGE, 7, np.float32))


def copy_texels(device: Device, texture: rhi.Texture) -> None:
    with device.texture(np.full(LARGE, 7, np.float32), Format.R32F) as sevens:
        sevens.copy_to(texture)


def store_texels(device: Device, texture: rhi.Texture) -> None:
    device.dispatch(device.program(ImageFilled), LARGE, target=texture.image())


TEXTURE_WRITES = [
    pytest.param(write_texels, id="write"),
    pytest.param(copy_texels, id="copy"),
    pytest.param(store_texels, id="work group", marks=pytest.mark.requires("max_image_slots")),
]


@pytest.mark.requires("max_texture_slots")
@pytest.mark.parametrize("write", TEXTURE_WRITES)
def test_a_texture_is_written_after_an_older_pass_has_sampled_it(
    device: Device, write: Callable[[Device, rhi.Texture], None]
) -> None:
    zeros = np.zeros(LARGE, np.float32)
    with (
        device.texture(LARGE, Format.R32F) as image,
        device.texture(zeros, Format.R32F) as texture,
        device.texture((1, 1), Format.RGBA8) as other,
        device.mesh(rectangle(color=BLACK)) as mesh,
    ):
        for _ in range(3):
            texture.write(zeros)
            with device.render_pass(image):
                device.draw(device.program(ReadsTexelLate), mesh, source=texture)
            with device.render_pass(other, clear=BLACK):
                pass
            write(device, texture)
            assert_same(image.read(), 0)
            assert_same(texture.read(), 7)
