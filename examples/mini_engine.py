"""A small engine in one file: entities, shadows, picking, bloom, tone mapping, and shaders that reload.

Entities are rows of one array, drawn by one call a pass. A double click selects an entity. A saved edit of this
file's shaders shows in the next frame.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

import rhi
import rhi.shading as sl
from rhi import Comparison, CullMode, Filter, Format, PolygonOffset, Region, SamplerDescriptor, Wrap
from rhi.math import (
    Camera,
    Perspective,
    look_at,
    make_cube,
    make_sphere,
    normal_matrices,
    orthographic,
    rotation,
    scaling,
    translation,
)
from rhi_screen import OrbitCamera, Screen, open_screen, save_image

CLAMPED = SamplerDescriptor(Filter.LINEAR, Filter.LINEAR, None, Wrap.CLAMP, Wrap.CLAMP)
COMPARED = SamplerDescriptor(mip=None, wrap_u=Wrap.CLAMP, wrap_v=Wrap.CLAMP, compare=Comparison.GREATER_EQUAL)
SHADOW_MAP = (1024, 1024)
RADIUS = 8
"""Texels on each side that bloom reaches at a quarter of the size."""


# -- shaders ---------------------------------------------------------------------------------------------------


class Vertex(sl.Struct):
    position: sl.vec3
    normal: sl.vec3


class Entity(sl.Struct):
    model: sl.mat4
    normals: sl.mat3
    color: sl.vec3
    emission: float
    id: sl.uint


class View(sl.Struct):
    view_projection: sl.mat4
    sun_projection: sl.mat4
    sun: sl.vec3
    selected: sl.uint


class Surface(sl.Struct):
    clip: sl.vec4
    normal: sl.vec3
    in_shadow_map: sl.vec3
    entity: int


class ForwardOutput(sl.Struct):
    color: sl.vec4
    id: sl.uint


class Caster(sl.Shader):
    """The entities as the sun sees them; no fragment stage."""

    view: sl.Uniform[View]
    entities: sl.Storage[Entity]

    def vertex(self, v: Vertex) -> sl.vec4:
        model = self.entities[sl.instance_index()].model
        return self.view.sun_projection @ (model @ sl.vec4(v.position, 1.0))


class Forward(sl.Shader):
    """Sunlight with shadows into half floats, and the id of the entity."""

    view: sl.Uniform[View]
    entities: sl.Storage[Entity]
    shadows: sl.DepthTexture2D

    def vertex(self, v: Vertex) -> Surface:
        index = sl.instance_index()
        entity = self.entities[index]
        position = entity.model @ sl.vec4(v.position, 1.0)
        lit = (self.view.sun_projection @ position).xyz
        return Surface(
            clip=self.view.view_projection @ position,
            normal=entity.normals @ v.normal,
            in_shadow_map=sl.vec3(lit.x * 0.5 + 0.5, 0.5 - lit.y * 0.5, lit.z),
            entity=index,
        )

    def fragment(self, s: Surface) -> ForwardOutput:
        entity = self.entities[s.entity]
        light = max(sl.dot(sl.normalize(s.normal), self.view.sun), 0.0)
        light *= self.shadows.sample_compare(s.in_shadow_map.xy, s.in_shadow_map.z)
        color = entity.color * (0.15 + 1.2 * light + entity.emission)
        if entity.id == self.view.selected:
            color += sl.vec3(0.5, 0.4, 0.1)
        return ForwardOutput(color=sl.vec4(color, 1.0), id=entity.id)


class Bright(sl.FullScreen):
    """A shader that keeps what is brighter than white, of four pixels."""

    source: sl.Texture2D

    def fragment(self) -> sl.vec4:
        uv = sl.fragment_coordinate().xy * 4.0 / sl.vec2(self.source.size())
        return sl.vec4(sl.max(self.source.sample(uv).rgb - 1.0, sl.vec3(0.0)), 1.0)


class Blur(sl.FullScreen):
    """A Gaussian along one axis."""

    source: sl.Texture2D
    across = sl.ivec2(1, 0)

    def fragment(self) -> sl.vec4:
        texel, last = sl.ivec2(sl.fragment_coordinate().xy), self.source.size() - 1
        total, weights = sl.vec3(0.0), 0.0
        for i in range(-RADIUS, RADIUS + 1):
            weight = sl.exp(-4.0 * float(i * i) / float(RADIUS * RADIUS))
            total += self.source.load(sl.clamp(texel + self.across * i, sl.ivec2(0), last)).rgb * weight
            weights += weight
        return sl.vec4(total / weights, 1.0)


class BlurDown(Blur):
    across = sl.ivec2(0, 1)


class ToneMap(sl.FullScreen):
    """The light and its bloom as colors of a display: the curve of Narkowicz (2015)."""

    source: sl.Texture2D
    bloom: sl.Texture2D

    def fragment(self) -> sl.vec4:
        pixel = sl.fragment_coordinate().xy
        x = self.source.load(sl.ivec2(pixel)).rgb + self.bloom.sample(pixel / sl.vec2(self.source.size())).rgb
        return sl.vec4(sl.saturate(x * (2.51 * x + 0.03) / (x * (2.43 * x + 0.59) + 0.14)), 1.0)


# -- the scene -------------------------------------------------------------------------------------------------


@dataclass
class Scene:
    """Entities by id, from 1 on, and where the sun is."""

    sun: tuple[float, float, float] = (0.5, 0.8, 0.35)
    rows: dict[int, tuple[str, NDArray[np.void]]] = field(default_factory=dict)
    version: int = 0

    def add(
        self, mesh: str, model: NDArray[np.float64], color: tuple[float, float, float], emission: float = 0.0
    ) -> int:
        """Add an entity with a mesh, a (4, 4) transform and a linear color; return its id."""
        row = np.zeros((), Entity.dtype)
        row["id"] = max(self.rows, default=0) + 1
        row["color"], row["emission"] = color, emission
        self.rows[int(row["id"])] = mesh, row
        self.move(int(row["id"]), model)
        return int(row["id"])

    def move(self, id: int, model: NDArray[np.float64]) -> None:
        """Set an entity's transform."""
        row = self.rows[id][1]
        row["model"], row["normals"][:, :3] = model, normal_matrices(model)
        self.version += 1

    def remove(self, id: int) -> None:
        del self.rows[id]
        self.version += 1


class Engine:
    """A device's programs, meshes and targets, and the frames of a scene."""

    def __init__(self, device: rhi.Device, size: tuple[int, int], scene: Scene) -> None:
        self.device, self.scene, self.selected = device, scene, 0
        positions, normals, _, indices = make_cube()
        sphere, sphere_indices = make_sphere()
        vertices = {
            "position": np.concatenate([positions, sphere]),
            "normal": np.concatenate([normals, sphere]),
        }
        self.mesh = device.mesh(vertices, np.concatenate([indices, sphere_indices]), label="shapes")
        self.parts = {  # the first index and their number, and the first vertex
            "cube": (0, len(indices), 0),
            "sphere": (len(indices), len(sphere_indices), len(positions)),
        }
        self.screen = device.mesh(3)
        self.caster, self.forward = device.program(Caster), device.program(Forward)
        self.bright, self.tone_map = device.program(Bright), device.program(ToneMap)
        self.blurs = device.program(Blur), device.program(BlurDown)
        self.shadows = device.texture(SHADOW_MAP, Format.D32F, label="shadows")
        self.targets: list[rhi.Texture] = []
        self.resize(size)
        self._uploaded = -1

    def resize(self, size: tuple[int, int]) -> None:
        """Make targets of another size (width, height)."""
        for target in self.targets:
            target.destroy()
        quarter = (-(-size[0] // 4), -(-size[1] // 4))
        texture = self.device.texture
        self.image, self.light = texture(size, Format.RGBA8_SRGB), texture(size, Format.RGBA16F)
        self.ids, self.depth = texture(size, Format.R32UI, label="ids"), texture(size, Format.D32F)
        self.bloom, self.half_blurred = texture(quarter, Format.RGBA16F), texture(quarter, Format.RGBA16F)
        self.targets = [self.image, self.light, self.ids, self.depth, self.bloom, self.half_blurred]

    def _upload(self) -> None:
        """Upload the entities, sorted by mesh, if they have changed."""
        if self._uploaded == self.scene.version:
            return
        rows: list[NDArray[np.void]] = []
        draws = []
        for name, (first, count, base_vertex) in self.parts.items():
            of_mesh = [row for mesh, row in self.scene.rows.values() if mesh == name]
            draws.append(
                self.mesh.draws(
                    first,
                    count,
                    instances=len(of_mesh),
                    base_vertex=base_vertex,
                    base_instance=len(rows),
                )
            )
            rows += of_mesh
        self.draws = np.concatenate(draws)
        self.entities = self.device.storage(Entity, np.array(rows or 1, Entity.dtype))
        self._uploaded = self.scene.version

    def render(self, camera: Camera) -> rhi.Texture:
        """Draw a frame; return the image."""
        device = self.device
        self._upload()
        sun = np.array(self.scene.sun) / np.linalg.norm(self.scene.sun)
        view = View(
            view_projection=camera.view_projection,
            sun_projection=orthographic(-12, 12, -12, 12, 1, 60) @ look_at(sun * 30, (0, 0, 0)),
            sun=sun,
            selected=self.selected,
        )
        with (
            device.event("shadows"),
            device.render_pass(depth=self.shadows, clear_depth=0.0),
            device.states(CullMode.NONE, PolygonOffset(slope=-2)),
        ):
            device.draw_many(self.caster, self.mesh, self.draws, view=view, entities=self.entities)
        clear = [(0.25, 0.4, 0.7, 1), (0, 0, 0, 0)]
        with (
            device.event("forward"),
            device.render_pass([self.light, self.ids], self.depth, clear=clear, clear_depth=0.0),
        ):
            shadows = self.shadows.sampled(COMPARED)
            device.draw_many(
                self.forward, self.mesh, self.draws, view=view, entities=self.entities, shadows=shadows
            )
        with device.event("bloom"):
            self._fill(self.bright, self.bloom, source=self.light.sampled(CLAMPED))
            self._fill(self.blurs[0], self.half_blurred, source=self.bloom)
            self._fill(self.blurs[1], self.bloom, source=self.half_blurred)
        with device.event("tone map"):
            self._fill(self.tone_map, self.image, source=self.light, bloom=self.bloom.sampled(CLAMPED))
        return self.image

    def _fill(self, program: rhi.Program[...], target: rhi.Texture, **sources: object) -> None:
        with self.device.render_pass(target):
            self.device.draw(program, self.screen, **sources)

    def pick(self, x: int, y: int) -> int:
        """Return the id of the entity in a pixel, or 0. Only that texel is read back."""
        return int(self.ids.read(region=Region(x, y, 1, 1)).item())


# -- a program -------------------------------------------------------------------------------------------------


def make_scene() -> Scene:
    """A floor, columns, and balls that shine."""
    scene, rng = Scene(), np.random.default_rng(5)
    scene.add("cube", translation((0, -0.5, 0)) @ scaling((9, 0.5, 9)), (0.45, 0.45, 0.4))
    for x in range(-6, 7, 3):
        for z in range(-6, 7, 3):
            height = rng.uniform(0.4, 2.5)
            turned = translation((x, height, z)) @ rotation((0, 1, 0), rng.uniform(0, 1.5))
            scene.add("cube", turned @ scaling((0.5, height, 0.5)), tuple(rng.uniform(0.05, 0.6, 3)))
            top = translation((x, 2 * height + 0.5, z)) @ scaling(np.full(3, 0.45))
            scene.add("sphere", top, tuple(rng.uniform(0.2, 0.9, 3)), 6.0 * (rng.random() < 0.3))
    return scene


def render(device: rhi.Device, size: tuple[int, int]) -> rhi.Texture:
    """Draw one frame, click into its middle, and draw it with the entity there selected."""
    engine = Engine(device, size, make_scene())
    camera = Camera.look_at(
        (13, 10, 15), (0, 0.5, 0), projection=Perspective(np.radians(40), size[0] / size[1])
    )
    engine.render(camera)
    engine.selected = engine.pick(size[0] // 2, size[1] // 2)
    return engine.render(camera)


def run(screen: Screen) -> None:
    """Show the engine until the screen is closed: drags turn the camera, a double click selects."""
    engine = Engine(screen.device, screen.size, make_scene())
    orbit = OrbitCamera(screen, target=(0, 0.5, 0), distance=22)

    def click(event: dict[str, float]) -> None:
        ratio = screen.canvas.get_pixel_ratio()
        engine.selected = engine.pick(int(event["x"] * ratio), int(event["y"] * ratio))
        screen.canvas.request_draw()

    screen.canvas.add_event_handler(click, "double_click")
    with rhi.Reloader(screen.device, on_save=screen.canvas.request_draw) as reloader:
        reloader.watch(sys.modules[__name__])

        def draw() -> None:
            reloader.update()
            if screen.size != engine.image.size:
                engine.resize(screen.size)
            screen.show(engine.render(orbit.update()))

        screen.run(draw)


if __name__ == "__main__":
    if "--output" in sys.argv:
        save_image(render)
    else:
        with open_screen(title="mini engine") as window:
            run(window)
