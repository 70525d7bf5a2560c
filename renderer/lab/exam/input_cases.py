"""Non-finite input: every number that users can pass is tried as NaN and as infinity, and must be refused."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial
from typing import Any, Final

import numpy as np

from renderer import scene as scenes
from renderer.content.shapes import box
from renderer.lab.exam.case import CaseResult, Measures
from renderer.lights.culling.grid_projection import make_grid
from renderer.renderer import Renderer
from renderer.scene.cloth import Fabric, Gust, Wind, make_cloth_grid
from renderer.scene.materials import RANGES
from renderer.shadows import ShadowSettings
from renderer.tessellation.settings import TessellationSettings
from renderer.visibility import VisibilitySettings
from rhi import Device, RhiError, create_device

INFINITE_ALLOWED: Final = {
    "Perspective.far",
    "StereoRig.convergence",
    "StereoRig.comfortable.farthest",
    "make_grid.reach",
}
"""Inputs that may be infinite."""
CAMERA: Final = scenes.Camera.look_at((0.0, 0.0, 5.0), (0.0, 0.0, 0.0))


def make_box() -> scenes.SceneBuilder:
    """Begin a scene of one box with lights of all kinds."""
    builder = scenes.SceneBuilder("box")
    node = builder.add_node(dynamic=True)
    builder.add_objects(node, builder.add_mesh(box()), builder.add_material())
    builder.lights.add_directional((0, -1, 0))
    builder.lights.add_point((0, 2, 0), 4.0)
    builder.lights.add_spot((0, 2, 0), (0, -1, 0), 4.0, 0.3, 0.5)
    return builder


Inputs = Iterator[tuple[str, Callable[..., object]]]
"""Names of inputs, each with a function that passes a number there."""


def list_values() -> Inputs:
    """Yield the numbers that constructors and functions take."""
    yield from list_camera_values()
    yield from list_settings_values()
    yield from list_material_values()
    yield from list_geometry_values()
    yield from list_light_values()
    yield "Scene.update", lambda x: make_box().build().update(x)
    yield "TessellationSettings.edge_pixels", lambda x: TessellationSettings(edge_pixels=x)
    yield "make_height_field.heights", lambda x: scenes.make_height_field(np.full((3, 3), x), 1.0)
    yield "make_height_field.size", lambda x: scenes.make_height_field(np.zeros((3, 3)), x)
    yield "tessellate.heights", lambda x: scenes.tessellate(box(), halvings=1, heights=[[x]])
    yield "tessellate.height_scale", lambda x: scenes.tessellate(box(), halvings=1, height_scale=x)
    yield "tessellate.smoothness", lambda x: scenes.tessellate(box(), halvings=1, smoothness=x)
    yield from list_cloth_values()


def list_camera_values() -> Inputs:
    """Yield the numbers of projections, cameras, camera paths and stereo rigs."""
    for field in ("fov", "aspect", "near", "far"):
        yield f"Perspective.{field}", lambda x, field=field: replace(scenes.Perspective(), **{field: x})
    for field in ("height", "aspect", "near", "far"):
        yield f"Orthographic.{field}", lambda x, field=field: replace(scenes.Orthographic(2.0), **{field: x})
    yield "look_at.position", lambda x: scenes.Camera.look_at((0, x, 5), (0, 0, 0))
    yield "look_at.target", lambda x: scenes.Camera.look_at((0, 0, 5), (0, x, 0))
    yield "look_at.up", lambda x: scenes.Camera.look_at((0, 0, 5), (0, 0, 0), (x, 1, 0))
    yield (
        "CameraPath.record",
        lambda x: scenes.CameraPath.record([replace(CAMERA, position=np.array((x, 0, 0)))]),
    )
    yield "StereoRig.eye_distance", lambda x: scenes.StereoRig(eye_distance=x)
    yield "StereoRig.convergence", lambda x: scenes.StereoRig(convergence=x)
    yield (
        "StereoRig.comfortable.nearest",
        lambda x: scenes.StereoRig.comfortable(scenes.Perspective(), x, 10.0),
    )
    yield (
        "StereoRig.comfortable.farthest",
        lambda x: scenes.StereoRig.comfortable(scenes.Perspective(), 1.0, x),
    )


def list_settings_values() -> Inputs:
    """Yield the numbers of settings: shadows, visibility, and the cluster grid."""
    for field in ("distance", "split", "bias"):
        yield f"ShadowSettings.{field}", lambda x, field=field: ShadowSettings(**{field: x})
    for field in ("batch", "persistence", "threshold", "leaf_size"):
        yield f"VisibilitySettings.{field}", lambda x, field=field: VisibilitySettings(**{field: x})
    yield (
        "make_grid.first_slice",
        lambda x: make_grid(scenes.Perspective(far=9.0), (8, 8), 8, slices=4, first_slice=x),
    )


def list_material_values() -> Inputs:
    """Yield the numbers of materials and of texture maps."""
    for field in RANGES:
        yield f"material.{field}", partial(_make_material, field)
    yield "TextureMap.offset", lambda x: scenes.TextureMap(0, offset=(x, 1.0))
    yield "TextureMap.scale", lambda x: scenes.TextureMap(0, scale=(x, 1.0))
    yield "TextureMap.rotation", lambda x: scenes.TextureMap(0, rotation=x)


def _make_material(field: str, value: float) -> object:
    """Make a material with a value in all channels of one field."""
    channels = {"base_color": 4, "specular_color": 3, "emissive": 3}.get(field, 1)
    fields: dict[str, Any] = {field: value if channels == 1 else (value,) * channels}
    if field == "roughness":
        fields["metallic"] = 1.0  # roughness belongs to the metallic model
    return scenes.make_material(**fields)


def list_geometry_values() -> Inputs:
    """Yield the numbers of vertices, transforms and bounds."""
    corners = np.eye(3)
    yield "make_geometry.positions", lambda x: scenes.make_geometry(corners * x, np.arange(3))
    yield "make_geometry.normals", lambda x: scenes.make_geometry(corners, np.arange(3), normals=corners * x)
    yield (
        "make_geometry.uvs",
        lambda x: scenes.make_geometry(corners, np.arange(3), corners, corners[:, :2] + x),
    )
    yield "add_node", lambda x: make_box().add_node(scenes.translation((0.0, x, 0.0)))
    yield "add_mesh.bounds", lambda x: make_box().add_mesh(box(), bounds=(np.full(3, -x), np.full(3, x)))
    yield (
        "animate.bounds",
        lambda x: make_box().animate([0], lambda _: np.eye(4)[None], ((0, 0, x), (1, 1, x))),
    )


def list_light_values() -> Inputs:
    """Yield the numbers of lights."""
    yield "add_directional.direction", lambda x: scenes.Lights().add_directional((x, 1, 0))
    yield "add_directional.color", lambda x: scenes.Lights().add_directional((0, 1, 0), color=(x, 1, 1))
    yield "add_directional.intensity", lambda x: scenes.Lights().add_directional((0, 1, 0), intensity=x)
    yield "add_point.position", lambda x: scenes.Lights().add_point((x, 0, 0), 1.0)
    yield "add_point.range", lambda x: scenes.Lights().add_point((0, 0, 0), x)
    yield "add_point.color", lambda x: scenes.Lights().add_point((0, 0, 0), 1.0, color=(1, x, 1))
    yield "add_point.intensity", lambda x: scenes.Lights().add_point((0, 0, 0), 1.0, intensity=x)
    yield (
        "add_directional.angular_diameter",
        lambda x: scenes.Lights().add_directional((0, -1, 0), angular_diameter=x),
    )
    yield "add_point.source_radius", lambda x: scenes.Lights().add_point((0, 0, 0), 1.0, source_radius=x)
    yield "add_spot.direction", lambda x: scenes.Lights().add_spot((0, 0, 0), (0, x, 0), 1.0, 0.1, 0.2)
    yield "add_spot.inner", lambda x: scenes.Lights().add_spot((0, 0, 0), (0, 1, 0), 1.0, x, 0.2)
    yield "add_spot.outer", lambda x: scenes.Lights().add_spot((0, 0, 0), (0, 1, 0), 1.0, 0.1, x)


def list_cloth_values() -> Inputs:
    """Yield the numbers of cloth: fabric, wind and grid."""
    for name in Fabric.__dataclass_fields__:
        yield f"Fabric.{name}", lambda x, name=name: Fabric(**{name: x})
    yield "Wind.velocity", lambda x: Wind((0.0, x, 0.0))
    yield "Gust.velocity", lambda x: Gust((x, 0.0, 0.0), (0.0, 0.0, 0.0), 1.0)
    yield "Gust.along", lambda x: Gust((0.0, 0.0, 0.0), (0.0, x, 0.0), 1.0)
    yield "Gust.period", lambda x: Gust((0.0, 0.0, 0.0), (0.0, 0.0, 0.0), x)
    grid = np.stack([*np.meshgrid(np.arange(2.0), np.arange(2.0)), np.zeros((2, 2))], 2)
    pins = np.eye(2, dtype=bool)
    yield "make_cloth_grid.points", lambda x: make_cloth_grid(grid + x, pins)
    yield "make_cloth_grid.flat", lambda x: make_cloth_grid(grid, pins, flat=grid + x)
    yield (
        "make_cloth_grid.room",
        lambda x: make_cloth_grid(grid, pins, bounds=((-1.0, -1.0, x), (2.0, 2.0, 2.0))),
    )


def list_assignments(scene: scenes.Scene) -> Iterator[tuple[str, Callable[..., None]]]:
    """Yield the values of a scene that may change between frames, each with a function that sets it to a
    number."""
    lights = scene.lights
    for kind in ("directional", "point", "spot"):
        for field in getattr(lights, kind).dtype.names:
            if getattr(lights, kind).dtype[field].base.kind == "f":
                yield (
                    f"lights.{kind}[{field!r}]",
                    lambda x, kind=kind, field=field: _write(getattr(lights, kind), field, x),
                )
    for field in RANGES:
        yield f"materials[{field!r}]", lambda x, field=field: _write(scene.materials, field, x)
    yield "haze", lambda x: setattr(scene, "haze", x)
    yield "background", lambda x: setattr(scene, "background", (x, 0.0, 0.0))
    yield "lights.sky", lambda x: setattr(lights, "sky", (0.0, x, 0.0))
    yield "lights.ground", lambda x: setattr(lights, "ground", (0.0, 0.0, x))
    yield "nodes.set_local", lambda x: scene.nodes.set_local(0, scenes.translation((x, 0.0, 0.0)))


def _write(array: Any, field: str, value: float) -> None:
    array[field][0] = value


def list_frames() -> Iterator[tuple[str, Callable[[Renderer, float], object]]]:
    """Yield the arguments of `render`, each with a function that renders with a number for it."""
    yield "render.seconds", lambda renderer, x: renderer.render(CAMERA, x)
    position = np.array((0.0, 1.0, 0.0))
    yield (
        "render.camera.position",
        lambda renderer, x: renderer.render(replace(CAMERA, position=position * x)),
    )
    yield (
        "render.camera.rotation",
        lambda renderer, x: renderer.render(replace(CAMERA, rotation=np.eye(3) * x)),
    )


def measure_non_finite_inputs(_: Device) -> CaseResult:
    """Count the inputs that accept NaN or infinity. The renderer must still render after each refusal."""
    accepted: list[str] = []
    count = 0
    for number in (np.nan, np.inf):
        for name, give in list_values():
            if not (number == np.inf and name in INFINITE_ALLOWED):
                count += 1
                accepted += [] if _is_refused(partial(give, number)) else [f"{name} = {number}"]
    with create_device("null") as null:
        for number in (np.nan, np.inf):
            for name, draw in list_frames():
                with _open(null, make_box().build()) as renderer:
                    count += 1
                    if not _is_refused(partial(draw, renderer, number)):
                        accepted.append(f"{name} = {number}")
                    renderer.render(CAMERA)
            for name, _assign in list_assignments(make_box().build()):
                scene = make_box().build()
                with _open(null, scene) as renderer:
                    count += 1
                    if not _is_refused(partial(_apply, scene, renderer, name, number)):
                        accepted.append(f"{name} = {number}")
    return CaseResult(len(accepted), {"values tried": count, "accepted": ", ".join(accepted) or "none"})


def _open(device: Device, scene: scenes.Scene) -> Renderer:
    return Renderer(device, scene, visibility="none", size=(16, 16))


def _apply(scene: scenes.Scene, renderer: Renderer, name: str, number: float) -> None:
    renderer.render(CAMERA)
    dict(list_assignments(scene))[name](number)
    renderer.render(CAMERA)


def _is_refused(give: Callable[[], object]) -> bool:
    try:
        with np.errstate(all="ignore"):
            give()
    except RhiError:
        return True
    return False


MEASURES: Final[Measures] = {59: measure_non_finite_inputs}
