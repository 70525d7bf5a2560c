"""Growth of a pass's time with triangles, pixels and lights on gl and cl, with the fitted slopes.

- triangles: a sheet of equal triangles that fills the image, depth only, with 2,048 to 2,097,152 triangles.
- pixels: a lit city, at 160×90 to 2560×1440.
- lights: a full-screen triangle whose fragments sum 1 to 256 point lights.
- draws: the depth of a city in one draw (0 in the column of sizes), and in 1,936 draws, one for each object
  (1).
- taps, taps_srgb, taps_half, taps_float: a full-screen triangle that takes 4 bilinear samples of a 512×512
  texture: RGBA8, RGBA8_SRGB, RGBA16F and RGBA32F.

Images have 1280×720 pixels in all series but `pixels`. The backends take turns, round by round; times are
medians, and the ratio is gl's time divided by cl's. A slope is the exponent p in `time = c · n^p`: with 1,
twice the work takes twice as long. The one or two smallest sizes of a series aren't fitted, since fixed costs
dominate them.

    python benchmarks/backends.py [--json] [--plot docs/images/backends.png] [--rounds 9] [--only
    lights,draws]
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack
from functools import partial
from typing import Any, Final

import numpy as np

import rhi
from renderer.cli import options
from renderer.cli.comparison import run_benchmark
from renderer.cli.output import show_progress
from renderer.content import load_scene, parse_camera_path
from renderer.lab.comparison import Record, Subject, compare, ratio, time
from renderer.lab.measure.backend_passes import BackendPasses, DepthShader
from rhi import CullMode, Device, Format, Mesh
from rhi.contract.texels import encode
from rhi.shading import Shader, Storage, Struct, Texture2D, Uniform, dot, max, vec2, vec3, vec4

BACKENDS = ("gl", "cl")
SIZE = (1280, 720)
COLUMNS: Final = {"ms": time(), "ratio": ratio(inverse=True)}
Work = Callable[[int], object]


class Position(Struct):
    position: vec4


class Varyings(Struct):
    clip: vec4
    uv: vec2


class Light(Struct):
    position: vec3
    color: vec3


class Scale(Struct):
    factor: float


class DepthOnly(Shader):
    """Passes positions through, and writes depth only."""

    def vertex(self, v: Position) -> vec4:
        return v.position

    def fragment(self) -> None:
        pass


class Lights(Shader):
    """A curved surface lit by point lights."""

    lights: Storage[Light]

    def vertex(self, v: Position) -> Varyings:
        return Varyings(clip=v.position, uv=v.position.xy)

    def fragment(self, v: Varyings) -> vec4:
        normal = vec3(v.uv * 0.3, 1.0)
        position = vec3(v.uv, dot(v.uv, v.uv) * 0.1)
        color = vec3(0.0)
        for i in range(len(self.lights)):
            away = self.lights[i].position - position
            squared = dot(away, away)
            color += self.lights[i].color * (max(dot(normal, away), 0.0) / (squared * (1.0 + squared)))
        return vec4(color, 1.0)


class Taps(Shader):
    """The mean of four bilinear samples."""

    image: Texture2D
    scale: Uniform[Scale]

    def vertex(self, v: Position) -> Varyings:
        return Varyings(clip=v.position, uv=v.position.xy * 0.5 + 0.5)

    def fragment(self, v: Varyings) -> vec4:
        uv = v.uv * self.scale.factor
        total = self.image.sample_lod(uv, 0.0) + self.image.sample_lod(uv + vec2(0.013, 0.0), 0.0)
        total += self.image.sample_lod(uv + vec2(0.0, 0.013), 0.0)
        return (total + self.image.sample_lod(uv + vec2(0.013, 0.013), 0.0)) * 0.25


FULL = np.array([(-1, -1, 0.5, 1), (3, -1, 0.5, 1), (-1, 3, 0.5, 1)], np.float32)


def draw_grid(device: Device, triangles: int) -> Work:
    side = round((triangles / 2) ** 0.5)
    axis = np.linspace(-1, 1, side + 1, dtype=np.float32)
    positions = np.full((side + 1, side + 1, 4), (0, 0, 0.5, 1), np.float32)
    positions[..., 0], positions[..., 1] = axis, axis[:, None]
    corner = np.arange(side)[:, None] * (side + 1) + np.arange(side)
    quad = np.stack([corner, corner + 1, corner + side + 2, corner, corner + side + 2, corner + side + 1], -1)
    mesh = device.mesh({"position": positions.reshape(-1, 4)}, quad.reshape(-1).astype(np.uint32))
    depth, program = device.texture(SIZE, Format.D32F), device.program(DepthOnly)

    def work(_: int) -> None:
        with device.render_pass(depth=depth, clear_depth=0.0), device.states(CullMode.NONE):
            device.draw(program, mesh)
        device.finish()

    return work


def draw_screen(device: Device, shader: type[Shader], **bindings: Any) -> Work:
    mesh, program = device.mesh({"position": FULL}), device.program(shader)
    image = device.texture(SIZE, Format.RGBA8)

    def work(_: int) -> None:
        with device.render_pass(image), device.states(CullMode.NONE):
            device.draw(program, mesh, **bindings)
        device.finish()

    return work


def draw_lights(device: Device, count: int) -> Work:
    rng = np.random.default_rng(0)
    lights = np.zeros(count, Light.dtype)
    lights["position"] = rng.uniform((-1, -1, 0.2), (1, 1, 1), (count, 3))
    lights["color"] = rng.random((count, 3)) / count
    return draw_screen(device, Lights, lights=device.storage(Light, lights))


def draw_taps(format: Format, device: Device, _: int) -> Work:
    texels = encode(format, np.random.default_rng(0).random((512, 512, 4)))
    return draw_screen(
        device, Taps, image=device.texture(texels, format), scale=device.uniform(Scale(factor=2.0))
    )


def draw_city(device: Device, pixels: int) -> Work:
    width = round((pixels * 16 / 9) ** 0.5)
    scene = load_scene("city:blocks=16")
    passes = BackendPasses(
        device, scene, parse_camera_path("ground", scene).camera(900), (width, width * 9 // 16)
    )
    return passes.work("lit")


def draw_city_depth(device: Device, split_material_texel: int) -> Work:
    """Draw the depth of the city: one draw for each object, or one draw of a mesh that holds them all."""
    scene = load_scene("city")
    passes = BackendPasses(device, scene, parse_camera_path("sky", scene).camera(900), SIZE)
    resources = passes.resources
    arrays = resources.scene_arrays(passes.view.buffer)
    bindings = {"view": arrays.view, "objects": arrays.objects, "object_positions": arrays.object_positions}
    if split_material_texel:
        program, parts = device.program(DepthShader), []
        for draw in resources.draws:
            part = resources.mesh.view(
                int(draw["first"]),
                int(draw["count"]),
                base_vertex=int(draw["base_vertex"]),
                base_instance=int(draw["base_instance"]),
            )
            parts.append(part)
    else:
        program = device.program(DepthOnly)
        parts = [merge_city(device, passes)]
        bindings = {}

    def work(_: int) -> None:
        with device.render_pass(depth=passes.targets.depth, clear_depth=0.0):
            for part in parts:
                device.draw(program, part, **bindings)
        device.finish()

    return work


def merge_city(device: Device, passes: BackendPasses) -> Mesh:
    """Create one mesh of all objects, with positions in clip space."""
    scene, camera = passes.resources.scene, passes.camera
    matrix = np.asarray(camera.relative_view_projection).T
    positions, placed, indices, base = scene.meshes.vertices["position"], [], [], 0
    for mesh, node in zip(scene.objects.mesh, scene.objects.node, strict=True):
        part = scene.meshes.ranges[mesh]
        first = int(part["first_index"])
        rows = scene.meshes.indices[first : first + int(part["index_count"])].astype(int) + int(
            part["base_vertex"]
        )
        low, high = int(rows.min()), int(rows.max()) + 1
        world = scene.nodes.world[node]
        relative = positions[low:high] @ world[:3, :3].T + (world[:3, 3] - camera.position)
        placed.append(np.c_[relative, np.ones(high - low)] @ matrix)
        indices.append(rows - low + base)
        base += high - low
    corners = np.concatenate(placed).astype(np.float32)
    return device.mesh({"position": corners}, np.concatenate(indices).astype(np.uint32))


SERIES: dict[str, tuple[Callable[[Device, int], Work], list[int]]] = {
    "triangles": (draw_grid, [2 ** (2 * k + 1) for k in range(5, 11)]),
    "pixels": (draw_city, [14_400 * 4**k for k in range(5)]),
    "lights": (draw_lights, [1, 4, 16, 32, 64, 128, 256]),
    "draws": (draw_city_depth, [0, 1]),
    "taps": (partial(draw_taps, Format.RGBA8), [4]),
    "taps_srgb": (partial(draw_taps, Format.RGBA8_SRGB), [4]),
    "taps_half": (partial(draw_taps, Format.RGBA16F), [4]),
    "taps_float": (partial(draw_taps, Format.RGBA32F), [4]),
}


def measure_series(name: str, rounds: int) -> Iterator[Record]:
    """Yield the time of each size of a series on both backends."""
    make, sizes = SERIES[name]
    for size in sizes:
        with ExitStack() as opened:
            devices = {backend: opened.enter_context(rhi.create_device(backend)) for backend in BACKENDS}
            subjects = [Subject({}, make(device, size), device=device) for device in devices.values()]
            gl, cl = compare(subjects, COLUMNS, show_progress(range(rounds), name), warm_ups=2)
        yield {
            "series": name,
            "n": size,
            "gl": gl["ms"],
            "cl": cl["ms"],
            "ratio": cl["ratio"],
            "kernels": cl["kernels"],
        }


def fit_slope(rows: Sequence[Record], backend: str) -> float:
    """Return the exponent by which times grow, of the upper half of the sizes."""
    upper = rows[len(rows) // 2 - 1 :]
    n, times = (np.log([row[key] for row in upper]) for key in ("n", backend))
    return round(float(np.polyfit(n, times, 1)[0]), 2)


def measure(arguments: argparse.Namespace) -> Iterator[Record]:
    """Yield the times of all series, and then the slopes of those that grow."""
    slopes: list[Record] = []
    for name in arguments.only:
        rows = list(measure_series(name, arguments.rounds))
        yield from rows
        if len(rows) > 2:
            slopes.append({"slopes of": name, **{backend: fit_slope(rows, backend) for backend in BACKENDS}})
    yield from slopes


def plot(figure: Any, rows: Sequence[Record]) -> None:
    """Draw the times of the series that grow, with their slopes."""
    slopes = {row["slopes of"]: row for row in rows if "slopes of" in row}
    for axes, (name, slope) in zip(
        figure.subplots(1, len(slopes), squeeze=False)[0], slopes.items(), strict=True
    ):
        mine = [row for row in rows if row.get("series") == name]
        for backend in BACKENDS:
            times = [row[backend] for row in mine]
            axes.loglog([row["n"] for row in mine], times, "o-", label=f"{backend}: n^{slope[backend]:.2f}")
        axes.set(xlabel=name, ylabel="milliseconds")
        axes.grid(alpha=0.3)
        axes.legend()


OPTIONS: Final = (
    options.rounds("rounds for each size", 9),
    options.names("--only", SERIES, "is not a series", list(SERIES), "all", "series to measure: "),
    options.chart(),
)


if __name__ == "__main__":
    run_benchmark(__doc__, OPTIONS, measure, plot)
