"""Random programs of work for devices on several threads, and their results as bytes.

The threads of a trial share nothing but shader classes that nothing has compiled before. Each has a device of
its own. `compare_with_serial` does the same work one after another, with classes of their own from the same
text. Threads change at random lines, which shows races that Python's own switches meet once in years.
"""

from __future__ import annotations

import sys
import threading
import time
import weakref
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial
from pathlib import Path
from random import Random
from types import FrameType, SimpleNamespace
from typing import Any, Final

import numpy as np

import rhi
import rhi.shading as sl
from renderer.content import load_scene
from renderer.renderer import Renderer
from renderer.techniques.table import TECHNIQUES
from rhi import Format
from rhi.math import Camera, Perspective

TraceFunction = Callable[[FrameType, str, object], Any]

_ROOT: Final = Path(rhi.__file__).parent.parent
_TRACED: Final = (*tuple(f"{_ROOT / name}/" for name in ("rhi", "renderer")), weakref.__file__)

_TEXT: Final = """
from rhi import Format
from rhi.shading import *


class Corner(Struct):
    position: vec2
    weight: float


class Settings(Struct):
    tint: vec4
    shift: vec2
    count: uint


class Row(Struct):
    place: vec2
    size: float
    color: vec4


class Surface(Struct):
    clip: vec4
    color: vec4
    uv: vec2


@function
def mix_thrice(a: vec4, b: vec4, t: float) -> vec4:
    for i in range(3):
        a = mix(a, b, t / (float(i) + 1.0))
    return a


class Drawn(Shader):
    settings: Uniform[Settings]
    rows: Storage[Row]
    colors: Texture2D

    def vertex(self, v: Corner) -> Surface:
        row = self.rows[instance_index()]
        at = v.position * row.size + row.place + self.settings.shift
        return Surface(clip=vec4(at, 0.25 + 0.5 * v.weight, 1.0), color=row.color, uv=v.position * 0.5 + 0.5)

    def fragment(self, s: Surface) -> vec4:
        texel = self.colors.sample(s.uv)
        if texel.x > 0.95:
            discard()
        return mix_thrice(texel, s.color, 0.5) * self.settings.tint


class Counted(Shader):
    settings: Uniform[Settings]
    values: StorageRW[uint]
    sums: StorageRW[uint]
    partial = shared(uint, 16)

    work_group = (16, 1, 1)

    def compute(self) -> None:
        own = uint(global_id().x)
        place = local_index()
        mixed = (self.values[own] ^ (own * 2654435761)) >> 3
        self.partial[place] = mixed % 97
        barrier()
        total = uint(0)
        for i in range(16):
            total += self.partial[i]
        self.values[own] = total + self.settings.count
        atomic_add(self.sums[0], mixed % 7)


class Edited(FullScreen):
    def fragment(self) -> vec4:
        return vec4(FRACTION, fragment_coordinate().x / 32.0, 0.5, 1.0)
"""

_NAMES: Final = ("Corner", "Settings", "Row", "mix_thrice", "Drawn", "Counted", "Edited")


class Shaders(SimpleNamespace):
    """The classes of a trial."""


def make_shaders() -> Shaders:
    """Return new classes from the same text."""
    parts = sl.from_source(_TEXT, *_NAMES, scope={"FRACTION": 0.25})
    return Shaders(**dict(zip(_NAMES, parts, strict=True)))


Work = Callable[[rhi.Device, Shaders, np.random.Generator], Iterator[Any]]


def _settings(shaders: Shaders, random: np.random.Generator) -> Any:
    tint, shift = random.random(4), random.random(2) * 0.5
    return shaders.Settings(tint=tint, shift=shift, count=int(random.integers(99)))


def _states(random: np.random.Generator) -> tuple[rhi.State, ...]:
    """Return random states, with numbers that other threads use as well and some that they don't."""
    number = int(random.integers(4))
    choices: list[rhi.State] = [
        rhi.Scissor(number, 1, 20, 20),
        rhi.Viewport(0, number, 32, 32),
        rhi.BlendFunction(rhi.BlendFactor.ONE, rhi.BlendFactor.ONE_MINUS_SOURCE_ALPHA),
        rhi.ColorWrite(True, number > 1, True, True),
        rhi.DepthWrite.OFF,
        rhi.DepthFunction.ALWAYS,
        rhi.CullMode.NONE,
    ]
    picked = random.choice(len(choices), 3, replace=False)
    return tuple(choices[i] for i in picked if not isinstance(choices[i], rhi.CullMode))


def draw(device: rhi.Device, shaders: Shaders, random: np.random.Generator) -> Iterator[Any]:
    """Draw instances with a mipmapped texture, states and a query, directly and by a command buffer."""
    texels = random.integers(0, 256, (16, 16, 4), np.uint8)
    rows = np.zeros(5, shaders.Row.dtype)
    rows["place"], rows["size"] = random.random((5, 2)) - 0.5, random.random(5)
    rows["color"] = random.random((5, 4))
    corners = np.array([[-1, -1], [1, -1], [0, 1]], np.float32)
    mesh = device.mesh({"position": corners, "weight": random.random(3).astype(np.float32)})
    colors = device.texture(texels, Format.RGBA8, levels=None)
    storage, settings = device.storage(shaders.Row, rows), _settings(shaders, random)
    color, depth = device.texture((32, 32), Format.RGBA8), device.texture((32, 32), Format.D32F)
    program, query = device.program(shaders.Drawn), device.occlusion_query()
    states = _states(random)
    bindings: dict[str, Any] = {"settings": settings, "rows": storage, "colors": colors}
    with device.render_pass(color, depth, clear=(0.5, 0, 0, 1), clear_depth=0.0):
        with device.states(rhi.CullMode.NONE, *states), query:
            device.draw(program, mesh, 5, **bindings)
    yield color.read()
    if device.capabilities.renders:
        yield query.wait()
    with device.record() as commands:
        with commands.render_pass(color, depth, clear=(0, 0, 1, 1), clear_depth=0.0):
            with commands.states(rhi.CullMode.NONE, *reversed(states)):
                commands.draw(program, mesh, 5, **bindings)
    device.submit(commands, commands)
    yield color.read()
    yield depth.read()


def count(device: rhi.Device, shaders: Shaders, random: np.random.Generator) -> Iterator[Any]:
    """Dispatch work-groups that share memory."""
    values, sums = random.integers(0, 1 << 31, 256).astype(np.uint32), np.zeros(1, np.uint32)
    settings = _settings(shaders, random)
    stored, total = device.storage(sl.uint, values), device.storage(sl.uint, sums)
    for _ in range(2):
        device.dispatch(device.program(shaders.Counted), 16, settings=settings, values=stored, sums=total)
    yield stored.read()
    yield total.read()


def filter_textures(device: rhi.Device, shaders: Shaders, random: np.random.Generator) -> Iterator[Any]:
    """Make mipmaps of odd sizes in several formats, and clear, copy and write."""
    for format in (Format.RGBA8, Format.RGBA8_SRGB, Format.R16F, Format.RGBA32F):
        height, width = map(int, random.integers(3, 20, 2))
        texels = (random.random((height, width, format.channels)) * 200).astype(format.dtype)
        texture = device.texture(texels, format, levels=None)
        for level in range(texture.levels):
            yield texture.read(level)


def evaluate_on_numpy(device: rhi.Device, shaders: Shaders, random: np.random.Generator) -> Iterator[Any]:
    """Run stages and functions with NumPy."""
    values, sums = random.integers(0, 1 << 31, 64).astype(np.uint32), np.zeros(1, np.uint32)
    settings = _settings(shaders, random)
    results = sl.run_compute(shaders.Counted, 4, settings=settings, values=values, sums=sums)
    yield from results.values()
    a, b, t = random.random((7, 4)), random.random((7, 4)), random.random(7)
    yield sl.evaluate(shaders.mix_thrice, a, b, t, dtype=np.float64)
    rows = np.zeros(2, shaders.Row.dtype)
    rows["size"] = random.random(2)
    colors = sl.HostTexture([random.integers(0, 256, (4, 4, 4), np.uint8)], Format.RGBA8)
    vertex = sl.run_vertex(
        shaders.Drawn,
        {"position": random.random((3, 2)), "weight": random.random(3)},
        settings=settings,
        rows=rows,
        colors=colors,
    )
    yield from vertex.varyings.values()


def write_structs(device: rhi.Device, shaders: Shaders, random: np.random.Generator) -> Iterator[Any]:
    """Pack structs, and send them through buffers."""
    for _ in range(20):
        settings = _settings(shaders, random)
        yield settings.to_bytes()
        row = np.zeros(1, shaders.Row.dtype)
        row["color"] = random.random(4)
        with device.storage(shaders.Row, row) as storage:
            yield storage.read()


def write_texts(device: rhi.Device, shaders: Shaders, random: np.random.Generator) -> Iterator[Any]:
    """Write shaders in all languages that need no other program."""
    for shader in (shaders.Drawn, shaders.Counted, shaders.Edited):
        descriptor = sl.compile_shader(shader)
        for stage in sorted(descriptor.stages, key=str):
            for language in ("glsl", "wgsl", "vulkan", "opencl16"):
                yield descriptor.emit(language, stage).text.encode()


def render(device: rhi.Device, shaders: Shaders, random: np.random.Generator) -> Iterator[Any]:
    """Render frames of a scene of this thread alone."""
    if not device.capabilities.renders:
        return
    name = str(random.choice(["hall:columns=3,rows=2,lights=9,shadows=1", "grid:count=9,lights=4"]))
    scene = load_scene(name)
    technique = TECHNIQUES[str(random.choice(["forward", "deferred", "forward_plus"]))]()
    eye, target = (6.0, 5.0, 9.0), (0.0, 1.0, 0.0)
    camera = Camera.look_at(eye, target, projection=Perspective(1.0, 1.5))
    with Renderer(device, scene, size=(48, 32), technique=technique, visibility="frustum") as renderer:
        for seconds in (0.0, 0.5):
            yield renderer.render(camera, seconds).image.read()


WORKS: Final[Mapping[str, Work]] = {
    "draw": draw,
    "count": count,
    "textures": filter_textures,
    "numpy": evaluate_on_numpy,
    "structs": write_structs,
    "texts": write_texts,
    "render": render,
}


def work_on(backend: str, names: Sequence[str], shaders: Shaders, seed: int) -> list[tuple[str, bytes]]:
    """Create a device, do the works in order, and return the bytes of all results by their names."""
    results: list[tuple[str, bytes]] = []
    with rhi.create_device(backend) as device:
        for number, name in enumerate(names):
            random = np.random.default_rng([seed, number])
            results += [(name, np.asarray(each).tobytes()) for each in WORKS[name](device, shaders, random)]
        if backend == "null":
            results.append(("stream", "\n".join(str(c).partition(" (")[0] for c in device.stream).encode()))
    return results


def on_threads(works: Sequence[Callable[[], Any]], seed: int = 0, share: float = 0.02) -> list[Any]:
    """Call functions on threads that begin together, and change threads at random lines of the library.

    Return their results, or what they raised. `share` of the lines let another thread run.
    """
    random = Random(seed)
    start = threading.Barrier(len(works))
    results: list[Any] = [None] * len(works)

    def trace_line(frame: FrameType, event: str, argument: object) -> TraceFunction:
        if random.random() < share:
            time.sleep(1e-6)
        return trace_line

    def trace_call(frame: FrameType, event: str, argument: object) -> TraceFunction | None:
        return trace_line if frame.f_code.co_filename.startswith(_TRACED) else None

    def begin(number: int) -> None:
        start.wait()
        try:
            results[number] = works[number]()
        except BaseException as error:
            results[number] = error

    threads = [threading.Thread(target=begin, args=(number,)) for number in range(len(works))]
    before, interval = threading.gettrace(), sys.getswitchinterval()
    sys.setswitchinterval(1e-5)
    threading.settrace(trace_call)
    try:
        for thread in threads:
            thread.start()
    finally:
        threading.settrace(before)  # type: ignore[arg-type]
    for thread in threads:
        thread.join()
    sys.setswitchinterval(interval)
    return results


def compare_with_serial(backends: Sequence[str], names: Sequence[str], trials: int, seed: int) -> None:
    """Do random works on threads with a device each, then one after another, and compare all bytes.

    Every second trial gives all threads the same works, so that they compile the same shaders at once."""
    for trial in range(trials):
        random = Random(seed * 1000 + trial)
        plans = [random.choices(names, k=3) for _ in backends]
        if trial % 2 == 0:
            plans = plans[:1] * len(backends)
        fresh, alone = make_shaders(), make_shaders()
        works = [
            partial(work_on, backend, plan, fresh, seed + 10 * trial + number)
            for number, (backend, plan) in enumerate(zip(backends, plans, strict=True))
        ]
        for number, result in enumerate(on_threads(works, seed + trial)):
            if isinstance(result, BaseException):
                raise result
            backend, plan = backends[number], plans[number]
            serial = work_on(backend, plan, alone, seed + 10 * trial + number)
            differing = [a[0] for a, b in zip(result, serial, strict=True) if a != b]
            assert not differing, f"trial {trial}, thread {number} on {backend}: {differing} of {plan}"
