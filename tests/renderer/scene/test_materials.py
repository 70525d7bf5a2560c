"""Materials of both models, and the textures that they refer to."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from refusals import refused_rule

from renderer import scene as scenes
from renderer.content import BUILT_IN
from renderer.scene import (
    Scene,
    SceneBuilder,
    ShadingModel,
    TextureMap,
    make_geometry,
    make_material,
    vertex_format,
)
from rhi import Comparison, SamplerDescriptor, Wrap

SIDE = np.full((4, 4, 4), 128, np.uint8)
SQUARE = {
    "positions": [[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]],
    "indices": [0, 1, 2, 0, 2, 3],
    "uv": [[0, 1], [1, 1], [1, 0], [0, 0]],
}


def build(geometry: Any = None, images: int = 2, **material: Any) -> Scene:
    builder = SceneBuilder("box")
    for _ in range(images):
        builder.add_image(SIDE)
    mesh = builder.add_mesh(geometry or BUILT_IN["box"]())
    builder.add_objects(builder.add_node(), mesh, builder.add_material(**material))
    return builder.build()


@pytest.mark.parametrize(
    ("parameters", "model"),
    [
        ({}, ShadingModel.SPECULAR),
        ({"shininess": 3.0, "emission": 1.0, "normal_texture": 0}, ShadingModel.SPECULAR),
        ({"metallic": 0.0}, ShadingModel.METALLIC_ROUGHNESS),
        ({"roughness": 0.5}, ShadingModel.METALLIC_ROUGHNESS),
        ({"metallic_roughness_texture": 1}, ShadingModel.METALLIC_ROUGHNESS),
    ],
)
def test_the_parameters_of_a_material_select_its_shading_model(
    parameters: dict[str, Any], model: ShadingModel
) -> None:
    assert make_material(**parameters)["model"] == model


def test_a_metallic_roughness_texture_is_multiplied_with_1_by_default() -> None:
    material = make_material(metallic_roughness_texture=0)
    assert (material["metallic"], material["roughness"]) == (1.0, 1.0)


@pytest.mark.parametrize("name", ["specular_color", "shininess", "rim_strength", "rim_power"])
def test_parameters_of_both_models_are_refused(name: str) -> None:
    value = (0.5, 0.5, 0.5) if name == "specular_color" else 1.0
    assert make_material(**{name: value})["model"] == ShadingModel.SPECULAR
    assert refused_rule(lambda: make_material(**{name: value}, metallic=0.5)) == "scene-bad-material"


@pytest.mark.parametrize(
    ("name", "good", "bad"),
    [
        ("metallic", 1.0, 1.1),
        ("roughness", 0.0, -0.1),
        ("occlusion_strength", 0.0, 2.0),
        ("normal_scale", -2.0, np.nan),
        ("alpha_cutoff", 0.0, -0.1),
        ("emissive", (0, 1e6, 0), (0, -1, 0)),
        ("emissive_texture", -1, -2),
        ("alpha_mode", scenes.AlphaMode.BLEND, 3),
        ("base_color", (1, 0, 0, 1), (1, 2)),
        ("base_color", (1, 0, 0, 1), (1, -0.1, 0)),
        ("base_color", (1, 0, 0, 1), (np.nan, 0, 0)),
        ("shininess", 1.0, 0.5),
        ("rim_power", 0.1, 0.0),
        ("emission", 1e6, np.inf),
        ("texture", -1, -2),
    ],
)
def test_values_out_of_range_are_refused(name: str, good: Any, bad: Any) -> None:
    assert make_material(**{name: good})[name].tolist() == pytest.approx(np.asarray(good).tolist())
    assert refused_rule(lambda: make_material(**{name: bad})) == "scene-bad-material"


def test_each_way_to_read_an_image_is_one_texture() -> None:
    clamped = SamplerDescriptor(wrap_u=Wrap.CLAMP, wrap_v=Wrap.CLAMP)
    builder = SceneBuilder("boxes")
    images = [builder.add_image(SIDE.copy()) for _ in range(2)]
    mesh, node = builder.add_mesh(BUILT_IN["box"]()), builder.add_node()
    arguments: list[dict[str, Any]] = [
        {"texture": images[1]},
        {"texture": TextureMap(images[1])},  # the same
        {
            "texture": TextureMap(images[1], sampler=clamped),
            "occlusion_texture": images[1],
        },  # as a colour, and as data
        {"texture": TextureMap(images[1], scale=(2.0, 2.0)), "emissive_texture": images[0]},
    ]
    for values in arguments:
        builder.add_objects(node, mesh, builder.add_material(**values))
    scene = builder.build()
    assert scene.materials["texture"].tolist() == [0, 0, 1, 3]
    assert scene.materials["occlusion_texture"].tolist() == [-1, -1, 2, -1]
    assert scene.materials["emissive_texture"].tolist() == [-1, -1, -1, 4]
    assert scene.textures["image"].tolist() == [1, 1, 1, 1, 0]
    assert scene.textures["is_color"].tolist() == [1, 1, 0, 1, 1]
    assert [scene.samplers[row] for row in scene.textures["sampler"]] == [
        SamplerDescriptor(),
        clamped,
        *[SamplerDescriptor()] * 3,
    ]


@pytest.mark.parametrize("name", ["texture", "normal_texture", "emissive_texture"])
def test_a_texture_of_an_unknown_image_is_refused(name: str) -> None:
    assert len(build(images=1, **{name: 0}).textures) == 1
    assert refused_rule(lambda: build(images=1, **{name: 1})) == "scene-bad-index"
    assert refused_rule(lambda: build(images=1, **{name: TextureMap(-2)})) == "scene-bad-index"


@pytest.mark.parametrize(
    "values",
    [{"uv_set": 2}, {"scale": (np.inf, 1.0)}, {"sampler": SamplerDescriptor(compare=Comparison.LESS)}],
)
def test_a_bad_texture_map_is_refused(values: dict[str, Any]) -> None:
    assert refused_rule(lambda: TextureMap(0, **values)) == "scene-bad-material"


def test_texture_coordinates_are_scaled_then_rotated_then_moved() -> None:
    texture = TextureMap(0, offset=(0.25, 0.5), rotation=np.pi / 2, scale=(2.0, 4.0))
    # A quarter turn that is counter-clockwise on an image, whose v counts down: u becomes -v.
    assert texture.transform @ (1.0, 0.0, 1.0) == pytest.approx([0.25, 0.5 - 2.0])
    assert texture.transform @ (0.0, 1.0, 1.0) == pytest.approx([0.25 + 4.0, 0.5])


def test_vertices_have_only_the_attributes_that_the_scene_reads() -> None:
    more = {"uv2": np.ones((4, 2)), "tangent": np.tile([1.0, 0, 0, 1], (4, 1)), "color": np.ones((4, 4))}
    geometry = make_geometry(**SQUARE, **more)
    assert geometry.vertices.dtype == vertex_format(more)
    assert build().meshes.vertices.dtype == scenes.VERTEX
    assert build(geometry).meshes.vertices.dtype == vertex_format(["color"])
    assert build(geometry, texture=TextureMap(0, uv_set=1)).meshes.vertices.dtype == vertex_format(
        ["uv2", "color"]
    )
    assert build(geometry, normal_texture=0).meshes.vertices.dtype == vertex_format(["tangent", "color"])


def test_meshes_without_an_attribute_that_others_have_get_its_neutral_value() -> None:
    builder = SceneBuilder("two")
    material = builder.add_material()
    for geometry in (make_geometry(**SQUARE), make_geometry(**SQUARE, color=np.full((4, 4), 0.5))):
        builder.add_objects(builder.add_node(), builder.add_mesh(geometry), material)
    color = builder.build().meshes.vertices["color"]
    assert color[:4].tolist() == [[1.0] * 4] * 4
    assert color[4:].tolist() == [[0.5] * 4] * 4


def test_a_normal_texture_makes_tangents_along_its_texture_coordinates() -> None:
    square = make_geometry(**SQUARE, uv2=[[0, 0], [0, 1], [1, 1], [1, 0]])
    along_uv = build(square, normal_texture=0).meshes.vertices["tangent"]
    along_uv2 = build(square, normal_texture=TextureMap(0, uv_set=1)).meshes.vertices["tangent"]
    assert along_uv.tolist() == [[1.0, 0.0, 0.0, 1.0]] * 4
    assert along_uv2.tolist() == [[0.0, 1.0, 0.0, 1.0]] * 4


def test_explicit_tangents_are_unchanged() -> None:
    tangents = np.tile([0.6, 0.8, 0.0, -1.0], (4, 1))
    built = build(make_geometry(**SQUARE, tangent=tangents), normal_texture=0).meshes.vertices["tangent"]
    np.testing.assert_allclose(built, tangents, atol=1e-7)


def test_a_mirrored_mesh_has_mirrored_tangents() -> None:
    geometry = make_geometry(**SQUARE, tangent=np.tile([1.0, 0, 0, 1], (4, 1)))
    turned = geometry.transformed(np.diag([-2.0, 1.0, 1.0, 1.0])).vertices
    assert turned["tangent"].tolist() == [[-1.0, 0.0, 0.0, -1.0]] * 4


def test_unknown_attributes_are_refused() -> None:
    assert refused_rule(lambda: vertex_format(["bones"])) == "scene-bad-mesh"


@given(st.lists(st.sampled_from(["uv2", "tangent", "color"]), unique=True))
def test_the_order_of_attributes_does_not_change_a_vertex_format(names: list[str]) -> None:
    assert vertex_format(names) == vertex_format(sorted(names))
