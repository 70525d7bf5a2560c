"""Surfaces in one place: of those the one that is drawn last is seen, with every technique."""

from __future__ import annotations

from itertools import chain, islice
from typing import Any

import numpy as np
import pytest
from frames import draw_each, list_passes, max_difference, open_renderer, record
from nightly_reasons import FEWER_CASES, ONLY_KERNELS

import rhi
from renderer.content import BUILT_IN, load_scene
from renderer.frame.resources import SceneResources
from renderer.scene import Camera, Depth, Perspective, Scene, SceneBuilder, scaling
from renderer.techniques import TECHNIQUES, DeferredPlus, Forward, ForwardPlus, Inferred, Technique
from rhi.backends.null import NullBackend

RED, GREEN, BLUE = (1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)
EYE = Camera.look_at((1, 1, 3), (0, 0, 0))


def make_techniques() -> dict[str, Technique]:
    """Return all techniques, that of inferred lighting at full size."""
    return {name: Inferred(scale=1.0) if kind is Inferred else kind() for name, kind in TECHNIQUES.items()}


def stack_boxes(*colors: tuple[float, float, float], groups: bool = False) -> Scene:
    """Make boxes in one place, in the order in which they are drawn; with `groups`, each second one is
    mirrored."""
    builder = SceneBuilder("boxes in one place")
    mesh = builder.add_mesh(BUILT_IN["box"]())
    for number, color in enumerate(colors):
        mirrored = scaling((-1, 1, 1) if groups and number % 2 else (1, 1, 1))
        builder.add_objects(builder.add_node(mirrored), mesh, builder.add_material(base_color=color))
    builder.lights.add_point((2, 2, 3), 20.0, intensity=20.0)
    builder.lights.add_spot((0, 3, 3), (0, -1, -1), 20.0, 0.4, 0.9, intensity=20.0)
    builder.lights.add_directional((-0.3, -0.5, -1))
    return builder.build()


@pytest.mark.nightly_cases("cl-*", reason=ONLY_KERNELS)
@pytest.mark.parametrize("depth", list(Depth))
@pytest.mark.parametrize("colors", [(RED, GREEN), (GREEN, RED), (RED, GREEN, BLUE)])
def test_the_surface_that_is_drawn_last_is_seen_with_every_technique(
    drawing_device: rhi.Device, colors: tuple[tuple[float, float, float], ...], depth: Depth
) -> None:
    camera = EYE.with_projection(Perspective(depth=depth))
    techniques = make_techniques()
    images = draw_each(
        drawing_device, stack_boxes(*colors), *techniques.values(), camera=camera, size=(24, 24)
    )
    (alone,) = draw_each(drawing_device, stack_boxes(colors[-1]), Forward(), camera=camera, size=(24, 24))
    assert alone[12, 12, np.argmax(colors[-1])] > 100
    off = {name: max_difference(image, alone) for name, image in zip(techniques, images, strict=True)}
    assert max(off.values()) <= 1, off


@pytest.mark.nightly_cases("cl", reason=ONLY_KERNELS)
def test_surfaces_that_are_drawn_with_other_states_are_seen_alike_by_all_techniques(
    drawing_device: rhi.Device,
) -> None:
    techniques = make_techniques()
    scene = stack_boxes(RED, GREEN, BLUE, groups=True)
    first, *others = draw_each(drawing_device, scene, *techniques.values(), camera=EYE, size=(24, 24))
    assert max(max_difference(image, first) for image in others) <= 1


@pytest.mark.nightly_cases(reason=FEWER_CASES)
def test_every_technique_draws_the_same_bazaar(gl: rhi.Device) -> None:
    # Its stalls touch: up to 79 levels, in 30 to 462 pixels at 960 x 540, where each pass with EQUAL shaded
    # both.
    scene, techniques = load_scene("bazaar"), make_techniques()
    for view in scene.views.values():
        camera = view.with_aspect(16 / 9)
        images = draw_each(gl, scene, *techniques.values(), camera=camera, size=(320, 180))
        for technique, image in zip(techniques.values(), images, strict=True):
            # Deferred+ filters textures by stored derivatives, through maps of normals.
            most, count = (12, 40) if isinstance(technique, DeferredPlus) else (1, 0)
            off = np.abs(image - images[0]).max(2)
            assert off.max() <= most, (technique.name, view)
            assert (off > 1).sum() <= count, (technique.name, view)


@pytest.mark.parametrize(
    ("name", "passes", "draws"),
    [
        ("forward", 1, 1),
        ("forward_multipass", 4, 4),
        ("light_pre_pass", 4, 4),
        ("light_indexed", 3, 3),
        ("forward_plus", 2, 2),
        ("clustered", 1, 1),
    ],
)
def test_surfaces_in_one_place_take_no_pass_and_no_draw_of_their_own(
    null: rhi.Device, name: str, passes: int, draws: int
) -> None:
    for scene in (stack_boxes(RED), stack_boxes(RED, GREEN, BLUE)):
        stream = record(null, scene, make_techniques()[name], EYE)
        assert len(stream.filter(rhi.Op.BEGIN_PASS)) == passes
        assert len(stream.draws()) == draws


def test_a_second_pass_draws_objects_in_the_order_of_the_first_one_whatever_their_batches(
    null: rhi.Device, monkeypatch: pytest.MonkeyPatch
) -> None:
    null.backend_as(NullBackend).answer_queries(100)
    city = load_scene("city:blocks=6")
    drawn: dict[int, list[list[int]]] = {}
    real = SceneResources.draw_objects

    def draw_objects(
        self: SceneResources, device: rhi.Device, program: Any, bindings: Any, rows: Any, *others: Any
    ) -> None:
        drawn.setdefault(id(program), []).append(rows.tolist())
        real(self, device, program, bindings, rows, *others)

    monkeypatch.setattr(SceneResources, "draw_objects", draw_objects)
    with open_renderer(null, city, ForwardPlus(), visibility="chc") as renderer:
        for frame in (560, 580, 600):
            drawn.clear()
            renderer.render(city.paths["ground"].camera(frame))
    depth, lit = drawn.values()
    assert len(depth) > len(lit)  # batches that follow each other are one draw
    assert list(chain.from_iterable(depth)) == list(chain.from_iterable(lit))


@pytest.mark.nightly_cases("cl", reason=ONLY_KERNELS)
def test_an_object_that_glass_covers_is_lit_in_full_by_inferred_lighting_at_full_size(
    drawing_device: rhi.Device,
) -> None:
    scene = load_scene("glass")
    for view in islice(scene.views.values(), 2):
        camera = view.with_aspect(16 / 9)
        expected, full, part = draw_each(
            drawing_device,
            scene,
            Forward(),
            Inferred(scale=1.0),
            Inferred(scale=0.99),
            camera=camera,
            size=(160, 90),
        )
        assert max_difference(full, expected) <= 2
        assert max_difference(part, expected) > 16  # the control: there, glass takes texels
    assert "stipple" in list_passes(drawing_device, scene, Inferred(scale=0.99))
    assert "stipple" not in list_passes(drawing_device, scene, Inferred(scale=1.0))
