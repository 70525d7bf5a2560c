"""Frames in which only the camera moves skip what would change nothing. Their commands, to the byte, are those of
a renderer that skips nothing, whatever is edited between two frames."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Any, Final

import numpy as np
import pytest
from frames import SIZE, open_renderer, read_colors
from refusals import refused_rule
from test_reused_renderer import EDITS, Random, make

import rhi
from renderer.content import load_scene
from renderer.frame import (
    Blending,
    BloomSettings,
    DepthOfFieldSettings,
    Effect,
    Frame,
    OcclusionSettings,
    TemporalSettings,
)
from renderer.renderer import Renderer
from renderer.scene import (
    AmbientOcclusion,
    Bloom,
    Camera,
    Depth,
    DepthOfField,
    Environment,
    Fog,
    Lights,
    Orthographic,
    Perspective,
    Projection,
    Scene,
    StereoRig,
    translation,
)
from renderer.stereo import Stereo
from renderer.techniques import TECHNIQUES
from renderer.visibility import AutoCulling, make_visibility
from renderer.visibility.algorithm import to_selecting
from rhi.shading import Precision

Edit = Callable[[Renderer], None]
EYES: Final[tuple[tuple[float, float, float], ...]] = ((-6.0, 3.0, 7.0), (0.5, 1.5, 9.0), (7.0, 5.0, 3.0))
STEADY: Final = 4
"""So many frames follow each edit: the first brings all up to date, and those after the second skip most."""


def replace_lights(renderer: Renderer) -> None:
    renderer.scene.lights = Lights()
    renderer.scene.lights.add_point((0.0, 3.0, 2.0), 9.0, intensity=3.0)


def hang_node(renderer: Renderer) -> None:
    nodes = renderer.scene.nodes
    first, second = np.flatnonzero(nodes.dynamic)[:2].tolist()
    nodes.set_parent(first, second)


def update_outside(renderer: Renderer) -> None:
    """Move a node, and let the scene update itself before the renderer sees it."""
    nodes = renderer.scene.nodes
    nodes.set_local(np.flatnonzero(nodes.dynamic)[0], translation((1.0, 2.0, 0.5)))
    renderer.scene.update(2.0)


def hide_outside(renderer: Renderer) -> None:
    renderer.scene.nodes.hide(int(renderer.scene.objects.node[2]))
    renderer.scene.refresh()


def exchange_technique(renderer: Renderer) -> None:
    renderer.technique = TECHNIQUES["deferred"]()


def exchange_visibility(renderer: Renderer) -> None:
    renderer.visibility = make_visibility("none", renderer.scene, renderer.device)


def darken_materials_outside(renderer: Renderer) -> None:
    renderer.scene.materials["base_color"][1, :3] *= 0.5
    renderer.scene.refresh()


def replace_materials(renderer: Renderer) -> None:
    scene = renderer.scene
    scene.materials = scene.materials.copy()
    scene.materials["base_color"][:, 0] = 0.7


def there_and_back(renderer: Renderer) -> None:
    """Exchange the targets' textures, although size and scale are those of the last frame."""
    renderer.size = (48, 40)
    renderer.size = SIZE


def draw_elsewhere(renderer: Renderer) -> None:
    """Draw a frame of the scene with another renderer, after it has moved a node."""
    with open_renderer(renderer.device, renderer.scene, visibility="frustum") as other:
        move_node(renderer)
        other.render(Camera.look_at((0.0, 4.0, 9.0), (0.0, 0.0, 0.0)))


def move_node(renderer: Renderer) -> None:
    nodes = renderer.scene.nodes
    nodes.set_local(np.flatnonzero(nodes.dynamic)[1], translation((-2.0, 1.0, 3.0)))


def set_items(of: Callable[[Renderer], Any], name: str, value: object) -> Edit:
    """Return an edit that writes to a field of a structured array."""

    def edit(renderer: Renderer) -> None:
        of(renderer)[name][-1:] = value

    return edit


def set_attribute(of: Callable[[Renderer], Any], name: str, value: object) -> Edit:
    def edit(renderer: Renderer) -> None:
        setattr(of(renderer), name, value)

    return edit


def of_lights(kind: str) -> Callable[[Renderer], Any]:
    return lambda renderer: getattr(renderer.scene.lights, kind)


def of_scene(renderer: Renderer) -> Scene:
    return renderer.scene


CASES: Final[dict[str, Edit]] = {
    "nothing": lambda renderer: None,
    **{
        f"{kind} {name}": set_items(of_lights(kind), name, value)
        for kind in ("directional", "point", "spot")
        for name, value in (("intensity", 0.3), ("color", (0.2, 0.9, 0.4)))
    },
    **{
        f"{kind} {name}": set_items(of_lights(kind), name, value)
        for kind in ("point", "spot")
        for name, value in (
            ("position", (1.0, 2.5, 1.0)),
            ("range", 3.0),
            ("source_radius", 0.4),
            ("casts_shadow", True),
        )
    },
    "point source_right": set_items(of_lights("point"), "source_right", (0.4, 0.0, 0.0)),
    "directional angular_diameter": set_items(of_lights("directional"), "angular_diameter", 0.1),
    "no lights": replace_lights,
    "sky": set_attribute(lambda renderer: renderer.scene.lights, "sky", (0.3, 0.1, 0.2)),
    "ground": set_attribute(lambda renderer: renderer.scene.lights, "ground", [0.2, 0.1, 0.0]),
    "background": set_attribute(of_scene, "background", (0.4, 0.1, 0.2)),
    "haze": set_attribute(of_scene, "haze", 0.05),
    "thin haze": set_attribute(of_scene, "haze", 1e-7),
    "fog": set_attribute(of_scene, "fog", Fog(0.05, (0.5, 0.6, 0.7))),
    "bloom": set_attribute(of_scene, "bloom", Bloom()),
    "ambient occlusion": set_attribute(of_scene, "ambient_occlusion", AmbientOcclusion()),
    "depth of field": set_attribute(of_scene, "depth_of_field", DepthOfField()),
    "environment": set_attribute(of_scene, "environment", Environment(np.full((4, 8, 3), 0.7, np.float32))),
    "base color": set_items(lambda renderer: renderer.scene.materials, "base_color", (0.1, 0.9, 0.3, 0.4)),
    "emission": set_items(lambda renderer: renderer.scene.materials, "emission", 0.0),
    "set_material": lambda renderer: renderer.scene.set_material(2, double_sided=False),
    "materials outside": darken_materials_outside,
    "other materials": replace_materials,
    "replace": lambda renderer: renderer.scene.replace([2], mesh=2, material=3),
    "casts shadow": lambda renderer: renderer.scene.objects.casts_shadow.fill(False),
    "move": move_node,
    "hang": hang_node,
    "hide": lambda renderer: renderer.scene.nodes.hide(int(renderer.scene.objects.node[1])),
    "update outside": update_outside,
    "hide outside": hide_outside,
    "elsewhere": draw_elsewhere,
    "size": set_attribute(lambda renderer: renderer, "size", (48, 40)),
    "scale": set_attribute(lambda renderer: renderer, "scale", 0.5),
    "size and back": there_and_back,
    "blending": set_attribute(lambda renderer: renderer, "blending", Blending.WEIGHTED),
    "precision": set_attribute(lambda renderer: renderer, "precision", Precision.EXACT),
    "bloom settings": lambda renderer: setattr(renderer, "bloom", BloomSettings(levels=2)),
    "occlusion settings": lambda renderer: setattr(renderer, "occlusion", OcclusionSettings(slices=3)),
    "focus settings": lambda renderer: setattr(renderer, "depth_of_field", DepthOfFieldSettings(samples=8)),
    "temporal anti-aliasing": lambda renderer: setattr(renderer, "temporal", TemporalSettings(is_on=True)),
    "light cutoff": set_attribute(lambda renderer: renderer, "light_cutoff", 0.2),
    "error of levels of detail": set_attribute(lambda renderer: renderer, "detail_error", 3.0),
    "technique": exchange_technique,
    "visibility": exchange_visibility,
    "stereo": set_attribute(lambda renderer: renderer, "stereo", Stereo(StereoRig())),
}
"""Edits of each kind that a frame must notice, by name."""


def entries(device: rhi.Device) -> list[tuple[object, ...]]:
    """Return the commands since the stream was cleared, with all arguments, and clear it."""
    stream = device.stream
    commands = [stream.entry(index)[:2] for index in range(len(stream))]
    stream.clear()
    return commands


def look(step: int, projection: Projection) -> Camera:
    """Return the camera of a step: it turns and moves a little in each, and jumps in some."""
    eye = np.array(EYES[step // 3 % len(EYES)]) + 0.05 * step
    return Camera.look_at(eye, (0.1 * (step % 3), 0.5, -0.5), projection=projection)


class NoLayer:
    """A layer that draws nothing."""

    def render(self, device: rhi.Device, frame: Frame) -> None:
        """Draw nothing."""


class Twins:
    """Two renderers of equal scenes, one of which skips nothing, each on a null device of its own."""

    def __init__(
        self, technique: str, make_scene: Callable[[], Scene] = make, visibility: str = "frustum"
    ) -> None:
        self.steady_frames = 0
        self.renderers = []
        for _ in range(2):
            device = rhi.create_device("null")
            renderer = Renderer(
                device, make_scene(), technique=TECHNIQUES[technique](), visibility=visibility, size=SIZE
            )
            self.renderers.append(renderer)
        self.repeated_frames = 0
        begin, self.is_full = self.renderers[0]._begin, False
        repeat = self.renderers[0]._repeat

        def note(camera: Camera, seconds: float) -> Any:
            self.is_full = True
            return begin(camera, seconds)

        def count_repeated(*arguments: Any) -> Any:
            result = repeat(*arguments)
            self.repeated_frames += result is not None
            return result

        self.renderers[0]._begin = note  # type: ignore[method-assign]
        self.renderers[0]._repeat = count_repeated  # type: ignore[method-assign]

    def __enter__(self) -> Twins:
        return self

    def __exit__(self, *_: object) -> None:
        for renderer in self.renderers:
            renderer.destroy()
            renderer.device.close()

    def edit(self, edit: Edit) -> None:
        for renderer in self.renderers:
            edit(renderer)

    def draw(self, camera: Camera, seconds: float = 0.0) -> None:
        """Draw a frame with both, and compare their commands and statistics."""
        self.is_full, frames = False, []
        self.renderers[1]._steady = None  # no frame to go on from, so nothing is skipped
        for renderer in self.renderers:
            frames.append(renderer.render(camera, seconds))
        self.steady_frames += not self.is_full
        skipping, full = (entries(renderer.device) for renderer in self.renderers)
        assert skipping == full
        assert frames[0].statistics == frames[1].statistics
        assert self.renderers[0].scene.seconds == self.renderers[1].scene.seconds


@pytest.mark.parametrize("name", CASES)
def test_the_frames_after_an_edit_are_those_of_a_renderer_that_skips_nothing(name: str) -> None:
    with Twins("forward") as twins:
        for step in range(STEADY):
            twins.draw(look(step, Perspective()), float(step))
        steady_before = twins.steady_frames
        twins.edit(CASES[name])
        twins.draw(look(STEADY, Perspective()))
        assert twins.is_full == (name != "nothing")
        for step in range(STEADY + 1, 3 * STEADY):
            twins.draw(look(step, Perspective()), float(step))
    assert steady_before > 0


STAYING: Final = (
    "nothing",
    *(f"{kind} {name}" for kind in ("directional", "point", "spot") for name in ("intensity", "color")),
    *(f"{kind} {name}" for kind in ("point", "spot") for name in ("position", "range")),
    *("sky", "ground", "background", "set_material", "materials outside", "hide", "hide outside"),
    *("size", "scale", "size and back", "precision", "blending", "visibility"),
    *("bloom settings", "occlusion settings", "focus settings", "light cutoff", "error of levels of detail"),
)
"""Edits after which frames may be repeated as one function."""


@pytest.mark.parametrize("seed", range(4))
def test_repeated_frames_after_random_edits_of_scene_settings_and_size_are_those_of_a_renderer_that_skips_nothing(
    seed: int,
) -> None:
    random = np.random.default_rng(seed)
    with Twins("forward", lambda: load_scene("city:blocks=3,detail=2")) as twins:
        cameras = twins.renderers[0].scene.paths["ground"]
        for step in range(48):
            if step % 4 == 3:
                for _ in range(int(random.integers(1, 3))):
                    twins.edit(CASES[STAYING[int(random.integers(len(STAYING)))]])
            twins.draw(cameras.camera(20 * step), 0.1 * step)
        assert twins.repeated_frames > 6


PROJECTIONS: Final[dict[str, Projection]] = {
    "perspective": Perspective(),
    "narrow": Perspective(fov=0.4),
    "another aspect": Perspective(aspect=2.5),
    "standard depth": Perspective(depth=Depth.STANDARD, far=100.0),
    "parallel": Orthographic(8.0),
}


@pytest.mark.parametrize("technique", TECHNIQUES)
def test_frames_of_random_edits_and_cameras_are_those_of_a_renderer_that_skips_nothing(
    technique: str,
) -> None:
    seed = sum(technique.encode())
    cameras = np.random.default_rng(seed)
    randoms: list[Random] = []
    with Twins(technique) as twins:
        projection: Projection = Perspective()
        for step in range(60):
            if step % 5 == 4:
                number = int(cameras.integers(len(EDITS) + 3))
                if number < len(EDITS):
                    randoms = [np.random.default_rng((seed, step)) for _ in twins.renderers]
                    for renderer, random in zip(twins.renderers, randoms, strict=True):
                        EDITS[number](renderer, random)
                else:
                    projection = list(PROJECTIONS.values())[int(cameras.integers(len(PROJECTIONS)))]
            twins.draw(look(step, projection), 0.1 * step)
        if "shadow" not in technique:
            assert twins.steady_frames > 10


def test_frames_of_a_city_are_steady_once_shaders_have_the_features_in_view() -> None:
    with Twins("clustered", lambda: load_scene("city:blocks=4,detail=2")) as twins:
        camera = next(iter(twins.renderers[0].scene.views.values()))
        for step in range(80):
            twins.draw(replace(camera, position=camera.position + np.array([0.02 * step, 0.0, 0.0])))
        assert twins.steady_frames > 60


@pytest.mark.parametrize("visibility", ["none", "frustum"])
def test_frames_of_a_city_are_repeated_by_one_function(visibility: str) -> None:
    with Twins("forward", lambda: load_scene("city:blocks=4,detail=2"), visibility) as twins:
        camera = next(iter(twins.renderers[0].scene.views.values()))
        for step in range(80):
            twins.draw(replace(camera, position=camera.position + np.array([0.02 * step, 0.0, 0.0])))
        assert twins.repeated_frames > 60
        twins.renderers[0].layers.append(NoLayer())
        repeated = twins.repeated_frames
        twins.draw(camera)
        assert twins.repeated_frames == repeated


def test_frames_of_automatic_culling_are_repeated_once_it_has_chosen(null: rhi.Device) -> None:
    scene = load_scene("city:blocks=4,detail=2")
    camera = next(iter(scene.views.values()))
    with open_renderer(null, scene, visibility="auto") as renderer:
        for step in range(80):
            renderer.render(replace(camera, position=camera.position + np.array([0.02 * step, 0.0, 0.0])))
        assert isinstance(renderer.visibility, AutoCulling)
        assert to_selecting(renderer.visibility.latest) is not None
        renderer._begin_steady = None  # type: ignore[method-assign, assignment]  # other frames would fail
        renderer.render(camera)


def test_lights_that_come_into_view_or_leave_it_are_noticed() -> None:
    lit = set()
    with Twins("forward", lambda: load_scene("night:blocks=3,detail=2,lights=3")) as twins:
        camera = next(iter(twins.renderers[0].scene.views.values()))
        for step in range(48):
            angle = step * np.pi / 12.0
            ahead = np.array([np.sin(angle), -0.3, np.cos(angle)])
            twins.draw(Camera.look_at(camera.position, camera.position + ahead))
            effects = twins.renderers[1]._effects
            assert effects is not None
            lit.add(effects.in_view[Effect.POINT_LIGHTS].tobytes())
        assert twins.steady_frames > 8
    assert len(lit) > 1


@pytest.mark.parametrize("scene", ["hall:columns=6,flags=2,fountains=1", "terrain:cells=8,trees=0"])
def test_a_scene_with_simulations_or_height_fields_is_never_steady(scene: str) -> None:
    with Twins("forward", lambda: load_scene(scene)) as twins:
        for step in range(4):
            twins.draw(look(step, Perspective()), 0.1 * step)
        assert twins.steady_frames == 0


def test_a_light_that_isnt_finite_is_refused_after_steady_frames() -> None:
    with Twins("forward") as twins:
        for step in range(STEADY):
            twins.draw(look(step, Perspective()))
        assert twins.steady_frames > 0
        for renderer in twins.renderers:
            renderer.scene.lights.point["intensity"] = np.nan
            for _ in range(3):
                assert refused_rule(partial(renderer.render, look(0, Perspective()))) == "scene-not-finite"
            renderer.scene.lights.point["intensity"] = 1.0
        for step in range(STEADY):
            twins.draw(look(step, Perspective()))


def test_images_of_steady_frames_are_those_of_a_new_renderer(gl: rhi.Device) -> None:
    scene = make()
    with open_renderer(gl, scene, visibility="frustum") as renderer:
        for name in ("nothing", "point position", "sky", "move"):
            CASES[name](renderer)
            for step in range(STEADY):
                image = read_colors(renderer.render(look(step, Perspective())))
            with open_renderer(gl, scene, visibility="frustum") as other:
                assert np.array_equal(image, read_colors(other.render(look(STEADY - 1, Perspective()))))
