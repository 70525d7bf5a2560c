"""Arguments and attributes of a renderer: names, and values of other types."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
from frames import list_owned
from hypothesis import given, settings
from hypothesis import strategies as st

import rhi
from renderer.content import load_scene
from renderer.renderer import Renderer
from renderer.scene import Scene
from renderer.techniques import TECHNIQUES, AutoTechnique, Clustered, Forward
from renderer.visibility import FrustumCulling, NoCulling
from rhi import Op, ValidationError

ATTRIBUTES = (
    "technique",
    "visibility",
    "blending",
    "precision",
    "bloom",
    "occlusion",
    "depth_of_field",
    "temporal",
    "environment",
    "light_component",
    "stereo",
)
ARGUMENTS = (*(name for name in ATTRIBUTES if name != "stereo"), "textures", "uploads")
TIMELINE = {Op.SIGNAL, Op.WAIT}
"""What depends on how fast the GPU is."""
WRONG = st.one_of(
    st.integers(),
    st.floats(),
    st.booleans(),
    st.binary(),
    st.just(object()),
    st.lists(st.integers()),
    st.just(dict),
)


@pytest.fixture(scope="module")
def hall() -> Scene:
    return load_scene("hall:lights=4,shadows=0")


@pytest.fixture(scope="module")
def renderer(hall: Scene) -> Iterator[Renderer]:
    with rhi.create_device("null") as device, Renderer(device, hall, size=(16, 9)) as renderer:
        yield renderer


def draw(scene: Scene, **arguments: Any) -> list[tuple[Op, tuple[Any, ...]]]:
    """Commands of two frames of a renderer with these arguments."""
    with rhi.create_device("null") as device, Renderer(device, scene, size=(32, 18), **arguments) as renderer:
        for frame in range(2):
            renderer.render(next(iter(scene.paths.values())).camera(frame))
        return [(command.op, command.values) for command in device.stream if command.op not in TIMELINE]


@pytest.mark.parametrize("name", TECHNIQUES)
def test_a_named_technique_draws_as_its_object(hall: Scene, name: str) -> None:
    assert draw(hall, technique=name, visibility="frustum") == draw(
        hall, technique=TECHNIQUES[name](), visibility="frustum"
    )


def test_other_techniques_draw_otherwise(hall: Scene) -> None:
    # The control: the comparison above sees which technique draws.
    assert draw(hall, technique="clustered", visibility="frustum") != draw(hall, visibility="frustum")


def test_auto_names_the_technique_that_measures(renderer: Renderer) -> None:
    renderer.technique = "auto"
    assert isinstance(renderer.technique, AutoTechnique)
    renderer.technique = None
    assert isinstance(renderer.technique, Forward)


def test_a_technique_is_exchanged_by_its_name_between_frames(hall: Scene, renderer: Renderer) -> None:
    renderer.technique = "clustered"
    assert isinstance(renderer.technique, Clustered)
    camera = next(iter(hall.paths.values())).camera(0)
    assert renderer.render(camera).image.size == (16, 9)


def test_a_visibility_algorithm_is_exchanged_by_its_name_and_created_once(renderer: Renderer) -> None:
    renderer.visibility = "none"
    first = renderer.visibility
    renderer.visibility = "frustum"
    assert isinstance(first, NoCulling)
    assert isinstance(renderer.visibility, FrustumCulling)
    renderer.visibility = "none"
    assert renderer.visibility is first


@pytest.mark.parametrize("name", ["technique", "visibility"])
def test_a_misspelt_name_is_refused_with_the_nearest(renderer: Renderer, name: str) -> None:
    before = getattr(renderer, name)
    text = {"technique": "clusterd", "visibility": "frustrum"}[name]
    with pytest.raises(ValidationError) as refusal:
        setattr(renderer, name, text)
    assert refusal.value.given == text
    assert {"technique": "clustered", "visibility": "frustum"}[name] in refusal.value.tip
    assert getattr(renderer, name) is before


@pytest.mark.parametrize("name", ["blending", "precision"])
def test_a_text_in_place_of_a_member_is_refused_with_the_member(renderer: Renderer, name: str) -> None:
    text, member = {"blending": ("weighted", "Blending.WEIGHTED"), "precision": ("exact", "Precision.EXACT")}[
        name
    ]
    with pytest.raises(ValidationError, match=r"renderer-attribute") as refusal:
        setattr(renderer, name, text)
    assert member in refusal.value.tip


@pytest.mark.parametrize("name", ATTRIBUTES)
@settings(max_examples=12)
@given(value=WRONG)
def test_an_attribute_refuses_other_types_and_keeps_its_value(
    renderer: Renderer, name: str, value: Any
) -> None:
    before = getattr(renderer, name)
    with pytest.raises(ValidationError) as refusal:
        setattr(renderer, name, value)
    assert refusal.value.rule.id == "renderer-attribute"
    assert f"Renderer.{name}" in refusal.value.call
    assert getattr(renderer, name) is before
    setattr(renderer, name, before)  # the control: its own type is accepted


@pytest.mark.parametrize("name", ARGUMENTS)
@settings(max_examples=6)
@given(value=WRONG)
def test_an_argument_of_another_type_is_refused_and_leaves_nothing_behind(
    hall: Scene, name: str, value: Any
) -> None:
    with rhi.create_device("null") as device:
        with pytest.raises(ValidationError) as refusal:
            Renderer(device, hall, size=(16, 9), **{name: value})
        assert f"Renderer({name}=...)" in refusal.value.call
        assert list_owned(device)[1] == []


@pytest.mark.parametrize("value", [None, 3, "city", np.zeros(3), Forward])
def test_device_scene_and_camera_are_refused_by_name(hall: Scene, renderer: Renderer, value: Any) -> None:
    with pytest.raises(ValidationError, match="device"):
        Renderer(value, hall)
    with pytest.raises(ValidationError, match="scene"):
        Renderer(renderer.device, value)
    with pytest.raises(ValidationError, match="camera"):
        renderer.render(value)


def test_a_class_in_place_of_its_object_is_refused_with_the_way_to_create_it(renderer: Renderer) -> None:
    with pytest.raises(ValidationError) as refusal:
        renderer.technique = Forward  # type: ignore[assignment]
    assert "Forward(…)" in refusal.value.tip


def test_a_refusal_names_the_line_of_the_caller(renderer: Renderer) -> None:
    with pytest.raises(ValidationError) as refusal:
        renderer.blending = "sorted"  # type: ignore[assignment]
    assert refusal.value.site is not None
    assert refusal.value.site.file == __file__
