"""Materials with parents and with shaders of their own: what they inherit, and what is refused."""

from __future__ import annotations

from typing import Any, ClassVar

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from refusals import refused_rule

import rhi.shading as sl
from renderer.content import BUILT_IN
from renderer.scene import Scene, SceneBuilder, TextureMap
from renderer.scene.material_instances import MAX_SHADERS
from renderer.shaders import MaterialShader
from rhi import ValidationError

PIXELS = np.full((4, 4, 4), 128, np.uint8)


class StripeParameters(sl.Struct):
    """Parameters of each kind."""

    width: float
    tint: sl.vec3
    count: int
    map: int


class Stripes(MaterialShader):
    parameter_defaults: ClassVar = {"tint": (1.0, 0.5, 0.0), "count": 3}
    parameter_textures: ClassVar = {"map": False}

    parameters: sl.Storage[StripeParameters]


class Plain(MaterialShader):
    """A shader without parameters."""


def start() -> SceneBuilder:
    builder = SceneBuilder("instances")
    builder.add_image(PIXELS)
    return builder


def build(builder: SceneBuilder, *materials: int) -> Scene:
    mesh = builder.add_mesh(BUILT_IN["box"]())
    for material in materials:
        builder.add_objects(builder.add_node(), mesh, material)
    return builder.build()


def read(scene: Scene, material: int) -> dict[str, Any]:
    row = scene.parameters[0][material]
    return {"width": float(row["width"]), "tint": row["tint"][:3].tolist(), "count": int(row["count"])}


def test_an_instance_has_its_parents_values_where_it_sets_none() -> None:
    builder = start()
    parent = builder.add_material(shader=Stripes, base_color=(0.25, 0.5, 0.75), width=0.5, count=7)
    child = builder.add_material(parent=parent, width=2.0, shininess=64.0)
    grandchild = builder.add_material(parent=child, tint=(0, 1, 0))
    scene = build(builder, parent, child, grandchild)
    assert [read(scene, material) for material in (parent, child, grandchild)] == [
        {"width": 0.5, "tint": [1.0, 0.5, 0.0], "count": 7},
        {"width": 2.0, "tint": [1.0, 0.5, 0.0], "count": 7},
        {"width": 2.0, "tint": [0.0, 1.0, 0.0], "count": 7},
    ]
    assert scene.materials["shader"].tolist() == [1, 1, 1]
    assert scene.materials["shininess"].tolist() == [32.0, 64.0, 64.0]
    assert (scene.materials["base_color"][:, :3] == (0.25, 0.5, 0.75)).all()
    assert scene.parameters[0]["map"].tolist() == [-1, -1, -1]
    assert scene.get_material_values(child) == {"width": 2.0, "shininess": 64.0}


def test_a_changed_parent_material_changes_the_instances_that_inherit_the_parameter() -> None:
    builder = start()
    parent = builder.add_material(shader=Stripes, width=0.5)
    child, inheriting = builder.add_material(parent=parent), builder.add_material(parent=parent, width=3.0)
    other = builder.add_material()
    scene = build(builder, parent, child, inheriting, other)
    version = scene.material_version
    scene.set_material(parent, width=1.5, base_color=(1, 0, 0))
    assert [read(scene, material)["width"] for material in (parent, child, inheriting)] == [1.5, 1.5, 3.0]
    assert scene.materials["base_color"][:, 0].tolist() == [1.0, 1.0, 1.0, np.float32(0.8)]
    scene.refresh()
    assert scene.material_version > version
    scene.unset_material(inheriting, "width")
    assert read(scene, inheriting)["width"] == 1.5
    scene.unset_material(parent, "base_color")
    assert (scene.materials["base_color"][:, 0] == np.float32(0.8)).all()


def test_values_that_were_written_to_arrays_stay_where_nothing_else_is_set() -> None:
    builder = start()
    parent = builder.add_material()
    child = builder.add_material(parent=parent)
    scene = build(builder, parent, child)
    scene.materials["emission"][child] = 5.0
    scene.set_material(parent, shininess=8.0)
    assert scene.materials["emission"].tolist() == [0.0, 5.0]
    assert scene.materials["shininess"].tolist() == [8.0, 8.0]


@settings(max_examples=60)
@given(st.integers(0, 10**6))
def test_random_edits_equal_values_that_are_looked_up_from_the_root(seed: int) -> None:
    """Beside the tree itself, all that is known here is a dictionary for each material."""
    rng = np.random.default_rng(seed)
    builder, parents, changes = start(), [-1], [{"width": 1.0}]
    builder.add_material(shader=Stripes, width=1.0)
    for row in range(1, 8):
        parents.append(int(rng.integers(0, row)))
        changes.append({})
        builder.add_material(parent=parents[row])
    scene = build(builder, *range(8))
    for _ in range(12):
        row, name = int(rng.integers(8)), str(rng.choice(["width", "count", "shininess"]))
        if name in changes[row] and rng.random() < 0.5 and (row or name != "width"):
            scene.unset_material(row, name)
            del changes[row][name]
        else:
            changes[row][name] = int(rng.integers(1, 99))
            scene.set_material(row, **{name: changes[row][name]})
    for row in range(8):
        values, at = {"count": 3, "shininess": 32.0}, row
        chain = [row]
        while (at := parents[at]) >= 0:
            chain.append(at)
        for ancestor in reversed(chain):
            values |= changes[ancestor]
        read_values = read(scene, row)
        assert (read_values["width"], read_values["count"]) == (values["width"], values["count"])
        assert scene.materials["shininess"][row] == values["shininess"]


WRONG: dict[str, dict[str, Any]] = {
    "a parameter of another name": {"wdth": 1.0},
    "a parameter that is needed": {},
    "a text": {"width": "wide"},
    "a fraction for a whole number": {"width": 1.0, "count": 1.5},
    "two numbers for three": {"width": 1.0, "tint": (1, 2)},
    "not a number": {"width": float("nan")},
    "a base colour that is out of its range": {"width": 1.0, "base_color": (-1, 0, 0)},
}


@pytest.mark.parametrize("values", WRONG.values(), ids=WRONG)
def test_wrong_values_are_refused_and_nothing_is_added(values: dict[str, Any]) -> None:
    builder = start()
    assert refused_rule(lambda: builder.add_material(shader=Stripes, **values)) == "scene-bad-material"
    right = builder.add_material(shader=Stripes, width=1.0)
    assert right == 0
    scene = build(builder, right)
    assert len(scene.shaders) == 1
    before = scene.materials.tobytes(), scene.parameters[0].tobytes()
    if values:
        assert refused_rule(lambda: scene.set_material(0, **values)) == "scene-bad-material"
    assert refused_rule(lambda: scene.unset_material(0, "width")) == "scene-bad-material"
    assert refused_rule(lambda: scene.unset_material(0, "tint")) == "scene-bad-material"
    assert (scene.materials.tobytes(), scene.parameters[0].tobytes()) == before
    assert scene.get_material_values(0) == {"width": 1.0}


def test_a_wrong_name_suggests_the_right_one() -> None:
    with pytest.raises(ValidationError, match="did you mean 'width'"):
        start().add_material(shader=Stripes, widht=1.0)


def test_a_parent_refuses_parameters_that_conflict_with_those_of_an_instance() -> None:
    """Parameters of both models can't be mixed."""
    builder = start()
    parent = builder.add_material()
    child = builder.add_material(parent=parent, shininess=8.0)
    scene = build(builder, parent, child)
    before = scene.materials.tobytes()
    assert refused_rule(lambda: scene.set_material(parent, metallic=1.0)) == "scene-bad-material"
    assert scene.materials.tobytes() == before
    scene.unset_material(child, "shininess")
    scene.set_material(parent, metallic=1.0)
    assert scene.materials["model"].tolist() == [1, 1]


class Alien(sl.Shader):
    """No shader of a material."""


class Misnamed(MaterialShader):
    parameter_defaults: ClassVar = {"size": 1.0}


class Hidden(sl.Struct):
    """A parameter that all materials have."""

    shininess: float


class Hiding(MaterialShader):
    parameters: sl.Storage[Hidden]


@pytest.mark.parametrize("shader", [Alien, Misnamed, Hiding, "Stripes", MaterialShader.describe])
def test_a_class_that_is_not_a_material_shader_is_refused(shader: Any) -> None:
    assert refused_rule(lambda: start().add_material(shader=shader)) == "scene-bad-material"
    start().add_material(shader=Plain)


def test_an_instance_has_its_parents_shader() -> None:
    builder = start()
    parent, plain = builder.add_material(shader=Stripes, width=1.0), builder.add_material()
    builder.add_material(parent=parent, shader=Stripes)
    assert refused_rule(lambda: builder.add_material(parent=parent, shader=Plain)) == "scene-bad-material"
    assert refused_rule(lambda: builder.add_material(parent=plain, shader=Plain)) == "scene-bad-material"
    assert refused_rule(lambda: builder.add_material(parent=7)) == "scene-bad-index"


def test_a_scene_has_as_many_shaders_as_lists_have_parts_and_no_more() -> None:
    builder = start()
    shaders = [type(f"Made{number}", (Plain,), {"__module__": __name__}) for number in range(MAX_SHADERS + 1)]
    for shader in shaders[:-1]:
        builder.add_material(shader=shader)
    builder.add_material(shader=shaders[0])
    assert refused_rule(lambda: builder.add_material(shader=shaders[-1])) == "scene-bad-material"


def test_textures_of_shaders_are_read_as_they_are() -> None:
    builder = start()
    plain = builder.add_material(shader=Stripes, width=1.0, map=0, texture=TextureMap(0))
    moved = TextureMap(0, offset=(0.5, 0.0))
    for name in ("map", "texture"):
        call = lambda name=name: builder.add_material(shader=Stripes, width=1.0, **{name: moved})  # noqa: E731
        assert refused_rule(call) == "scene-bad-material"
    assert refused_rule(lambda: builder.add_material(shader=Stripes, width=1.0, map=9)) == "scene-bad-index"
    builder.add_material(texture=moved)
    scene = build(builder, plain)
    row = int(scene.parameters[0]["map"][plain])
    assert not scene.textures["is_color"][row]
    assert scene.textures["is_color"][scene.materials["texture"][plain]]
    assert refused_rule(lambda: scene.set_material(plain, texture=row)) == "scene-bad-index"
    scene.set_material(plain, map=-1)
    assert scene.parameters[0]["map"][plain] == -1
    assert refused_rule(lambda: scene.set_material(plain, normal_texture=row)) == "scene-no-tangents"


def test_bytes_between_parameters_are_no_edit_in_each_frame() -> None:
    builder = start()
    scene = build(builder, builder.add_material(shader=Stripes, width=0.5))
    scene.parameters[0].view(np.uint8).reshape(len(scene.materials), -1)[:, 4:16] = (
        7  # a copy of the array has others
    )
    scene.refresh()
    version = scene.material_version
    scene.refresh()
    assert scene.material_version == version
    scene.parameters[0]["width"] = 0.6
    scene.refresh()
    assert scene.material_version == version + 1
