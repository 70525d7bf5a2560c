"""The OpenCL rasteriser compared with Mesa's llvmpipe: the same calls of rhi on both, on the same cores.

The scene is a city of 1,936 blocks with 1.14 million triangles. The passes:

- depth, depth_sky: depth only, in one draw, from the ground and from the sky.
- lit, lit_sky: depth and lit color, in one draw, from the ground and from the sky.
- small: depth of the same city with 12 triangles per block, from the ground.
- draws: the same as `depth`, in one draw for each block.
- queries: 1,000 boxes are counted with one query set, and then all answers are read.
- waited: a tenth as many boxes; each query is read before the next one begins.
- lights: a full screen shaded with 64 lights.
- taps: a full screen with 4 bilinear samples per pixel.
- growth: the exponents of time ~ work^slope for triangles, pixels and lights on cl, fitted to processor time.

The backends take turns, round by round, in one process. A time runs from the first command until the device is
finished; figures are medians. "ratio" is gl's time divided by cl's, the median of the rounds' ratios. "processor" is
the same ratio of processor time over all threads, which stays valid on a machine that does other work, too.

    python benchmarks/raster.py [--json] [--rounds 9] [--size 1280x720] [--passes depth,lit,…]
"""

from __future__ import annotations

import argparse
import json
import math
import os
import sys
import time
from collections.abc import Callable
from pathlib import Path
from statistics import median
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

sys.path.insert(0, str(Path(__file__).parents[1]))

os.environ.setdefault("RHI_KERNELS", "optimised")  # what is measured is the speed of a long run

import rhi
from rhi import CullMode, DepthTest, DepthWrite, Device, Format
from rhi.shading import (
    Shader,
    Storage,
    Struct,
    Texture2D,
    Uniform,
    dot,
    fragment_coordinate,
    inversesqrt,
    mat4,
    max,
    normalize,
    vec2,
    vec3,
    vec4,
)

BLOCKS: Final = 44
DETAIL: Final = 7
LIGHTS: Final = 64
QUERIES: Final = 1000
EYES: Final = {"ground": ((-120, 2, 3), (0, 4, 3)), "sky": ((-150, 80, -150), (0, 0, 0))}


class Vertex(Struct):
    position: vec3
    normal: vec3


class Box(Struct):
    lower: vec3
    upper: vec3


class View(Struct):
    matrix: mat4


class Surface(Struct):
    clip: vec4
    place: vec3
    normal: vec3


class Light(Struct):
    place: vec3
    strength: float
    color: vec3


class Depth(Shader):
    view: Uniform[View]

    def vertex(self, v: Vertex) -> vec4:
        return self.view.matrix @ vec4(v.position, 1.0)


class Lit(Shader):
    view: Uniform[View]

    def vertex(self, v: Vertex) -> Surface:
        return Surface(clip=self.view.matrix @ vec4(v.position, 1.0), place=v.position, normal=v.normal)

    def fragment(self, s: Surface) -> vec4:
        light = max(dot(normalize(s.normal), normalize(vec3(1.0, 2.0, 3.0) - s.place)), 0.0)
        return vec4(vec3(1.0, 0.5, 0.2) * light, 1.0)


class Boxes(Shader):
    view: Uniform[View]

    def vertex(self, v: Vertex, box: Box) -> vec4:
        return self.view.matrix @ vec4(box.lower + (box.upper - box.lower) * v.position, 1.0)


class Corner(Struct):
    position: vec2


class Lights(Shader):
    lights: Storage[Light]

    def vertex(self, v: Corner) -> vec4:
        return vec4(v.position, 0.0, 1.0)

    def fragment(self) -> vec4:
        at = fragment_coordinate()
        place = vec3(at.x * 0.05, at.y * 0.05, 0.0)
        color = vec3(0.0)
        for i in range(len(self.lights)):
            light = self.lights[i]
            away = light.place - place
            distance = dot(away, away) + 0.01
            color += light.color * (light.strength * max(away.z, 0.0) * inversesqrt(distance) / distance)
        return vec4(color, 1.0)


class Taps(Shader):
    image: Texture2D

    def vertex(self, v: Corner) -> vec4:
        return vec4(v.position, 0.0, 1.0)

    def fragment(self) -> vec4:
        at = vec2(fragment_coordinate().x, fragment_coordinate().y) * 0.0011
        sum = self.image.sample_lod(at, 0.0) + self.image.sample_lod(at + vec2(0.0013, 0.0), 0.0)
        sum += self.image.sample_lod(at + vec2(0.0, 0.0013), 0.0) + self.image.sample_lod(
            at + vec2(0.0013), 0.0
        )
        return sum * 0.25


def make_box(detail: int) -> tuple[NDArray[Any], NDArray[np.uint32]]:
    """Return the vertices and indices of a cube with edges of 2, each face split into detail² quads."""
    steps = np.linspace(-1, 1, detail + 1)
    u, v = (a.ravel() for a in np.meshgrid(steps, steps, indexing="ij"))
    quad = np.arange(detail)[:, None] * (detail + 1) + np.arange(detail)
    a, b = quad.ravel(), quad.ravel() + detail + 1
    face = np.stack([a, b, b + 1, a, b + 1, a + 1], axis=1).ravel()
    rows = np.zeros((6, len(u)), Vertex.dtype)
    for axis in range(3):
        for side in (0, 1):
            row, sign = rows[2 * axis + side], 2 * side - 1
            row["position"][:, axis], row["normal"][:, axis] = sign, sign
            row["position"][:, (axis + 1) % 3], row["position"][:, (axis + 2) % 3] = u, v * sign
    indices = face[None, :] + np.arange(6)[:, None] * len(u)
    return rows.ravel(), indices.ravel().astype(np.uint32)


def make_city(blocks: int, detail: int) -> tuple[NDArray[Any], NDArray[np.uint32], NDArray[Any]]:
    """Return the vertices, indices and bounding boxes of blocks² boxes."""
    vertices, indices = make_box(detail)
    x, z = (
        a.ravel() * 6.0 - blocks * 3 for a in np.meshgrid(np.arange(blocks), np.arange(blocks), indexing="ij")
    )
    height = np.random.default_rng(0).uniform(2, 20, len(x))
    center = np.stack([x, height, z], axis=1)
    half = np.stack([np.full(len(x), 2.0), height, np.full(len(x), 2.0)], axis=1)
    rows = np.tile(vertices, (len(x), 1))
    rows["position"] = rows["position"] * half[:, None] + center[:, None]
    boxes = np.zeros(len(x), Box.dtype)
    boxes["lower"], boxes["upper"] = center - 1.02 * half, center + 1.02 * half
    every = indices[None, :] + np.arange(len(x), dtype=np.uint32)[:, None] * len(vertices)
    return rows.ravel(), every.ravel(), boxes


def make_matrix(eye: tuple[float, ...], target: tuple[float, ...], aspect: float) -> NDArray[np.float32]:
    """Return the matrix from world to clip space, with reversed depth from 0.5 to 600."""
    away = np.subtract(eye, target) / np.linalg.norm(np.subtract(eye, target))
    right = np.cross((0, 1, 0), away) / np.linalg.norm(np.cross((0, 1, 0), away))
    look = np.eye(4)
    look[:3, :3] = right, np.cross(away, right), away
    look[:3, 3] = -look[:3, :3] @ eye
    near, far, scale = 0.5, 600.0, 1 / math.tan(0.5)
    clip = np.diag([scale / aspect, scale, near / (far - near), 0.0])
    clip[2, 3], clip[3, 2] = near * far / (far - near), -1.0
    return (clip @ look).astype(np.float32)


class Bench:
    """The resources and passes of the benchmark on one device."""

    def __init__(self, backend: str, size: tuple[int, int]) -> None:
        self.device: Device = rhi.create_device(backend)
        device = self.device
        self.color = device.texture(size, Format.RGBA8)
        self.depth = device.texture(size, Format.D32F)
        vertices, indices, boxes = make_city(BLOCKS, DETAIL)
        self.city = device.mesh(vertices, indices)
        self.small = device.mesh(*make_city(BLOCKS, 1)[:2])
        count = len(indices) // BLOCKS**2
        self.parts = [self.city.view(first=i * count, count=count) for i in range(BLOCKS**2)]
        corners, box_indices = make_box(1)
        corners["position"] = corners["position"] * 0.5 + 0.5
        chosen = boxes[np.linspace(0, len(boxes) - 1, QUERIES).astype(int)]
        mesh = device.mesh(corners, box_indices, instances=chosen)
        self.boxes = mesh
        self.box_draws = mesh.draws(base_instance=np.arange(QUERIES))
        self.box_parts = [mesh.view(base_instance=i) for i in range(QUERIES // 10)]
        self.query, self.queries = device.occlusion_query(), device.query_set(QUERIES)
        screen = np.zeros(3, Corner.dtype)
        screen["position"] = [(-1, -1), (3, -1), (-1, 3)]
        self.screen = device.mesh(screen)
        lights = np.zeros(LIGHTS, device.storage(Light, 1).dtype)
        rng = np.random.default_rng(1)
        lights["place"], lights["color"] = (
            rng.uniform((0, 0, 1), (64, 36, 4), (LIGHTS, 3)),
            rng.random((LIGHTS, 3)),
        )
        lights["strength"] = 1.0
        self.lights = lights
        texels = rng.integers(0, 256, (512, 512, 4), np.uint8)
        image = device.texture((512, 512), Format.RGBA8)
        image.write(texels)
        self.image = image
        aspect = size[0] / size[1]
        self.views = {
            name: device.uniform(View(matrix=make_matrix(*eyes, aspect))) for name, eyes in EYES.items()
        }

    def draw_depth(self, path: str, mesh: rhi.Mesh | None = None) -> None:
        """Draw the depth of the city, or of another mesh, in one draw."""
        with self.device.render_pass(depth=self.depth, clear_depth=0.0):
            self.device.draw(self.device.program(Depth), mesh or self.city, view=self.views[path])

    def draw_parts(self) -> None:
        """Draw the depth of the city with one draw for each block."""
        program, view, draw = self.device.program(Depth), self.views["ground"], self.device.draw
        with self.device.render_pass(depth=self.depth, clear_depth=0.0):
            for part in self.parts:
                draw(program, part, view=view)

    def draw_lit(self, path: str) -> None:
        """Draw the depth and the color of the city."""
        with self.device.render_pass(self.color, self.depth, clear=(0, 0, 0, 1), clear_depth=0.0):
            self.device.draw(self.device.program(Lit), self.city, view=self.views[path])

    def count_boxes(self, waits: bool) -> None:
        """Count the visible samples of boxes: all at once, or, with `waits`, a tenth of them one by one."""
        device, program, view = self.device, self.device.program(Boxes), self.views["ground"]
        with device.render_pass(depth=self.depth), device.states(CullMode.NONE, DepthWrite.OFF):
            if not waits:
                device.draw_counted(program, self.boxes, self.box_draws, self.queries, view=view)
            for box in self.box_parts if waits else ():
                with self.query:
                    device.draw(program, box, view=view)
                self.query.wait()
        if not waits:
            self.queries.wait()

    def fill(self, program: Any, **bindings: Any) -> None:
        """Draw a full-screen triangle."""
        with self.device.render_pass(self.color), self.device.states(DepthTest.OFF, DepthWrite.OFF):
            self.device.draw(program, self.screen, **bindings)

    def make_work(self, name: str) -> Callable[[], None]:
        """Return the function that executes the pass of this name, after preparing what it reads."""
        device = self.device
        if name in ("queries", "waited"):
            self.draw_depth("ground")
        lights = device.storage(Light, self.lights)
        work: dict[str, Callable[[], None]] = {
            "depth": lambda: self.draw_depth("ground"),
            "depth_sky": lambda: self.draw_depth("sky"),
            "small": lambda: self.draw_depth("ground", self.small),
            "draws": self.draw_parts,
            "lit": lambda: self.draw_lit("ground"),
            "lit_sky": lambda: self.draw_lit("sky"),
            "queries": lambda: self.count_boxes(waits=False),
            "waited": lambda: self.count_boxes(waits=True),
            "lights": lambda: self.fill(device.program(Lights), lights=lights),
            "taps": lambda: self.fill(device.program(Taps), image=self.image),
        }
        return work[name]


PASSES: Final = (
    "depth",
    "depth_sky",
    "small",
    "draws",
    "lit",
    "lit_sky",
    "queries",
    "waited",
    "lights",
    "taps",
)


def measure(benches: dict[str, Bench], name: str, rounds: int) -> list[dict[str, Any]]:
    """Measure a pass; return one row for each backend."""
    work = {backend: bench.make_work(name) for backend, bench in benches.items()}
    times: dict[str, list[tuple[float, float]]] = {backend: [] for backend in benches}
    for number in range(-2, rounds):
        for backend, bench in benches.items():
            began, spent = time.perf_counter(), time.process_time()
            work[backend]()
            bench.device.finish()
            if number >= 0:
                times[backend].append((time.perf_counter() - began, time.process_time() - spent))
    base = times["gl"]
    rows = []
    for backend, mine in times.items():
        ratio, processor = (median(b[i] / m[i] for b, m in zip(base, mine, strict=True)) for i in range(2))
        milliseconds = 1e3 * median(each[0] for each in mine)
        rows.append(
            {
                "pass": name,
                "backend": backend,
                "milliseconds": round(milliseconds, 2),
                "ratio": round(ratio, 2),
                "processor": round(processor, 2),
            }
        )
    return rows


def measure_growth(rounds: int) -> dict[str, float]:
    """Return the slope of log processor time over log work on cl, for triangles, pixels and lights."""

    def time_of(work: Callable[[], None], device: Device) -> float:
        spent = []
        for number in range(rounds + 2):
            began = time.process_time()
            work()
            device.finish()
            if number > 1:
                spent.append(time.process_time() - began)
        return median(spent)

    slopes: dict[str, float] = {}
    with rhi.create_device("cl") as device:
        view = device.uniform(View(matrix=make_matrix(*EYES["sky"], 16 / 9)))
        depth = device.texture((1280, 720), Format.D32F)
        program = device.program(Depth)
        points: dict[str, list[tuple[float, float]]] = {"triangles": [], "pixels": [], "lights": []}
        for detail in (3, 4, 6, 8):  # finer quads on the facades: the same picture with more triangles
            vertices, indices, _ = make_city(BLOCKS, detail)
            with device.mesh(vertices, indices) as mesh:

                def draw(mesh: rhi.Mesh = mesh) -> None:
                    with device.render_pass(depth=depth, clear_depth=0.0):
                        device.draw(program, mesh, view=view)

                points["triangles"].append((len(indices), time_of(draw, device)))
        screen = np.zeros(3, Corner.dtype)
        screen["position"] = [(-1, -1), (3, -1), (-1, 3)]
        shaded, full = device.program(Lights), device.mesh(screen)
        table = np.ones(64, device.storage(Light, 1).dtype)
        for what, sizes in (
            ("pixels", [((w, w), 32) for w in (512, 1024, 2048)]),
            ("lights", [((1024, 1024), n) for n in (16, 32, 64)]),
        ):
            for size, count in sizes:
                lights = device.storage(Light, table[:count])
                with device.texture(size, Format.RGBA8) as image:

                    def shade(image: rhi.Texture = image, lights: Any = lights) -> None:
                        with device.render_pass(image), device.states(DepthTest.OFF, DepthWrite.OFF):
                            device.draw(shaded, full, lights=lights)

                    amount = count if what == "lights" else size[0] * size[1]
                    points[what].append((amount, time_of(shade, device)))
        for what, pairs in points.items():
            amounts, seconds = np.log(np.array(pairs)).T
            slopes[what] = round(float(np.polyfit(amounts, seconds, 1)[0]), 2)
    return slopes


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--json", action="store_true", help="print the result as JSON")
    parser.add_argument("--rounds", type=int, default=9, help="rounds of each pass (default: %(default)s)")
    parser.add_argument("--size", default="1280x720", metavar="WxH", help="size of the image (default: %(default)s)")
    parser.add_argument(
        "--passes",
        default=",".join((*PASSES, "growth")),
        metavar="A,B,…",
        help="passes to measure (default: all)",
    )
    given = parser.parse_args()
    width, height = map(int, given.size.split("x"))
    names = given.passes.split(",")
    benches = {backend: Bench(backend, (width, height)) for backend in ("gl", "cl")}
    rows = [row for name in names if name != "growth" for row in measure(benches, name, given.rounds)]
    for bench in benches.values():
        bench.device.close()
    growth = measure_growth(given.rounds) if "growth" in names else {}
    if given.json:
        print(json.dumps({"size": [width, height], "rows": rows, "growth": growth}))
        return
    print(f"{'pass':<10} {'backend':<8} {'ms':>8} {'ratio':>7} {'processor':>10}")
    for row in rows:
        print(
            f"{row['pass']:<10} {row['backend']:<8} {row['milliseconds']:>8} {row['ratio']:>7} {row['processor']:>10}"
        )
    for what, slope in growth.items():
        print(f"time grows with {what}^{slope}")


if __name__ == "__main__":
    main()
