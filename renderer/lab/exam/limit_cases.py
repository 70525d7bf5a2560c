"""Long times and large numbers: 10⁸ s, a million objects, 100,000 frames, images of 16,384 pixels and of
one."""

from __future__ import annotations

import gc
import sys
from fractions import Fraction
from math import factorial
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from renderer.content import load_scene
from renderer.content.shapes import box
from renderer.lab.exam.case import CaseResult, Measures, largest_error
from renderer.lab.exam.far_position_cases import make_pillars
from renderer.lab.exam.scenes import UnculledFrames, along, make_city
from renderer.renderer import Renderer
from renderer.scene import Camera, Perspective, SceneBuilder, Stepwise, scaling, translation
from renderer.scene.arrays import Indices
from renderer.scene.cloth import ClothSimulation, Fabric, Gust, Wind, make_cloth_grid
from renderer.shadows.maps import FarDepth
from renderer.techniques import TECHNIQUES
from renderer.visibility import list_algorithms, select_visible
from rhi import CullMode, Device, Format, create_device
from rhi.math import multiply
from rhi.shading import fragment_coordinate, vec4

_LATE_SECONDS: Final = 1e8
_MANY_FRAMES: Final = 100_000
_INTERVALS: Final = (60, 90, 240, 1000)  # steps per second


class StepCounter:
    """A simulation that only counts its steps."""

    catch_up = Stepwise(1)

    def __init__(self, interval: float) -> None:
        self.interval = interval

    def step(self, members: Indices, numbers: Indices) -> None:
        """Do nothing."""


def measure_simulation_steps(_: Device) -> CaseResult:
    """Count the frames with a wrong step: frame f of a clock of n steps a second is at f / n, rounded to a
    double."""
    late, floats = {f"{rate} steps a second": 0 for rate in _INTERVALS}, 0
    for rate in _INTERVALS:
        for begin in (0, rate * 1_000_000, rate * int(_LATE_SECONDS)):
            for frame in range(begin, begin + 2000):
                clock = StepCounter(1.0 / rate)
                for seconds in (frame / rate, frame * clock.interval):
                    late[f"{rate} steps a second"] += int(clock.catch_up.target(clock, seconds) != frame)
                floats += int(int(np.float32(frame / rate) * np.float32(rate)) != frame)
    holds = {"in float32 most frames would show another step": floats > 10_000}
    return CaseResult(sum(late.values()), late, holds)


def measure_animation_phase(_: Device) -> CaseResult:
    """Pose the flags of a hall after 10⁸ s, and compare them with the phase reduced in fractions before it is
    rounded."""
    scene = load_scene("hall:columns=6,flags=4,fountains=0")
    motion: Any = scene.simulated[0].simulation
    members = np.arange(len(scene.simulated[0]))
    numbers: dict[str, object] = {}
    error = worst = 0.0
    turn = Fraction(314159265358979323846264338327950288419716939937510, 10**50) * 2
    swing = np.zeros(len(members))
    for quarter in np.linspace(0.0, 2.0 * np.pi / 2.4, 64):  # the amplitude of each part
        motion.set_time(members, float(quarter))
        swing = np.maximum(swing, np.abs(motion.angle))
    for seconds in (_LATE_SECONDS, _LATE_SECONDS + 0.25, 7.7e7 + 1.0 / 60.0):
        motion.set_time(members, seconds)
        angle = motion.angle.copy()
        exact = float((Fraction(2.4) * Fraction(seconds)) % turn)
        motion.set_time(members, exact / 2.4)
        off = float((np.abs(angle - motion.angle) / swing).max())
        single = float(np.float32(2.4) * np.float32(seconds))
        worst = largest_error(worst, abs(float(np.sin(single)) - float(np.sin(exact))))
        numbers[f"after {seconds:,.2f} s"] = off
        error = largest_error(error, off)
    holds = {"in float32 the phase is lost": worst > 0.1}
    return CaseResult(error, numbers, holds)


class PixelCoordinates(FarDepth):
    """Writes the coordinate of each pixel's centre."""

    def fragment(self) -> vec4:
        return vec4(fragment_coordinate().xy, 0.0, 1.0)


def measure_wide_images(device: Device) -> CaseResult:
    """Draw images of the device's greatest width, up to 16,384 pixels: the coordinates of all pixels, and a
    city with and without culling."""
    width = min(16_384, device.capabilities.max_texture_size)
    wrong: dict[str, int] = {}
    for size in ((width, 2), (2, width)):
        target, triangle = device.texture(size, Format.RGBA32F), device.mesh(3)
        with device.render_pass(target), device.states(CullMode.NONE):
            device.draw(device.program(PixelCoordinates), triangle)
        pixels: NDArray[Any] = target.read()
        x, y = np.meshgrid(np.arange(size[0]) + 0.5, np.arange(size[1]) + 0.5)
        wrong[f"{size[0]} × {size[1]}: places"] = int((pixels[..., :2] != np.stack([x, y], 2)).any(2).sum())
        target.destroy()
        triangle.destroy()
    city = make_city()
    with UnculledFrames(device, city, along("ground", 600)(city), (width, 2)) as uncut:
        for name in ("frustum", "two_pass"):
            if name in list_algorithms(device):
                wrong[f"{width} × 2, {name}"] = sum(uncut.try_algorithm(name))
        colors = len(np.unique(uncut.frames[0].reshape(-1, 4), axis=0))
    return CaseResult(sum(wrong.values()), wrong, {"there is something to see": colors > 50})


def measure_tiny_images(device: Device) -> CaseResult:
    """Draw images of one pixel, and of 3 by 1, with techniques that light surfaces while they are drawn and
    afterwards, and compare them with forward shading."""
    total, numbers = 0.0, dict[str, object]()
    scene, lit = make_pillars(0.0), 0
    for size in ((1, 1), (3, 1)):
        camera = Camera.look_at((0.5, 1.5, -4.0), (0.5, 0.6, -6.5), projection=Perspective(fov=1.2))
        images = {}
        for name in ("forward", "deferred"):
            with Renderer(
                device, scene, technique=TECHNIQUES[name](), size=size, visibility="frustum"
            ) as renderer:
                images[name] = renderer.render(camera).image.read().astype(int)
        off = float(np.abs(images["forward"] - images["deferred"])[..., :3].max())
        lit += int(images["forward"][..., :3].max() > 100)
        numbers[f"{size[0]} × {size[1]}"] = images["forward"].reshape(-1, 4)[0].tolist()
        total = largest_error(total, off)
    return CaseResult(total, numbers, {"there is something to see": lit == 2})


_STORM: Final = Wind(
    (60.0, -20.0, 5.0),
    (Gust((0.0, 40.0, 900.0), (0.3, 0.4, 0.0), 0.7), Gust((90.0, 0.0, 80.0), (1.1, 0.3, 0.0), 0.4)),
)
_CHAIN_ROOT: Final = 1.2024128  # half of the first root of the Bessel function of order 0
_REPEAT: Final = 168  # steps after which both gusts repeat


def measure_cloth_after_years(device: Device) -> CaseResult:
    """Step cloths in a storm on a device after 10⁸ s, and compare their points with NumPy's at the beginning,
    when the wind was the same; and with the box that they must not leave."""
    x, y = np.meshgrid(np.linspace(-0.5, 0.5, 5), np.linspace(0.0, -1.0, 6))
    pinned = np.zeros(x.shape, bool)
    pinned[0] = True
    cloth_grid = make_cloth_grid(
        np.stack([x, y, 0.0 * x], 2), pinned, bounds=((-0.7, -1.1, -0.2), (0.7, 0.3, 0.9))
    )
    members = np.arange(2)
    (low, high), calm = cloth_grid.bounds, Wind((0.0, 0.0, 2.0), _STORM.gusts[:1])
    numbers: dict[str, object] = {}
    error, outside, moved = 0.0, 0, 0.0
    for name, wind, steps in (("a breeze", calm, 4), ("a storm", _STORM, 3)):
        here, there = ClothSimulation(2, cloth_grid, wind), ClothSimulation(2, cloth_grid, wind)
        later = _REPEAT * (int(_LATE_SECONDS / ClothSimulation.interval) // _REPEAT)
        for number in range(1, steps + 1):
            here.step(members, np.full(2, number))
            there.step(members, np.full(2, later + number))
        expected = here.vertices(members)["position"].astype(np.float64)
        with device.storage(float, 6 * len(expected)) as vertices:
            there.deform(device, members, vertices, members * len(cloth_grid.points), 6)
            positions = vertices.read().reshape(-1, 6)[:, :3].astype(np.float64)
        there.release(device)
        numbers[f"metres off in {name}, after {steps} steps"] = off = float(
            np.abs(positions - expected).max()
        )
        outside += int(((positions < low) | (positions > high)).any(1).sum())
        moved = max(moved, float(np.abs(positions - np.tile(cloth_grid.points, (2, 1))).max()))
        error = largest_error(error, off)
    holds = {"cloths have moved": moved > 0.1, "no point is outside of its bounds": outside == 0}
    return CaseResult(error, {**numbers, "points outside": outside}, holds)


def measure_cloth_period(device: Device) -> CaseResult:
    """Measure strips of cloth that hang and swing without wind, drag and damping, as a hanging chain does at its
    slowest: ω = 1.2024 √(g / L), in the shape of a Bessel function (Bernoulli 1732). Steps of first order
    leave 92 %."""
    rows, down = 17, np.linspace(0.0, 1.0, 17)
    flat = np.stack(
        [np.tile([-0.05, 0.05], (rows, 1)), np.tile(-down[:, None], (1, 2)), np.zeros((rows, 2))], 2
    )
    powers = [
        (-1) ** k * (_CHAIN_ROOT * np.sqrt(1.0 - down)) ** (2 * k) / factorial(k) ** 2 for k in range(18)
    ]
    start = flat + 0.02 * np.sum(powers, 0)[:, None, None] * (0.0, 0.0, 1.0)
    start[0, :, 2] = 0.0
    pinned, fabric = start[..., 1] == 0.0, Fabric(stretch=0.0, shear=0.0, bend=1e6, drag=0.0, damping=0.0)
    periods, begins, swing_left, member = [], [], 0.0, np.zeros(1, np.int64)
    for sub_steps in (2, 8):
        cloths, ends = (
            ClothSimulation(1, make_cloth_grid(start, pinned, flat=flat, fabric=fabric, sub_steps=sub_steps)),
            [],
        )
        with device.storage(float, 12 * rows) as vertices:
            for number in range(1, 421):
                cloths.step(member, np.full(1, number))
                cloths.deform(device, member, vertices, member, 6)
                ends.append(float(vertices.read(6 * 2 * (rows - 1) + 2, 1)[0]))
        cloths.release(device)
        begins.append(ends[0])
        positions = np.array(ends)
        up = np.flatnonzero((positions[:-1] < 0.0) & (positions[1:] >= 0.0))
        crossings = (up + positions[up] / (positions[up] - positions[up + 1])) * ClothSimulation.interval
        periods.append(float(np.diff(crossings).mean()) * _CHAIN_ROOT * 9.81**0.5 / (2.0 * np.pi) - 1.0)
        swing_left = float(np.abs(positions[-100:]).max() / np.abs(positions[:100]).max())
    swings = min(begins) > 0.019 and abs(swing_left - 1.0) < 0.05
    holds = {"it keeps its swing": swings, "with fewer sub-steps it is late": 0.04 < periods[0] < 0.08}
    return CaseResult(
        abs(periods[1]), {"periods of 2 and 8 sub-steps, off by": periods, "swing left": swing_left}, holds
    )


def measure_million_objects(device: Device) -> CaseResult:
    """Cull a million boxes, and compare with all six planes of each; on devices that draw, also with
    pixels."""
    count = 1_000_000
    rng = np.random.default_rng(61)
    object_positions = rng.uniform(-2000.0, 2000.0, (count, 3)) * (1.0, 0.05, 1.0)
    builder = SceneBuilder("a million boxes")
    mesh, material = builder.add_mesh(box()), builder.add_material()
    nodes = builder.add_nodes(
        multiply(translation(object_positions), scaling(rng.uniform(0.2, 2.0, (count, 3))))
    )
    builder.add_objects(nodes, mesh, material)
    builder.lights.add_directional((-0.4, -1.0, -0.3))
    scene = builder.build()
    camera = Camera.look_at((0, 20, 0), (10, 15, -30), projection=Perspective(fov=0.6, far=900.0))
    with (
        create_device("null") as null,
        Renderer(null, scene, size=(64, 36), visibility="frustum") as renderer,
    ):
        drawn = renderer.render(camera).visible
    planes = camera.with_aspect(64 / 36).frustum.planes
    expected = np.flatnonzero(select_visible(planes, scene.objects.lower, scene.objects.upper))
    numbers: dict[str, object] = {"drawn": len(drawn)}
    total = len(np.setxor1d(drawn, expected))
    if device.capabilities.renders:
        images = []
        for algorithm in ("none", "frustum"):
            with Renderer(device, scene, size=(64, 36), visibility=algorithm) as renderer:
                images.append(renderer.render(camera).image.read())
        numbers["wrong pixels"] = wrong = int((images[0] != images[1]).any(2).sum())
        total += wrong
    return CaseResult(total, numbers, {"some are drawn, most aren't": 100 < len(drawn) < count // 10})


def measure_many_frames(_: Device) -> CaseResult:
    """Draw many frames of a hall on a null device along its path, and check that after the first lap nothing
    is created or retained, and that a frame of the same time and position repeats the first lap's, command by
    command."""
    scene = load_scene("hall:columns=4,flags=2,fountains=0")
    path = scene.paths["ground"]
    with (
        create_device("null") as null,
        Renderer(null, scene, size=(32, 18), visibility="frustum") as renderer,
    ):

        def draw_lap() -> None:
            for frame in range(len(path)):
                renderer.render(path.camera(frame), frame / 60)
            null.stream.clear()

        def describe() -> list[str]:
            renderer.render(path.camera(0), 0.0)
            names = [command.op.name for command in null.stream]
            null.stream.clear()
            return names

        draw_lap()
        first = describe()
        creations = null.statistics.creations
        blocks = _count_memory_blocks()
        laps = -(-_MANY_FRAMES // len(path))
        for lap in range(laps):
            draw_lap()
            if null.statistics.creations > creations or _count_memory_blocks() - blocks > (lap + 1) * len(
                path
            ):
                laps = lap + 1
                break  # it goes on like this
        last = describe()
        created, leaked_blocks = null.statistics.creations - creations, _count_memory_blocks() - blocks
    numbers = {
        "frames": laps * len(path),
        "commands of a frame": len(first),
        "blocks of memory kept": leaked_blocks,
    }
    holds = {
        "Python's memory grows by less than a block in ten frames": leaked_blocks < laps * len(path) // 10
    }
    return CaseResult(created + (first != last), {**numbers, "resources created": created}, holds)


def _count_memory_blocks() -> int:
    gc.collect()
    return sys.getallocatedblocks()


MEASURES: Final[Measures] = {
    60: measure_simulation_steps,
    61: measure_million_objects,
    62: measure_many_frames,
    63: measure_wide_images,
    64: measure_tiny_images,
    65: measure_animation_phase,
    67: measure_cloth_after_years,
    76: measure_cloth_period,
}
