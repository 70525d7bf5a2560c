"""A renderer that has drawn a scene before draws it as a new one does, whatever has changed between two
frames."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Final

import numpy as np
import pytest
from frames import SIZE, open_renderer, read_colors
from test_editing import begin

import rhi
from renderer.frame import EXACT_BLOOM, Blending, BloomSettings
from renderer.renderer import Renderer
from renderer.scene import AlphaMode, Bloom, Camera, Fog, Scene, ShadingModel, translation
from renderer.techniques import TECHNIQUES
from rhi import Command, Op
from rhi.shading import Precision

Random = np.random.Generator
ISSUED: Final = {Op.BEGIN_PASS, Op.DRAW, Op.DRAW_INDIRECT, Op.DISPATCH}


def make() -> Scene:
    """Return objects of each material that can move, above a floor, and lights of each kind without
    shadows."""
    builder = begin()
    for material in range(1, 5):
        node = builder.add_node(translation((2.0 * material - 5.0, 0.6, -1.0)), dynamic=True)
        builder.add_objects(node, 1 + material % 2, material)
    for lights in (builder.lights.directional, builder.lights.point, builder.lights.spot):
        lights["casts_shadow"] = False
    return builder.build()


def move_light(renderer: Renderer, random: Random) -> None:
    lights = renderer.scene.lights
    light_array = (lights.point, lights.spot)[int(random.integers(2))]
    light_array["position"] = random.uniform((-30, 1, -30), (30, 4, 30)) * random.choice([1.0, 0.1])
    light_array["range"], light_array["intensity"] = random.uniform(1, 12), random.uniform(0, 6)
    light_array["source_radius"] = random.choice([0.0, 0.5])
    lights.point["source_right"] = random.choice([0.0, 0.4])


def turn_sun(renderer: Renderer, random: Random) -> None:
    lights = renderer.scene.lights
    if random.integers(2) and len(lights.directional):
        lights.directional = lights.directional[:0]
    else:
        lights.add_directional(random.normal(size=3).tolist(), intensity=0.4)


def change_air(renderer: Renderer, random: Random) -> None:
    scene, kind = renderer.scene, random.integers(3)
    if kind == 0:
        scene.haze = 0.05 - scene.haze
    elif kind == 1:
        scene.fog = Fog(0.05, (0.5, 0.6, 0.7)) if scene.fog is None else None
    else:
        scene.bloom = Bloom() if scene.bloom is None else None


def change_sky(renderer: Renderer, random: Random) -> None:
    renderer.scene.background = tuple(random.uniform(0, 1, 3).tolist())
    renderer.scene.lights.sky = tuple(random.uniform(0, 0.3, 3).tolist())


def change_material(renderer: Renderer, random: Random) -> None:
    row = renderer.scene.materials[int(random.integers(1, 5)) :][:1]
    row["base_color"][0, :3] = random.uniform(0, 1, 3)
    row["emission"] = random.choice([0.0, 2.0])
    row["alpha_mode"] = random.choice([AlphaMode.OPAQUE, AlphaMode.BLEND])
    row["model"] = random.choice([*ShadingModel])
    row["double_sided"] = random.integers(2)


def move_objects(renderer: Renderer, random: Random) -> None:
    nodes, node = renderer.scene.nodes, int(random.choice(renderer.scene.objects.node[1:]))
    nodes.set_local(node, translation(random.uniform((-5, 0, -5), (5, 2, 5))))
    (nodes.hide if random.integers(2) else nodes.show)(int(random.choice(renderer.scene.objects.node)))


def change_settings(renderer: Renderer, random: Random) -> None:
    renderer.blending = random.choice([*Blending])
    renderer.precision = random.choice([*Precision])
    renderer.bloom = (EXACT_BLOOM, BloomSettings(levels=2))[int(random.integers(2))]


def resize(renderer: Renderer, random: Random) -> None:
    renderer.size = (SIZE, (48, 40))[int(random.integers(2))]
    renderer.scale = float(random.choice([1.0, 0.5]))


EDITS: Final[tuple[Callable[[Renderer, Random], None], ...]] = (
    move_light,
    turn_sun,
    change_air,
    change_sky,
    change_material,
    move_objects,
    change_settings,
    resize,
)


def describe(command: Command) -> tuple[object, ...]:
    """Return a command's labels and program, and of a draw the states: a dispatch and a pass depend on
    none."""
    program = "" if command.op is Op.BEGIN_PASS else str(command.resource(command.program))
    return command.op, command.labels, program, str(command.states) if "DRAW" in command.op.name else ""


def list_issued(device: rhi.Device) -> list[tuple[object, ...]]:
    """Describe the passes, draws and dispatches since the stream was cleared."""
    return [describe(command) for command in device.stream if command.op in ISSUED]


def compare(device: rhi.Device, technique: str, seed: int, *, frames: int = 40) -> None:
    """Draw frames of a scene that is edited at random between some of them, and compare each with a new
    renderer's."""
    random, scene = np.random.default_rng(seed), make()
    records = not device.capabilities.renders
    with open_renderer(device, scene, TECHNIQUES[technique](), visibility="frustum") as renderer:
        for number in range(frames):
            if number % 2:  # in the frames between only the camera moves
                EDITS[int(random.integers(len(EDITS)))](renderer, random)
            eye = Camera.look_at(random.uniform((-8, 1, -8), (8, 6, 8)), random.uniform(-8, 8, 3))
            if records:
                device.stream.clear()
            # A renderer looks in its first frame whether a view shows anything, and then in each tenth.
            renderer._recent_features.shows_objects = False
            frame = renderer.render(eye)
            issued = list_issued(device) if records else []
            names = ("size", "blending", "precision", "bloom")
            options: dict[str, Any] = {name: getattr(renderer, name) for name in names}
            with open_renderer(
                device, scene, TECHNIQUES[technique](), visibility="frustum", **options
            ) as other:
                other.scale = renderer.scale
                if records:
                    device.stream.clear()
                expected = other.render(eye)
                if records:
                    assert issued == list_issued(device), number
                    assert issued
                else:
                    assert (read_colors(frame) == read_colors(expected)).all(), number
                reused, new = frame.frames[0].effects, expected.frames[0].effects
                assert (reused.key, reused.counts) == (new.key, new.counts)
                assert {effect: rows.tolist() for effect, rows in reused.in_view.items()} == {
                    effect: rows.tolist() for effect, rows in new.in_view.items()
                }
            assert frame.visible.tolist() == expected.visible.tolist()
            assert frame.statistics.triangles == expected.statistics.triangles


@pytest.mark.parametrize("technique", ["forward", "clustered", "deferred"])
@pytest.mark.parametrize("seed", [1, 2])
def test_a_reused_renderer_issues_the_same_commands_as_a_new_one(
    null: rhi.Device, technique: str, seed: int
) -> None:
    compare(null, technique, seed)


@pytest.mark.parametrize("technique", ["forward", "clustered"])
def test_a_reused_renderer_draws_the_pixels_of_a_new_one(gl: rhi.Device, technique: str) -> None:
    compare(gl, technique, 3)
