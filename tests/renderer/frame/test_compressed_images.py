"""Compressed images: their formats, bytes and errors, and when they are left as they are."""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from frames import make_boxes, record
from hypothesis import given
from hypothesis import strategies as st
from nightly_reasons import ONLY_KERNELS
from numpy.typing import NDArray

import rhi
from renderer.content import ImportOptions, load_model, load_scene, save_scene
from renderer.content.compression import compress_image
from renderer.frame import TextureSettings
from renderer.frame.scene_images import SceneImages, count_bytes
from renderer.frame.uploads import UploadSettings
from renderer.lab.exam.image_cases import make_block_scene
from renderer.lab.exam.ray_traced_cases import SIZE
from renderer.lab.exam.scenes import make_camera
from renderer.renderer import Renderer
from renderer.scene import Compression, ImageBlocks, Scene, TextureMap
from rhi import CompressedFormat, Format, SamplerDescriptor, ValidationError
from rhi.backends.null.null_capabilities import get_profile

CAMERA = make_camera((0.2, 0.15, 2.4), (0.05, 0.0, 0.0))
BC7 = TextureSettings(compression=Compression.BC7)
ERRORS = {"BC1": (5.6, 40.0), "BC3": (5.6, 40.0), "BC5": (0.3, 2.0), "BC7": (1.2, 13.0)}
"""The mean and the largest error in levels of an image whose channels differ, a fifth above what was measured."""


@pytest.fixture(name="stores_blocks")
def make_device_with_blocks() -> Any:
    """A null device that stores blocks as they are."""
    formats = frozenset(CompressedFormat)
    profile = replace(get_profile("everything"), compressed_formats=formats)
    with rhi.create_device("null", profile=profile) as device:
        yield device


def paint(width: int, height: int, seed: int = 0, alpha: int = 255) -> NDArray[np.uint8]:
    """Paint a smooth image with an edge through it."""
    y, x = np.mgrid[0:height, 0:width]
    waves = [np.sin(0.05 * (k + 1) * x + 0.07 * y + k + seed) * 60 + 120 + 40 * (x > y) for k in range(3)]
    image = np.full((height, width, 4), alpha, np.uint8)
    image[..., :3] = np.round(np.stack(waves, axis=-1))
    return image


def paint_normals(width: int, height: int) -> NDArray[np.uint8]:
    """Paint unit normals."""
    y, x = np.mgrid[0:height, 0:width]
    vectors = np.stack([0.4 * np.sin(0.1 * x), 0.4 * np.cos(0.07 * y), np.ones((height, width))], axis=-1)
    vectors /= np.linalg.norm(vectors, axis=-1, keepdims=True)
    image = np.full((height, width, 4), 255, np.uint8)
    image[..., :3] = np.round((vectors * 0.5 + 0.5) * 255.0)
    return image


def make_scene(color: NDArray[Any], normals: NDArray[Any] | None = None) -> Scene:
    """Make a box with a colour image, and a normal map."""
    builder = make_boxes()
    values: dict[str, Any] = {"texture": builder.add_image(color)}
    if normals is not None:
        values["normal_texture"] = builder.add_image(normals)
    builder.add_objects(builder.add_node(), 0, builder.add_material(**values))
    builder.lights.add_directional((-0.3, -0.5, -1.0))
    return builder.build()


def list_formats(images: SceneImages) -> list[Any]:
    return [texture.compressed for texture in images.textures]


@pytest.mark.parametrize("name", ERRORS)
@pytest.mark.parametrize("size", [(64, 48), (50, 31)])
def test_the_error_of_a_format_is_small(name: str, size: tuple[int, int]) -> None:
    pytest.importorskip("etcpak")
    pixels = paint_normals(*size) if name == "BC5" else paint(*size, alpha=128 if name == "BC3" else 255)
    blocks = compress_image(pixels, CompressedFormat[name])
    off = np.abs(blocks.decode().astype(float) - pixels)[..., : 2 if name == "BC5" else 3]
    mean, largest = ERRORS[name]
    assert off.mean() < mean
    assert off.max() < largest
    assert blocks.bytes == count_bytes(size, CompressedFormat[name])


def test_levels_are_means_in_linear_light() -> None:
    pytest.importorskip("etcpak")
    checks = np.full((8, 8, 4), 255, np.uint8)
    checks[..., :3] = np.where((np.indices((8, 8)).sum(axis=0) % 2)[..., None], 255, 0)
    blocks = compress_image(checks, CompressedFormat.BC7_SRGB)
    assert len(blocks.levels) == 4
    smaller = ImageBlocks(blocks.format, (4, 4), blocks.levels[1:]).decode()
    assert np.abs(smaller[..., :3].astype(int) - 188).max() <= 1  # sRGB of 0.5
    data = compress_image(checks, CompressedFormat.BC7)
    assert (
        np.abs(ImageBlocks(data.format, (4, 4), data.levels[1:]).decode()[..., :3].astype(int) - 128).max()
        <= 1
    )


@pytest.mark.parametrize(("width", "height"), [(7, 4), (5, 9), (8, 3), (13, 1)])
def test_a_texel_of_a_level_is_the_mean_of_its_area(width: int, height: int) -> None:
    """Against texels that are repeated until both sizes divide them; BC7 is off by up to 3 levels on a ramp."""
    pytest.importorskip("etcpak")
    y, x = np.mgrid[0:height, 0:width]
    pixels = np.full((height, width, 4), 255, np.uint8)
    pixels[..., :3] = (10 + 12 * x + 8 * y)[..., None]
    smaller = max(width // 2, 1), max(height // 2, 1)
    fine = pixels.astype(float).repeat(smaller[1], 0).repeat(smaller[0], 1)
    expected = fine.reshape(smaller[1], height, smaller[0], width, 4).mean(axis=(1, 3))
    blocks = compress_image(pixels, CompressedFormat.BC7)
    level = ImageBlocks(blocks.format, smaller, blocks.levels[1:]).decode()
    assert np.abs(level - expected).max() <= 3.0


def test_normals_have_unit_length_in_each_level() -> None:
    """Halves that lean by 53° to either side and up: their mean (0, 0.48, 0.64) is 0.8 long, and (0, 0.6, 0.8) as a
    unit vector, which is 204 in green; without its length it would be 189."""
    pytest.importorskip("etcpak")
    pixels = np.full((8, 8, 4), 255, np.uint8)
    for column, x in ((0, 0.6), (1, -0.6)):
        vector = np.array((x, 0.48, 0.64))
        pixels[:, column::2, :3] = np.round((vector * 0.5 + 0.5) * 255.0)
    blocks = compress_image(pixels, CompressedFormat.BC5)
    smaller = ImageBlocks(blocks.format, (4, 4), blocks.levels[1:]).decode()
    assert np.abs(smaller[..., :2].astype(int) - (128, 204)).max() <= 1


@given(st.integers(1, 40), st.integers(1, 40), st.sampled_from(sorted(ERRORS)))
def test_images_of_any_size_have_blocks_for_all_levels(width: int, height: int, name: str) -> None:
    pytest.importorskip("etcpak")
    blocks = compress_image(paint(width, height), CompressedFormat[name])
    assert len(blocks.levels) == max(width, height).bit_length()
    assert blocks.bytes == count_bytes((width, height), CompressedFormat[name])
    assert blocks.decode().shape == (height, width, 4)


def test_a_device_stores_a_quarter_or_an_eighth_of_the_bytes(stores_blocks: rhi.Device) -> None:
    pytest.importorskip("etcpak")
    scene = make_scene(paint(64, 64), paint_normals(64, 64))
    plain, bc7 = SceneImages(stores_blocks, scene), SceneImages(stores_blocks, scene, BC7)
    bc1 = SceneImages(stores_blocks, scene, TextureSettings(compression=Compression.BC1))
    assert list_formats(plain) == [None, None]
    assert list_formats(bc7) == [CompressedFormat.BC7_SRGB, CompressedFormat.BC5]
    assert list_formats(bc1) == [CompressedFormat.BC1_SRGB, CompressedFormat.BC5]
    assert bc7.bytes == bc7.image_bytes == 2 * (4096 + 1024 + 256 + 64 + 16 + 16 + 16)
    assert bc1.bytes == bc7.bytes // 4 * 3
    assert plain.bytes == 2 * count_bytes((64, 64))
    assert bc7.has_two_channels
    assert not plain.has_two_channels


def test_an_image_with_alpha_has_bc3(stores_blocks: rhi.Device) -> None:
    pytest.importorskip("etcpak")
    images = SceneImages(
        stores_blocks, make_scene(paint(16, 16, alpha=90)), TextureSettings(compression=Compression.BC1)
    )
    assert list_formats(images) == [CompressedFormat.BC3_SRGB]


def test_a_normal_map_that_another_map_reads_too_keeps_three_channels(stores_blocks: rhi.Device) -> None:
    pytest.importorskip("etcpak")
    builder = make_boxes()
    shared, alone = (builder.add_image(paint_normals(8, side)) for side in (8, 12))
    materials = (
        builder.add_material(normal_texture=shared, occlusion_texture=shared),
        builder.add_material(normal_texture=alone),
    )
    for material in materials:
        builder.add_objects(builder.add_node(), 0, material)
    images = SceneImages(stores_blocks, builder.build(), BC7)
    assert list_formats(images) == [CompressedFormat.BC7, CompressedFormat.BC5]


def test_a_device_that_decodes_blocks_gets_pixels_and_needs_no_package(
    null: rhi.Device, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "etcpak", None)
    images = SceneImages(null, make_scene(paint(16, 16), paint_normals(16, 16)), BC7)
    assert [texture.format for texture in images.textures] == [Format.RGBA8_SRGB, Format.RGBA8]
    assert list_formats(images) == [None, None]


def test_a_missing_package_is_named(stores_blocks: rhi.Device, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "etcpak", None)
    with pytest.raises(ValidationError, match=r'texture-settings(.|\n)*pip install "rhi\[compression\]"'):
        SceneImages(stores_blocks, make_scene(paint(16, 16)), BC7)
    with pytest.raises(ValidationError, match=r'scene-bad-import(.|\n)*pip install "rhi\[compression\]"'):
        ImportOptions(compress=Compression.BC7)


def test_images_in_a_table_and_of_high_range_stay_as_they_are(stores_blocks: rhi.Device) -> None:
    pytest.importorskip("etcpak")
    builder = make_boxes()
    image = builder.add_image(paint(16, 16))
    for number in range(10):
        texture = TextureMap(image, sampler=SamplerDescriptor(max_anisotropy=1.0 + number))
        builder.add_objects(builder.add_node(), 0, builder.add_material(texture=texture))
    images = SceneImages(stores_blocks, builder.build(), BC7)
    assert images.tables is not None
    assert not images.has_two_channels
    light = make_scene(np.full((8, 8, 3), 0.5, np.float16))
    assert [texture.format for texture in SceneImages(stores_blocks, light, BC7).textures] == [Format.RGBA16F]


def test_a_frame_with_compressed_images_has_the_commands_of_one_without(gl: rhi.Device) -> None:
    pytest.importorskip("etcpak")
    scene = make_scene(paint(64, 64), paint_normals(64, 64))
    plain = record(gl, scene)
    packed = record(gl, scene, textures=BC7)
    draws = [[command.op for command in stream] for stream in (plain, packed)]
    assert draws[0] == draws[1]
    assert any("DRAW" in op.name for op in draws[0])


@pytest.mark.nightly_cases("cl*", reason=ONLY_KERNELS)
def test_a_frame_with_compressed_images_is_near_the_one_without(drawing_device: rhi.Device) -> None:
    """BC7 is off by less than a level in the mean, BC1 by less than three: the errors of formats above."""
    pytest.importorskip("etcpak")
    scene = make_scene(paint(64, 50), paint_normals(64, 50))
    camera = make_camera((0.4, 0.3, 1.8), (0.0, 0.0, 0.0))
    levels = {}
    for compression in Compression:
        settings = TextureSettings(compression=compression)
        with Renderer(drawing_device, scene, size=SIZE, textures=settings) as renderer:
            levels[compression] = renderer.render(camera).image.read()[..., :3].astype(float)
    off = {name: np.abs(image - levels[Compression.NONE]).mean() for name, image in levels.items()}
    if drawing_device.capabilities.compressed_formats:
        assert 0.0 < off[Compression.BC7] < 1.0
        assert off[Compression.BC7] < off[Compression.BC1] < 3.0
    else:
        assert off[Compression.BC1] == off[Compression.BC7] == 0.0
    assert levels[Compression.NONE].std() > 20.0


def test_uploads_over_many_frames_end_in_the_same_image(gl: rhi.Device) -> None:
    with Renderer(gl, make_block_scene(is_reference=False), size=SIZE) as renderer:
        expected = renderer.render(CAMERA).image.read()
    with Renderer(gl, make_block_scene(is_reference=False), size=SIZE, uploads=UploadSettings()) as renderer:
        while not renderer.uploads.is_done:
            renderer.render(CAMERA)
        assert np.array_equal(renderer.render(CAMERA).image.read(), expected)
    assert expected[..., :3].std() > 20.0


def test_uploads_of_blocks_stay_within_their_budget(gl: rhi.Device) -> None:
    builder = make_boxes()
    blocks = [np.zeros((256 >> level, 512 >> level, 16), np.uint8) for level in range(3)]
    image = builder.add_image(ImageBlocks(CompressedFormat.BC7, (2048, 1024), tuple(blocks)))
    builder.add_objects(builder.add_node(), 0, builder.add_material(texture=image))
    settings = UploadSettings(1 << 18)
    with Renderer(gl, builder.build(), size=SIZE, uploads=settings) as renderer:
        written = []
        while not renderer.uploads.is_done:
            before = gl.statistics.upload_bytes
            renderer.render(CAMERA)
            written.append(gl.statistics.upload_bytes - before)
        assert renderer.images.textures[0].levels == 3
    total = sum(level.nbytes for level in blocks)
    assert max(written) <= settings.bytes_per_frame + 20_000  # tables and constants
    assert sum(written) >= total
    assert len(written) >= total / settings.bytes_per_frame


def test_blocks_of_a_level_that_takes_many_frames_are_where_they_belong(gl: rhi.Device) -> None:
    def make_wall() -> Scene:
        rng, builder = np.random.default_rng(3), make_boxes()
        ends = np.zeros((256, 256, 8), np.uint8)
        ends[..., :4] = rng.integers(0, 256, (8, 8, 4)).repeat(32, 0).repeat(32, 1)
        image = builder.add_image(ImageBlocks(CompressedFormat.BC1, (1024, 1024), (ends,)))
        builder.add_objects(builder.add_node(), 0, builder.add_material(texture=image))
        builder.lights.add_directional((-0.4, -0.6, -1.0))
        return builder.build()

    with Renderer(gl, make_wall(), size=SIZE) as renderer:
        expected = renderer.render(CAMERA).image.read()
    with Renderer(gl, make_wall(), size=SIZE, uploads=UploadSettings(1 << 18)) as renderer:
        frames = 0
        while not renderer.uploads.is_done:
            renderer.render(CAMERA)
            frames += 1
        assert frames > 2
        assert np.array_equal(renderer.render(CAMERA).image.read(), expected)
    assert expected[..., :3].std() > 20.0


def test_an_import_option_compresses_the_images_of_a_file(tmp_path: Path, stores_blocks: rhi.Device) -> None:
    pytest.importorskip("etcpak")
    path = tmp_path / "wall.glb"
    save_scene(make_scene(paint(32, 16), paint_normals(16, 16)), path)
    plain = load_model(path)
    scene = load_model(path, options=ImportOptions(compress=Compression.BC7))
    assert plain.blocks == {}
    assert [scene.blocks[image].format for image in (0, 1)] == [
        CompressedFormat.BC7_SRGB,
        CompressedFormat.BC5,
    ]
    assert np.array_equal(scene.images[0], plain.images[0])
    assert list_formats(SceneImages(stores_blocks, scene)) == [
        CompressedFormat.BC7_SRGB,
        CompressedFormat.BC5,
    ]
    assert load_scene(f"{path}:compress=bc1").blocks[0].format is CompressedFormat.BC1_SRGB
    with pytest.raises(ValidationError, match=r"scene-bad-import(.|\n)*none, bc1, bc7"):
        load_scene(f"{path}:compress=bc2")
    with pytest.raises(ValidationError, match="scene-bad-import"):
        ImportOptions(compress="bc7")  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("format", "size", "shapes"),
    [
        (CompressedFormat.BC5_SNORM, (4, 4), [(1, 1, 16)]),
        (CompressedFormat.BC7, (0, 4), [(1, 1, 16)]),
        (CompressedFormat.BC7, (4, 4), []),
        (CompressedFormat.BC7, (4, 4), [(1, 1, 16)] * 4),
        (CompressedFormat.BC7, (5, 4), [(1, 1, 16)]),
        (CompressedFormat.BC1, (4, 4), [(1, 1, 16)]),
    ],
)
def test_blocks_that_fit_no_image_are_refused(
    format: CompressedFormat, size: tuple[int, int], shapes: list[tuple[int, ...]]
) -> None:
    with pytest.raises(ValidationError, match="scene-bad-image"):
        ImageBlocks(format, size, tuple(np.zeros(shape, np.uint8) for shape in shapes))
    ImageBlocks(CompressedFormat.BC7, (4, 4), (np.zeros((1, 1, 16), np.uint8),) * 3)
