"""The features of materials, counted again where materials change."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from frames import make_boxes
from hypothesis import given
from hypothesis import strategies as st

import rhi
from renderer.content import BUILT_IN
from renderer.renderer import Renderer
from renderer.scene import TEXTURE, AlphaMode, Scene, SceneBuilder, TextureMap, make_material
from renderer.scene.features import MaterialFeatures
from renderer.techniques import TECHNIQUES
from renderer.visibility import NoCulling
from rhi import SamplerDescriptor, Wrap

SAMPLERS = (SamplerDescriptor(), SamplerDescriptor(wrap_u=Wrap.CLAMP))
COUNT = 7


def make_textures() -> np.ndarray[Any, Any]:
    """Make four textures of three images: plain, by the second uv, transformed, and clamped."""
    textures = np.zeros(4, TEXTURE)
    textures["image"] = 0, 1, 2, 2
    textures["transform"] = np.eye(2, 3)
    textures["uv_set"][1] = 1
    textures["transform"][2, 0, 0] = 2.0
    textures["sampler"][3] = 1
    return textures


def count_from_scratch(materials: np.ndarray[Any, Any]) -> dict[str, int]:
    return dict(MaterialFeatures(materials, make_textures(), SAMPLERS, ()).counts)


CHANGES = st.tuples(
    st.integers(0, COUNT - 1),
    st.sampled_from(
        [
            ("base_color", 0.5),
            ("emission", 0.0),
            ("emission", 1.0),
            ("emissive", 0.0),
            ("emissive", 2.0),
            ("texture", -1),
            ("texture", 0),
            ("texture", 1),
            ("normal_texture", 2),
            ("normal_texture", -1),
            ("metallic_roughness_texture", 3),
            ("occlusion_texture", 1),
            ("emissive_texture", 0),
            ("light_map_texture", 1),
            ("light_map_texture", -1),
            ("model", 0),
            ("model", 1),
            ("alpha_mode", 0),
            ("alpha_mode", 1),
            ("double_sided", 0),
            ("double_sided", 1),
        ]
    ),
)


@given(st.lists(st.lists(CHANGES, max_size=5), max_size=4))
def test_feature_counts_after_changes_equal_counts_from_scratch(
    steps: list[list[tuple[int, Any]]],
) -> None:
    materials = np.array([make_material()] * COUNT)
    features = MaterialFeatures(materials, make_textures(), SAMPLERS, ())
    for changes in steps:
        for row, (name, value) in changes:
            materials[name][row] = value
        features.refresh(materials)
        assert features.counts == count_from_scratch(materials)


@pytest.mark.parametrize("count", [COUNT - 2, COUNT + 3])
def test_an_array_of_another_length_is_counted_from_scratch(count: int) -> None:
    features = MaterialFeatures(np.array([make_material()] * COUNT), make_textures(), SAMPLERS, ())
    others = np.array([make_material(emission=2.0, texture=0)] * count)
    features.refresh(others)
    assert features.counts == count_from_scratch(others)
    assert (features.version, len(features.kinds)) == (1, count)
    others["emission"][1] = 0.0
    features.refresh(others)
    assert features.counts == count_from_scratch(others)
    assert features.version == 2


@pytest.mark.parametrize("technique", ["forward", "deferred_plus"])
def test_materials_may_be_replaced_by_more_but_not_by_fewer_than_objects_have(technique: str) -> None:
    builder = make_boxes((0, 0, 0), base_color=(1.0, 0.0, 0.0))
    builder.add_objects(builder.add_node(), 0, builder.add_material(base_color=(0.0, 0.0, 1.0)))
    scene = builder.build()
    camera, before = scene.views["eye"], scene.materials
    with rhi.create_device("null") as null:
        renderer = Renderer(
            null, scene, technique=TECHNIQUES[technique](), visibility=NoCulling(scene), size=(16, 16)
        )
        with renderer:
            renderer.render(camera)
            scene.materials = np.concatenate([before, [make_material(emission=1.0)]])
            renderer.render(camera)
            assert len(renderer.resources.materials) == 3
            assert scene.count_features()["emission"] == 1
            scene.materials = before[:1]
            with pytest.raises(rhi.ValidationError, match=r"^\[scene-bad-index\]"):
                renderer.render(camera)
            scene.materials = before
            renderer.render(camera)
            assert scene.count_features()["emission"] == 0


def test_a_version_is_another_only_when_materials_have_changed() -> None:
    materials = np.array([make_material()] * COUNT)
    features = MaterialFeatures(materials, make_textures(), SAMPLERS, ())
    versions = []
    for strength in (0.0, 1.0, 1.0, 2.0):
        materials["emission"][3] = strength
        features.refresh(materials)
        versions.append(features.version)
    assert versions == [0, 1, 1, 2]


def test_only_materials_that_have_changed_are_examined(monkeypatch: pytest.MonkeyPatch) -> None:
    examined: list[int] = []
    examine = MaterialFeatures._examine

    def note(self: MaterialFeatures, materials: np.ndarray[Any, Any]) -> Any:
        examined.append(len(materials))
        return examine(self, materials)

    monkeypatch.setattr(MaterialFeatures, "_examine", note)
    materials = np.array([make_material()] * 65_536)
    features = MaterialFeatures(materials, make_textures(), SAMPLERS, ())
    features.refresh(materials)
    materials["alpha_mode"][[3, 65_535]] = AlphaMode.MASK
    materials["base_color"][[3, 65_535], 3] = 0.2  # below the cutoff
    features.refresh(materials)
    assert examined == [65_536, 2]
    assert features.counts["masks"] == 2


def build(**material: Any) -> Scene:
    builder = make_boxes()
    builder.add_image(np.full((4, 4, 4), 128, np.uint8))
    builder.add_objects(builder.add_node(), 0, builder.add_material(**material))
    return builder.build()


@pytest.mark.parametrize(("other", "mixed"), [({}, 0), ({"uv_set": 1}, 1), ({"scale": (2.0, 2.0)}, 1)])
def test_textures_that_are_read_at_unlike_coordinates_are_counted(other: dict[str, Any], mixed: int) -> None:
    scene = build(texture=TextureMap(0), normal_texture=TextureMap(0, **other))
    assert scene.count_features()["mixed coordinates"] == mixed


def test_a_scene_counts_again_when_it_is_refreshed() -> None:
    scene = build(texture=TextureMap(0, uv_set=1))
    assert (scene.count_features()["second uvs"], scene.count_features()["images"]) == (1, 1)
    scene.materials["texture"] = -1
    scene.refresh()
    assert (scene.count_features()["second uvs"], scene.count_features()["images"]) == (0, 0)


def test_a_scene_finds_transparent_objects_again_when_it_is_refreshed() -> None:
    scene = build()
    assert scene.list_transparent().tolist() == []
    scene.materials["alpha_mode"] = AlphaMode.BLEND
    scene.refresh()
    assert scene.list_transparent().tolist() == [], "alpha is 1"
    scene.materials["base_color"][:, 3] = 0.5
    scene.refresh()
    assert scene.list_transparent().tolist() == [0]


@pytest.mark.parametrize(
    ("field", "feature", "channels"),
    [
        ("texture", "images", (0, 1, 2)),
        ("emissive_texture", "emissive maps", (0, 1, 2)),
        ("occlusion_texture", "occlusion maps", (0,)),
        ("metallic_roughness_texture", "roughness maps", (1, 2)),
    ],
)
def test_a_texture_that_is_white_in_the_channels_that_are_read_is_no_feature(
    field: str, feature: str, channels: tuple[int, ...]
) -> None:
    values: dict[str, Any] = {"emissive": (2.0, 2.0, 2.0)}
    if feature == "roughness maps":
        values |= {"metallic": 1.0, "roughness": 0.5}
    white = np.zeros((4, 4, 4), np.uint8)
    white[..., channels] = 255
    assert build_textured(field, white, **values)[feature] == 0
    for channel in channels:
        spotted = white.copy()
        spotted[3, 2, channel] = 254
        assert build_textured(field, spotted, **values)[feature] == 1, "control: one texel differs"


def test_the_alpha_of_a_white_texture_is_read_where_it_cuts() -> None:
    holes = np.full((4, 4, 4), 255, np.uint8)
    assert build_textured("texture", holes, alpha_mode=AlphaMode.MASK)["images"] == 0
    holes[1, 1, 3] = 0
    assert build_textured("texture", holes, alpha_mode=AlphaMode.MASK)["images"] == 1
    assert build_textured("texture", holes)["images"] == 0, "control: an opaque material has no alpha"


def build_textured(field: str, pixels: np.ndarray[Any, Any], **values: Any) -> dict[str, int]:
    """The features of a scene with a box whose material has an image in a field."""
    builder = SceneBuilder("textured")
    mesh = builder.add_mesh(BUILT_IN["box"]())
    material = builder.add_material(**{field: builder.add_image(pixels)}, **values)
    builder.add_objects(builder.add_node(), mesh, material)
    return dict(builder.build().count_features())
