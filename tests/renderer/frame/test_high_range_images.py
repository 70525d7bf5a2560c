"""Images of high range in materials: what is accepted, what they take, and what is seen."""

from __future__ import annotations

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
from renderer.content import load_model, save_scene
from renderer.content.limits import ModelLimits
from renderer.frame.scene_images import SceneImages, count_bytes
from renderer.frame.uploads import UploadSettings
from renderer.lab.exam.image_cases import make_screen_scene, paint_light
from renderer.lab.exam.ray_traced_cases import SIZE, trace_image
from renderer.lab.exam.scenes import make_camera
from renderer.renderer import Renderer
from renderer.scene import Bloom, Scene, SceneBuilder
from renderer.scene.images import make_likeness
from renderer.techniques import TECHNIQUES
from renderer.techniques.parts.geometry_buffer import decode_bright_texel, encode_bright_texel
from rhi import Format, ValidationError
from rhi.shading import evaluate
from rhi.trace import load, replay, save

CAMERA = make_camera((0.3, 0.3, 2.2), (0.0, 0.1, 0.0))
GREY = np.full((4, 4, 4), 128, np.uint8)


def make_light(value: float, dtype: Any = np.float32, shape: tuple[int, ...] = (4, 4, 4)) -> NDArray[Any]:
    """Make an image of ones with one texel of this value."""
    image = np.ones(shape, dtype)
    image[1, 2, 0] = value
    return image


@pytest.mark.parametrize("dtype", [np.float16, np.float32])
@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf, -1e-3])
def test_a_texel_that_is_no_light_is_refused(dtype: Any, value: float) -> None:
    with pytest.raises(ValidationError, match=r"scene-bad-image(.|\n)*a texel of(.|\n)*replace such texels"):
        SceneBuilder("bad").add_image(make_light(value, dtype))


def test_the_largest_float16_is_accepted_and_anything_above_is_refused_with_the_way_round_it() -> None:
    builder = SceneBuilder("bright")
    builder.add_image(make_light(65504.0))
    with pytest.raises(ValidationError, match=r"0 to 65,504(.|\n)*raise the material's `emissive`"):
        builder.add_image(make_light(65505.0))


@pytest.mark.parametrize("alpha", [1.01, -0.1, np.nan])
def test_alpha_of_high_range_is_a_share(alpha: float) -> None:
    image = make_light(2.0)
    image[0, 0, 3] = alpha
    with pytest.raises(ValidationError, match="scene-bad-image"):
        SceneBuilder("bad").add_image(image)


@pytest.mark.parametrize(
    "image",
    [
        np.zeros((4, 4, 2), np.float32),
        np.zeros((4, 4), np.float16),
        np.zeros((0, 4, 4), np.float32),
        np.zeros((4, 4, 4)),
        np.zeros((4, 4, 3), np.uint8),
        [[0.0]],
    ],
)
def test_other_shapes_and_types_are_refused(image: Any) -> None:
    with pytest.raises(ValidationError, match="scene-bad-image"):
        SceneBuilder("bad").add_image(image)


def test_light_without_alpha_is_stored_as_float16_that_covers_all() -> None:
    builder = make_boxes((0, 0, 0))
    builder.add_image(make_light(3.5, np.float32, (4, 5, 3)))
    (image,) = builder.build().images
    assert image.dtype == np.float16
    assert image.shape == (4, 5, 4)
    assert image[1, 2].tolist() == [3.5, 1.0, 1.0, 1.0]


@pytest.mark.parametrize(
    "name", ["texture", "normal_texture", "occlusion_texture", "metallic_roughness_texture"]
)
def test_only_emitted_and_baked_light_is_brighter_than_one(name: str) -> None:
    builder = SceneBuilder("bright")
    bright, bounded = builder.add_image(make_light(1.5)), builder.add_image(make_light(1.0))
    builder.add_material(emissive_texture=bright, light_map_texture=bright)
    builder.add_material(**{name: bounded})
    with pytest.raises(ValidationError, match=r"scene-bad-material(.|\n)*light maps are brighter"):
        builder.add_material(**{name: bright})


def make_shown(*images: NDArray[Any]) -> Scene:
    """Make boxes that emit these images."""
    builder = make_boxes()
    for image in images:
        material = builder.add_material(emissive=(1.0, 1.0, 1.0), emissive_texture=builder.add_image(image))
        builder.add_objects(builder.add_node(), 0, material)
    return builder.build()


def test_an_image_of_high_range_takes_8_bytes_a_texel_and_leaves_the_others_as_they_are(
    null: rhi.Device,
) -> None:
    mixed = SceneImages(null, make_shown(GREY, make_light(2.0)))
    alone = SceneImages(null, make_shown(GREY))
    assert [texture.format for texture in mixed.textures] == [Format.RGBA8_SRGB, Format.RGBA16F]
    assert mixed.bytes == mixed.image_bytes == count_bytes((4, 4)) + count_bytes((4, 4), Format.RGBA16F)
    assert mixed.bytes == 3 * alone.bytes
    assert mixed.has_bright_texels
    assert not alone.has_bright_texels


def test_a_frame_with_an_image_of_high_range_has_the_commands_of_one_with_8_bits(null: rhi.Device) -> None:
    plain, bright = (
        [command.op for command in record(null, make_shown(image))] for image in (GREY, make_light(2.0))
    )
    assert plain == bright


def test_a_texture_table_with_an_image_of_high_range_is_all_of_that_format(null: rhi.Device) -> None:
    scene = make_screen_scene(40.0, 0.1, plain_sizes=10)
    images = SceneImages(null, scene)
    assert images.tables is not None
    assert [table.format for table in images.tables if table is not None] == [Format.RGBA16F]
    plain = make_shown(*(np.full((4, 3 + number, 4), 9, np.uint8) for number in range(10)))
    tables = SceneImages(null, plain).tables
    assert tables is not None
    assert [table.format for table in tables if table is not None] == [Format.RGBA8_SRGB]


@given(st.floats(2.0**-15, 65000.0, width=32))
def test_a_geometry_buffer_stores_light_within_one_and_a_half_percent(light: float) -> None:
    """A code of 1/32 octave is off by at most 1/64: 1.09 %; and codes end at 2^15.97."""
    color = np.array([light, 0.0, 1.0], np.float32)
    red, green, blue = np.asarray(
        evaluate(decode_bright_texel, evaluate(encode_bright_texel, color))
    ).tolist()
    assert abs(red / light - 1.0) < 0.015
    assert (green, blue) == (0.0, 1.0)


@pytest.mark.nightly_cases("cl*", reason=ONLY_KERNELS)
@pytest.mark.parametrize("technique", sorted(TECHNIQUES))
def test_every_technique_shows_the_light_of_an_image(drawing_device: rhi.Device, technique: str) -> None:
    """Against rays in float64; 1.6 levels: rounding of a pixel, and a geometry buffer's 1.1 % of light. Inferred
    lighting mixes the light of neighbours: 2.1."""
    scene = make_screen_scene(40.0, 0.1)
    traced = trace_image(scene, CAMERA, SIZE)
    with Renderer(drawing_device, scene, technique=TECHNIQUES[technique](), size=SIZE) as renderer:
        levels = (
            renderer.render(CAMERA.with_aspect(SIZE[0] / SIZE[1])).image.read()[..., :3].astype(np.float64)
        )
    off = np.maximum(traced.low - levels, levels - traced.high).max(axis=2)[traced.is_smooth]
    assert off.max() < (3.0 if technique == "inferred" else 1.6)
    assert traced.levels.max() > 240.0  # what an image of 8 bits can't emit: 0.1 is level 95
    assert traced.is_smooth.mean() > 0.5


def test_bloom_spreads_the_light_above_one(gl: rhi.Device) -> None:
    def sum_halo(brightest: float) -> float:
        scene = make_screen_scene(brightest, 1.0)
        scene.bloom = Bloom(0.2)
        with Renderer(gl, scene, size=SIZE) as renderer:
            image = renderer.render(CAMERA).image.read().astype(np.float64)
        return float(image[:, :4, :3].sum())  # beside the screen

    assert sum_halo(40.0) > 1.1 * sum_halo(1.0)


def test_a_faint_material_with_a_bright_image_is_among_those_that_bloom() -> None:
    bright, faint = make_screen_scene(6e4, 5e-5), make_screen_scene(1.0, 5e-5)
    assert len(bright.list_emitters()) == 1
    assert len(faint.list_emitters()) == 0
    assert bright.count_features()["emissive maps"] == 1
    assert faint.count_features()["emissive maps"] == 0


def test_an_image_of_high_range_that_is_one_everywhere_is_left_out() -> None:
    ones, bright = make_shown(np.ones((4, 4, 3), np.float32)), make_shown(make_light(2.0))
    assert ones.count_features()["emissive maps"] == 0
    assert bright.count_features()["emissive maps"] == 1


@pytest.mark.parametrize("plain_sizes", [0, 10])
def test_uploads_over_many_frames_end_in_the_same_image(gl: rhi.Device, plain_sizes: int) -> None:
    def make_scene() -> Scene:
        return make_screen_scene(40.0, 0.1, plain_sizes)

    with Renderer(gl, make_scene(), size=SIZE) as renderer:
        expected = renderer.render(CAMERA).image.read()
    with Renderer(gl, make_scene(), size=SIZE, uploads=UploadSettings()) as renderer:
        while not renderer.uploads.is_done:
            renderer.render(CAMERA)
        assert np.array_equal(renderer.render(CAMERA).image.read(), expected)


def test_an_upload_of_a_large_image_of_high_range_stays_within_its_budget(null: rhi.Device) -> None:
    settings = UploadSettings(1 << 18)
    scene = make_shown(np.full((512, 256, 3), 2.0, np.float32))
    with Renderer(null, scene, size=SIZE, uploads=settings) as renderer:
        written = []
        while not renderer.uploads.is_done:
            before = null.statistics.upload_bytes
            renderer.render(CAMERA)
            written.append(null.statistics.upload_bytes - before)
    assert max(written) <= settings.bytes_per_frame + 20_000  # tables and constants
    assert sum(written) >= 512 * 256 * 8


@pytest.mark.parametrize("suffix", [".glb", ".gltf"])
def test_a_saved_scene_has_the_same_texels_and_a_likeness_for_others(tmp_path: Path, suffix: str) -> None:
    scene = make_screen_scene(6e4, 5e-5)
    path = tmp_path / f"screen{suffix}"
    assert save_scene(scene, path) == ()
    (image,) = load_model(path).images
    assert image.dtype == np.float16
    assert np.array_equal(image, scene.images[0])
    if suffix == ".gltf":
        text = path.read_text(encoding="utf-8")
        assert text.count('"image/png"') == 1
        path.write_text(text.replace('"texels"', '"other"'), encoding="utf-8")
        with pytest.raises(ValidationError, match="texels"):
            load_model(path)


def test_a_likeness_is_cut_at_one() -> None:
    light = np.array([[[0.5, 40.0, 0.0, 0.5]]], np.float16)
    assert make_likeness(light, is_color=True).tolist() == [[[188, 255, 0, 128]]]
    assert make_likeness(light, is_color=False).tolist() == [[[128, 255, 0, 128]]]
    assert make_likeness(GREY, is_color=True) is GREY


@pytest.mark.parametrize("size", ["[4, 7]", "[0, 0]", "[100000, 100000]", '["a", 1]', "[-4, -6]"])
def test_a_file_with_another_size_of_its_texels_is_refused(tmp_path: Path, size: str) -> None:
    path = tmp_path / "screen.gltf"
    save_scene(make_screen_scene(40.0, 0.1), path)
    text = path.read_text(encoding="utf-8")
    assert '"size": [4, 6]' in text
    path.write_text(text.replace('"size": [4, 6]', f'"size": {size}'), encoding="utf-8")
    with pytest.raises(ValidationError, match=r"scene-unreadable-model|scene-model-limit"):
        load_model(path)


def test_a_file_with_texels_that_are_no_numbers_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "screen.glb"
    scene = make_screen_scene(40.0, 0.1)
    save_scene(scene, path)
    texels = scene.images[0].tobytes()
    content = path.read_bytes()
    assert content.count(texels) == 1
    path.write_bytes(content.replace(texels, np.full(len(texels) // 2, np.nan, np.float16).tobytes()))
    with pytest.raises(ValidationError, match="scene-unreadable-model"):
        load_model(path)


def test_an_image_of_radiance_is_read_from_a_gltf_file(tmp_path: Path) -> None:
    path = tmp_path / "screen.gltf"
    save_scene(make_screen_scene(1.0, 1.0), path)
    header = b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y 2 +X 3\n"
    (tmp_path / "light.hdr").write_bytes(header + bytes((100, 50, 25, 131)) * 6)
    text = path.read_text(encoding="utf-8")
    begin, end = text.index('"images": ['), text.index("]", text.index('"mimeType"'))
    end = text.index("}]", text.index('"size"')) + 2
    path.write_text(text[:begin] + '"images": [{"uri": "light.hdr"}]' + text[end:], encoding="utf-8")
    (image,) = load_model(path).images
    assert image.shape == (2, 3, 4)
    assert image.dtype == np.float16
    assert image[1, 2].tolist() == pytest.approx([100.5 / 32, 50.5 / 32, 25.5 / 32, 1.0], rel=1e-3)
    with pytest.raises(ValidationError, match="scene-model-limit"):
        load_model(path, ModelLimits(pixels=40))
    (tmp_path / "light.hdr").write_bytes(header + bytes((100, 50, 25)))
    broken = load_model(path)
    assert broken.images == ()
    assert "an image that can't be read" in str(broken.omissions[0])


def test_a_trace_recorded_without_a_device_replays_the_light(tmp_path: Path, gl: rhi.Device) -> None:
    def draw(device: rhi.Device) -> NDArray[Any] | None:
        with Renderer(device, make_screen_scene(40.0, 0.1), size=SIZE) as renderer:
            image = renderer.render(CAMERA).image
            return image.read() if device.capabilities.shading else None

    with rhi.create_device("null") as null:
        draw(null)
        save(null, tmp_path / "screen.zip")
    with rhi.create_device("gl") as fresh:
        replayed = replay(load(tmp_path / "screen.zip", trusted=True), on=fresh).image
    expected = draw(gl)
    assert replayed is not None
    assert expected is not None
    assert np.array_equal(replayed, expected)
    assert expected[..., :3].max() > 240


def test_the_painted_light_is_above_one() -> None:
    assert paint_light(40.0).max() == 40.0
