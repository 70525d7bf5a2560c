"""Hidden simulations are paused with every algorithm that reports what it hides; they come back as of their
frame, or as late as documented."""

from __future__ import annotations

import numpy as np
import pytest
from frames import open_renderer, require_algorithm
from occlusion_scenes import DEVICE, WAITING, Oracle

import rhi
from renderer.content.fountains import BOUNDS, FountainSimulation, make_drops
from renderer.content.shapes import box
from renderer.frame.hidden_objects import PATIENCE
from renderer.lab.exam.scenes import make_camera, make_flag
from renderer.scene import Scene, SceneBuilder, make_height_field, rotation
from rhi import Device
from rhi.math import multiply, scaling, translation

LATE = (*DEVICE, "conditional")
"""The algorithms whose frames the device decides."""
AIM = (0.4, 0.0, -5.0)
MOVES = {1, 2}
WALL_POSITION = 3


def make_scene(*, shadow: bool = False) -> Scene:
    """Make a box that turns, a fountain and terrain, and a wall that hides them from x = 6."""
    builder = SceneBuilder("hidden")
    mesh, red = builder.add_mesh(box()), builder.add_material(base_color=(0.8, 0.1, 0.1))
    transform = translation([AIM])
    node = builder.add_nodes(transform, dynamic=True)
    builder.add_objects(node, mesh, red)
    reach = np.array([[0.8, 0.8, 0.8]])
    builder.animate(
        node, lambda time: transform @ rotation((0, 0, 1), 3.0 * time), bounds=(AIM - reach, AIM + reach)
    )
    spray = builder.add_mesh(make_drops(), "spray", BOUNDS)
    builder.simulate(
        builder.add_objects(builder.add_node(translation((0.0, -1.0, -5.0))), spray, red),
        FountainSimulation(1, 5),
    )
    hills = builder.add_height_field(make_height_field(np.cos(np.indices((17, 17)) / 2.0).sum(0) / 4.0, 2.0))
    builder.add_objects(builder.add_node(translation((0.5, -1.0, -5.5))), hills, red)
    wall = multiply(translation((4.0, 0.0, -3.0)), scaling((7.9, 14.0, 0.2)))
    builder.add_objects(builder.add_node(wall), mesh, builder.add_material())
    builder.lights.add_directional((-0.4, -1.0, -0.3), casts_shadow=shadow)
    return builder.build()


@pytest.mark.parametrize("name", [*WAITING, *LATE])
@pytest.mark.parametrize(
    ("what", "shadow"), [("simulation", False), ("tessellation", False), ("tessellation", True)]
)
def test_hidden_simulations_dispatch_nothing_and_take_no_step(
    null: Device, name: str, what: str, shadow: bool
) -> None:
    """Cloth and terrain; it is seen again from frame 30 on, as of frame 31 if the device decides, or 32 where
    conditions open a node first. Shadows need triangles."""
    scene, wall = (make_flag(), 1) if what == "simulation" else (make_scene(shadow=shadow), WALL_POSITION)
    oracle, dispatches, steps = Oracle(null, scene, name, visible_objects={wall}), list[int](), list[int]()
    with open_renderer(null, scene, visibility=name) as renderer:
        for frame in range(40):
            oracle.visible_objects = set(range(wall + 1)) if frame >= 30 else {wall}
            null.stream.clear()
            result = renderer.render(make_camera((6.0 + 0.01 * frame, 0.0, 0.0), AIM), frame / 60)
            dispatches.append(sum(what in command.labels for command in null.stream.filter(rhi.Op.DISPATCH)))
            steps.append(result.statistics.simulation_steps)
    assert any(dispatches[15:30]) == shadow
    assert shadow or not any(steps[15:30])  # whose casters are simulated
    back = 30 if shadow else 30 + (name in LATE) + (name == "conditional" and what == "tessellation")
    assert [frame for frame in range(30, 40) if dispatches[frame]] == list(range(back, 40))
    assert max(steps[30:34]) > 1 or shadow


@pytest.mark.parametrize("simulates_hidden", [False, True])
@pytest.mark.parametrize("name", LATE)
def test_terrain_that_appears_from_behind_a_wall_is_as_of_its_frame(
    drawing_device: Device, name: str, simulates_hidden: bool
) -> None:
    """Terrain fills its box, and shows with it: so it may be late in a walk. All is where the wall
    vanishes."""
    require_algorithm(drawing_device, name)
    scene, behind = make_scene(), [6.0] * 15
    object_positions = [
        *behind,
        -1.0,
        *behind,
        *np.arange(6.0, -1.0, -0.1).tolist(),
        *behind,
    ]  # a jump, a walk, and back
    wrong, paused = list[int](), set[int]()
    with (
        open_renderer(drawing_device, scene, visibility="none", size=(97, 55)) as true,
        open_renderer(drawing_device, scene, visibility=name, size=(97, 55)) as renderer,
    ):
        renderer.simulates_hidden = simulates_hidden
        for number, x in enumerate(object_positions + [6.0] * 5):
            if number == len(object_positions):
                scene.nodes.hide([WALL_POSITION])
            expected, other = (
                drawer.render(make_camera((x, 0.0, 0.0), AIM), number / 60) for drawer in (true, renderer)
            )
            wrong.append(int((expected.image.read() != other.image.read()).any(2).sum()))
            paused |= (
                set(np.flatnonzero(renderer.resources.hidden.paused).tolist())
                if number >= PATIENCE
                else set()
            )
    assert paused <= MOVES
    assert bool(paused) != simulates_hidden
    assert np.count_nonzero(wrong[: len(object_positions)]) <= 2 * (not simulates_hidden)
    assert not any(wrong[: 2 * len(behind)])
    late = np.count_nonzero(wrong[len(object_positions) :])
    assert late == np.count_nonzero(wrong[len(object_positions) :][:late])  # the first ones
    assert late == 0 if simulates_hidden else 1 <= late <= 3
