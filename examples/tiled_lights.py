"""A small renderer on `rhi`: boxes as instances, a sun with a shadow map, 192 lights, MSAA, culling by
queries.

    python examples/tiled_lights.py [--backend NAME] [--frames N] [--output FILE.png]

The passes of a frame, and the part of the interface that each one shows:

1. `depth`: the boxes of all cells that were visible in the last frame: one `draw_many`.
2. `queries`: the bounds of every cell, tested against that depth: one `draw_counted`, read in the next frame.
3. `shadows`: all boxes as the sun sees them: one instanced draw with a slope-scaled depth bias.
4. `lights`: a compute shader finds, for each tile of 16×16 pixels, the lights that reach the depths in it.
5. `view`: the visible boxes again, with four samples a pixel, each lit by the lights of its tile, and
   resolved.

The same lines run on every backend that draws (tests/examples compares their images), and on the null device.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

import rhi
import rhi.shading as sl
from rhi.math import look_at, orthographic, perspective

TILE: Final = 16
LIGHTS: Final = 192
CELLS: Final = 12
"""Number of cells along each side of the plain; each has 5×5 boxes."""
SHADOW_SIZE: Final = 2048
SUN: Final = np.array([0.76, 0.46, 0.46])
HAZE: Final = sl.vec3(0.16, 0.20, 0.32)
NEAR: Final = 0.1
FOV: Final = 2 * np.arctan(1 / 1.7)  # vertical, in radians


class Vertex(sl.Struct):
    position: sl.vec3
    normal: sl.vec3


class View(sl.Struct):
    from_world: sl.mat4
    to_world: sl.mat4
    sun_from_world: sl.mat4
    eye: sl.vec3
    sun: sl.vec3
    size: sl.ivec2
    tiles: sl.ivec2


class Box(sl.Struct):
    center: sl.vec3
    half: sl.vec3
    color: sl.vec3


class PointLight(sl.Struct):
    position: sl.vec3
    reach: float
    color: sl.vec3


class Surface(sl.Struct):
    clip: sl.vec4
    world: sl.vec3
    normal: sl.vec3
    color: sl.vec3


@sl.function
def film_curve(color: sl.vec3) -> sl.vec3:
    """Narkowicz's fit of the ACES filmic curve."""
    return sl.saturate(color * (2.51 * color + 0.03) / (color * (2.43 * color + 0.59) + 0.14))


class Depth(sl.Shader):
    view: sl.Uniform[View]
    boxes: sl.Storage[Box]
    is_shadow = False

    def vertex(self, v: Vertex) -> sl.vec4:
        box = self.boxes[sl.instance_index()]
        world = sl.vec4(v.position * box.half + box.center, 1.0)
        if self.is_shadow:
            return self.view.sun_from_world @ world
        return self.view.from_world @ world


class Shadow(Depth):
    is_shadow = True


class CullLights(sl.Shader):
    """A work-group for each tile finds the range of depths in it, then the lights that reach the box around
    that range."""

    work_group = (TILE, TILE)
    view: sl.Uniform[View]
    lights: sl.Storage[PointLight]
    depth: sl.Texture2D
    counts: sl.StorageRW[int]
    lists: sl.StorageRW[int]
    depths = sl.shared(
        int, 2
    )  # bits of the nearest and the farthest depth: positive floats are ordered like ints
    light_count = sl.shared(int, 1)

    def unproject(self, pixel: sl.vec2, depth: float) -> sl.vec3:
        size = sl.vec2(self.view.size)
        point = self.view.to_world @ sl.vec4(
            pixel.x / size.x * 2.0 - 1.0, 1.0 - pixel.y / size.y * 2.0, depth, 1.0
        )
        return point.xyz / point.w

    def compute(self) -> None:
        if sl.local_index() == 0:
            self.depths[0] = 0
            self.depths[1] = sl.float_bits_to_int(1.0)
            self.light_count[0] = 0
        sl.barrier()
        pixel = sl.global_id().xy
        if pixel.x < self.view.size.x and pixel.y < self.view.size.y:
            depth = self.depth.load(pixel).x
            if depth > 0.0:  # otherwise it is the sky
                sl.atomic_max(self.depths[0], sl.float_bits_to_int(depth))
                sl.atomic_min(self.depths[1], sl.float_bits_to_int(depth))
        sl.barrier()
        near = sl.int_bits_to_float(self.depths[0])
        far = sl.int_bits_to_float(self.depths[1])
        tile = sl.group_id().y * self.view.tiles.x + sl.group_id().x
        if near > 0.0:
            low = sl.vec3(1e9)
            high = sl.vec3(-1e9)
            for i in range(8):
                corner = (sl.vec2(sl.group_id().xy) + sl.vec2(float(i & 1), float(i >> 1 & 1))) * float(TILE)
                point = self.unproject(corner, far if i < 4 else near)
                low = sl.min(low, point)
                high = sl.max(high, point)
            for first in range(0, len(self.lights), TILE * TILE):
                i = first + sl.local_index()
                if i < len(self.lights):
                    point_light = self.lights[i]
                    if (
                        sl.distance(sl.clamp(point_light.position, low, high), point_light.position)
                        < point_light.reach
                    ):
                        self.lists[tile * LIGHTS + sl.atomic_add(self.light_count[0], 1)] = i
        sl.barrier()
        if sl.local_index() == 0:
            self.counts[tile] = self.light_count[0]


class Lit(sl.Shader):
    precision = sl.Precision.FAST  # small powers of cosines may become 0
    view: sl.Uniform[View]
    boxes: sl.Storage[Box]
    lights: sl.Storage[PointLight]
    counts: sl.Storage[int]
    lists: sl.Storage[int]
    shadow: sl.DepthTexture2D

    def vertex(self, v: Vertex) -> Surface:
        box = self.boxes[sl.instance_index()]
        world = v.position * box.half + box.center
        return Surface(
            clip=self.view.from_world @ sl.vec4(world, 1.0), world=world, normal=v.normal, color=box.color
        )

    def sunlight(self, world: sl.vec3) -> float:
        """Return the fraction of sunlight that arrives: the mean of four filtered comparisons."""
        at = self.view.sun_from_world @ sl.vec4(world, 1.0)
        uv = sl.vec2(at.x * 0.5 + 0.5, 0.5 - at.y * 0.5)
        step = 0.75 / SHADOW_SIZE
        lit = self.shadow.sample_compare(uv + sl.vec2(-step, -step), at.z)
        lit += self.shadow.sample_compare(uv + sl.vec2(step, -step), at.z)
        lit += self.shadow.sample_compare(uv + sl.vec2(-step, step), at.z)
        lit += self.shadow.sample_compare(uv + sl.vec2(step, step), at.z)
        return lit / 4.0

    def fragment(self, s: Surface) -> sl.vec4:
        normal = sl.normalize(s.normal)
        to_eye = sl.normalize(self.view.eye - s.world)
        light = sl.mix(sl.vec3(0.03, 0.025, 0.03), sl.vec3(0.05, 0.08, 0.15), normal.y * 0.5 + 0.5)
        facing = sl.dot(normal, self.view.sun)
        if facing > 0.0:
            light += sl.vec3(0.95, 0.55, 0.30) * (facing * self.sunlight(s.world + 0.04 * normal))
        shine = sl.vec3(0.0)
        at = sl.ivec2(sl.fragment_coordinate().xy) // TILE
        tile = sl.uniform(
            at.y * self.view.tiles.x + at.x
        )  # a block of pixels lies in one tile: its list is read once
        for k in range(self.counts[tile]):
            point_light = self.lights[self.lists[tile * LIGHTS + k]]
            to_light = point_light.position - s.world
            far = sl.length(to_light)
            direction = to_light / max(far, 1e-3)
            window = sl.saturate(1.0 - (far / point_light.reach) ** 4)
            power = point_light.color * (
                window * window / (far * far + 0.05) * sl.saturate(sl.dot(normal, direction))
            )
            light += power
            shine += power * sl.saturate(sl.dot(normal, sl.normalize(direction + to_eye))) ** 32
        color = s.color * light + 0.6 * shine
        haze = 1.0 - sl.exp(-0.006 * sl.distance(self.view.eye, s.world))
        return sl.vec4(film_curve(sl.mix(color, HAZE, haze)), 1.0)


class Renderer:
    """The scene on a device, and the passes that draw it."""

    def __init__(self, device: rhi.Device, size: tuple[int, int] = (960, 540), samples: int = 4) -> None:
        self.device, self.size = device, size
        self.tiles = (-(-size[0] // TILE), -(-size[1] // TILE))
        self.depth_only, self.shadow_only = device.program(Depth), device.program(Shadow)
        self.cull_lights, self.lit = device.program(CullLights), device.program(Lit)
        self.sky = (*sl.evaluate(film_curve, HAZE).tolist(), 1.0)  # the shader's function, evaluated on NumPy
        self.image = device.texture(size, rhi.Format.RGBA8_SRGB, label="image")
        self.colors = device.texture(size, rhi.Format.RGBA8_SRGB, samples=samples, label="samples of color")
        self.depths = device.texture(size, rhi.Format.D32F, samples=samples, label="samples of depth")
        self.depth = device.texture(size, rhi.Format.D32F, label="depth")
        self.shadow_map = device.texture((SHADOW_SIZE, SHADOW_SIZE), rhi.Format.D32F, label="shadow map")
        border = rhi.Wrap.BORDER  # its depth is 0, the farthest one: points outside of the map are lit
        self.shadow = self.shadow_map.sampled(
            rhi.SamplerDescriptor(
                compare=rhi.Comparison.GREATER_EQUAL, mip=None, wrap_u=border, wrap_v=border
            )
        )
        self.cube = device.mesh(*make_cube(), label="cube")
        boxes, self.first = make_boxes()
        self.count = np.diff(self.first)
        bounds = np.zeros(len(self.count), Box.dtype)
        low = np.minimum.reduceat(boxes["center"] - boxes["half"], self.first[:-1])
        high = np.maximum.reduceat(boxes["center"] + boxes["half"], self.first[:-1])
        bounds["center"], bounds["half"] = (low + high) / 2, (high - low) / 2 + 0.01
        self.boxes = device.storage(Box, boxes, label="boxes")
        self.bounds = device.storage(Box, bounds, label="bounds of cells")
        self.lights = device.storage(PointLight, make_lights(boxes), label="lights")
        tiles = self.tiles[0] * self.tiles[1]
        self.counts = device.storage(int, tiles, label="lights of each tile")
        self.lists = device.storage(int, tiles * LIGHTS, label="light lists")
        self.queries = device.query_set(len(self.count))
        self.visible = np.ones(len(self.count), bool)
        self.is_queried = False

    def render(self, eye: tuple[float, float, float], target: tuple[float, float, float]) -> None:
        """Render and present a frame."""
        device = self.device
        if self.is_queried:  # last frame's results: a cell that comes into view is drawn one frame late
            self.visible = self.queries.wait() != 0
        from_world = perspective(FOV, self.size[0] / self.size[1], NEAR) @ look_at(eye, target)
        view = device.transient.uniform(
            View(
                from_world=from_world,
                to_world=np.linalg.inv(from_world),
                sun_from_world=orthographic(-50, 50, -50, 50, 0, 120) @ look_at(SUN * 60, (0, 0, 0)),
                eye=eye,
                sun=SUN / np.linalg.norm(SUN),
                size=self.size,
                tiles=self.tiles,
            )
        )
        cells = np.flatnonzero(self.visible)
        draws = self.cube.draws(
            np.zeros(len(cells), int), instances=self.count[cells], base_instance=self.first[cells]
        )
        with device.event("depth"), device.render_pass(depth=self.depth, clear_depth=0.0):
            device.draw_many(self.depth_only, self.cube, draws, view=view, boxes=self.boxes)
        every = self.cube.draws(np.zeros(len(self.count), int), base_instance=np.arange(len(self.count)))
        unseen = (rhi.CullMode.NONE, rhi.DepthWrite.OFF, rhi.DepthFunction.GREATER_EQUAL)
        with device.event("queries"), device.render_pass(depth=self.depth), device.states(*unseen):
            device.draw_counted(self.depth_only, self.cube, every, self.queries, view=view, boxes=self.bounds)
        self.is_queried = True
        with (
            device.event("shadows"),
            device.render_pass(depth=self.shadow_map, clear_depth=0.0),
            device.states(rhi.PolygonOffset(slope=-2.0)),  # away from the sun, since depth is reversed
        ):
            device.draw(self.shadow_only, self.cube, len(self.boxes), view=view, boxes=self.boxes)
        with device.event("lights"):
            device.dispatch(
                self.cull_lights,
                self.tiles,
                view=view,
                lights=self.lights,
                depth=self.depth,
                counts=self.counts,
                lists=self.lists,
            )
        with (
            device.event("view"),
            device.render_pass(self.colors, self.depths, clear=self.sky, clear_depth=0.0, resolve=self.image),
        ):
            device.draw_many(
                self.lit,
                self.cube,
                draws,
                view=view,
                boxes=self.boxes,
                shadow=self.shadow,
                lights=self.lights,
                counts=self.counts,
                lists=self.lists,
            )
        device.present(self.image)


def make_cube() -> tuple[NDArray[np.void], NDArray[np.uint16]]:
    """Make the vertices and indices of a cube from -1 to 1, with faces counter-clockwise from outside."""
    vertices = np.zeros((6, 4), Vertex.dtype)
    u, v = np.array([-1, 1, 1, -1]), np.array([-1, -1, 1, 1])
    for face in range(6):
        axis, sign = face // 2, 1 - face % 2 * 2
        vertices["normal"][face, :, axis] = sign
        vertices["position"][face, :, axis] = sign
        vertices["position"][face, :, (axis + 1) % 3] = u * sign
        vertices["position"][face, :, (axis + 2) % 3] = v
    indices = np.arange(6)[:, None] * 4 + [0, 1, 2, 0, 2, 3]
    return vertices.ravel(), indices.ravel().astype(np.uint16)


def make_boxes() -> tuple[NDArray[np.void], NDArray[np.intp]]:
    """Make cells of 5×5 boxes on a plate; return the boxes sorted by cell, and the index of each cell's first
    box, followed by the number of boxes."""
    rng = np.random.default_rng(7)
    boxes = np.zeros((CELLS, CELLS, 26), Box.dtype)
    x, z = np.meshgrid(np.arange(CELLS), np.arange(CELLS), indexing="ij")
    middle = (np.stack([x, np.zeros_like(x), z], -1) - [CELLS / 2 - 0.5, 0, CELLS / 2 - 0.5]) * 7.0
    i, k = np.meshgrid(np.arange(5), np.arange(5), indexing="ij")
    offset = np.stack([i, np.zeros_like(i), k], -1).reshape(25, 3) * 1.25 - [2.5, 0, 2.5]
    centers = middle[:, :, None] + offset
    tall = 0.12 + 1.9 * rng.random((CELLS, CELLS, 25)) ** 4
    tall += 3.0 * rng.random((CELLS, CELLS, 25)) ** 16
    centers[..., 1] = tall
    boxes["center"][:, :, :25] = centers
    boxes["half"][:, :, :25] = np.stack([0.45 + 0 * tall, tall, 0.45 + 0 * tall], -1)
    hue = rng.random((CELLS, CELLS, 1, 1)) * 0.9 + rng.random((CELLS, CELLS, 25, 1)) * 0.2 + [0, 0.33, 0.67]
    boxes["color"][:, :, :25] = 0.5 + 0.07 * np.cos(2 * np.pi * hue)
    boxes["center"][:, :, 25] = middle - [0, 0.1, 0]
    boxes["half"][:, :, 25] = (3.5, 0.1, 3.5)
    boxes["color"][:, :, 25] = np.where((x + z)[..., None] % 2, 0.36, 0.42)
    return boxes.ravel(), np.arange(0, CELLS * CELLS * 26 + 1, 26)


def make_lights(boxes: NDArray[np.void]) -> NDArray[np.void]:
    """Make lights of all colours between the boxes."""
    rng = np.random.default_rng(11)
    lights = np.zeros(LIGHTS, PointLight.dtype)
    near = boxes[rng.choice(len(boxes), len(lights), replace=False)]
    lights["position"] = near["center"] * (1, 0, 1) + [0.62, 0.45, 0.62]
    lights["reach"] = rng.uniform(3.0, 5.0, len(lights))
    hue = rng.random((len(lights), 1)) + np.array([0, 0.33, 0.67])
    lights["color"] = 1.6 + 1.4 * np.cos(2 * np.pi * hue)
    return lights


def main(arguments: list[str] | None = None) -> int:
    """Render frames along a short path and write the last one to a file."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--backend", help="gl, cl, null (default: RHI_BACKEND, or the first that works)")
    parser.add_argument("--frames", type=int, default=8, help="number of frames (default: 8)")
    parser.add_argument(
        "--output",
        type=Path,
        default=Path("tiled_lights.png"),
        help="image to write (default: tiled_lights.png)",
    )
    options = parser.parse_args(arguments)
    with rhi.create_device(options.backend, timing=True) as device:
        if device.backend_name == "null":
            from rhi.backends.null import NullBackend

            device.backend_as(NullBackend).count_samples(lambda draw: 1)  # everything is visible
        renderer = Renderer(device)
        for frame in range(options.frames):
            renderer.render((15.0 - 0.05 * frame, 7.5, 31.0), (-1.0, 0.0, 0.0))
        device.finish()
        print(f"{device.backend_name}, {device.capabilities.device}")
        print(f"{renderer.visible.sum()} of {len(renderer.visible)} cells seen")
        for timer in device.timers:
            print(timer.format())
        if device.capabilities.renders:
            renderer.image.save(options.output)
            print(options.output)
    return 0


if __name__ == "__main__":
    sys.exit(main())
