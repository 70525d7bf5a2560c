"""The scene of `draw_tubes.py`, which also the test that knows no tubes can make."""

from __future__ import annotations

from typing import Any, Final

from renderer.content import BUILT_IN
from renderer.scene import Camera, SceneBuilder, scaling, translation

SIZE: Final = (96, 64)
EYE: Final = Camera.look_at((0, 6, 2), (0, 0, 0))
COLOR: Final = (0.7, 0.6, 0.5)
TUBES: Final = (
    {"position": (-1.0, 0.6, 0.5), "direction": (1, 0, 0), "half_length": 1.5, "range": 4.0, "intensity": 0.6},
    {
        "position": (1.5, 0.8, -1.0), "direction": (0.6, 0.0, 0.8), "half_length": 1.0, "range": 3.0, "intensity": 0.9,
        "color": (0.2, 0.9, 0.5),
    },
)  # fmt: skip


def make_floor() -> SceneBuilder:
    """Make a floor that fills the image, with a point light and a spot light."""
    builder = SceneBuilder("floor")
    material = builder.add_material(base_color=COLOR, specular_color=(0.3, 0.2, 0.1), shininess=20.0)
    mesh = builder.add_mesh(BUILT_IN["box"]())
    builder.add_objects(builder.add_node(translation((0, -0.5, 0)) @ scaling((40, 1, 40))), mesh, material)
    builder.lights.sky = builder.lights.ground = (0.02, 0.02, 0.02)
    builder.lights.add_point((2.0, 1.0, 1.0), 3.0, (1.0, 0.4, 0.2), 0.8)
    builder.lights.add_spot((-2.0, 2.0, -1.5), (0.2, -1.0, 0.1), 5.0, 0.3, 0.5, (0.4, 0.5, 1.0), 4.0)
    builder.views["eye"] = EYE
    return builder


def add_lights(builder: Any) -> None:
    """Add the tube lights."""
    for tube in TUBES:
        builder.lights.add_segment(**tube)
