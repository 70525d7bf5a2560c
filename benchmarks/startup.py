"""The time that `import rhi` takes in a new process, and that a program takes to its first images.

Each run is a new interpreter, and the interpreter's own start isn't counted. Modules are loaded from cached
bytecode, as those of an installed package are: a first run writes it and isn't counted.

- import: `import numpy` is timed for comparison, because `import rhi` includes it.
- triangle: from `import rhi` until the pixels of a lit and textured triangle are read.
- sines: a triangle whose fragment stage computes five `sin` of a vec3.
- lit: 30 shaders with different lights, one triangle each, into one image.
- prepared: the same 30, after `device.prepare` has finished for all of them.
- engine: the example `mini_engine.py`, whose scene has shadows with nine taps, an image of entities' numbers, bloom
  and tone mapping.
- city: the renderer's generated city, with what it draws with by default; loading is included.
- states: in a process that has drawn with a program before, the longest and the median time of a draw and its
  end with each of 20 new combinations of blending, depth test and formats.

"cold" begins with an empty cache of compiled kernels (`RHI_CACHE`), "warm" with what a first run left. gl has
no such cache in this comparison: Mesa's is switched off for "cold". "processor" is the time of all threads,
but not that of other processes that compile in the background.

    python benchmarks/startup.py [--json] [--runs 15] [--only import,triangle,…] [--backends gl,wgpu]
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any, Final

from renderer.cli import options
from renderer.cli.comparison import run_benchmark
from renderer.lab.comparison import Record, Subject, compare, median_of

ROOT: Final = Path(__file__).parents[1]
IMPORTS: Final = {
    "numpy": "import numpy",
    "rhi": "import rhi",
    "rhi.shading": "from rhi.shading import Shader, vec4",
}
SHADER_COUNT: Final = 30
HEAD: Final = """
import json, sys, time
began, spent = time.perf_counter(), time.process_time()
import numpy as np
import rhi
from rhi.shading import Shader, Struct, Texture2D, Uniform, dot, max, normalize, pow, sin, vec2, vec3, vec4

class Corner(Struct):
    position: vec2
    normal: vec3
    uv: vec2

class Surface(Struct):
    clip: vec4
    normal: vec3
    uv: vec2

class Sun(Struct):
    direction: vec3

class Drawn(Shader):
    sun: Uniform[Sun]
    albedo: Texture2D

    def vertex(self, v: Corner) -> Surface:
        return Surface(clip=vec4(v.position, 0.5, 1.0), normal=v.normal, uv=v.uv)
"""
LIT_IMAGE: Final = """
class Lit{number}(Drawn):
    def fragment(self, s: Surface) -> vec4:
        normal = normalize(s.normal)
        light = max(dot(normal, self.sun.direction), 0.0) * {number}.5
        half_vector = normalize(self.sun.direction + vec3(0.0, {number}.0, 1.0))
        shine = pow(max(dot(normal, half_vector), 0.0), {number}.25)
        return vec4(self.albedo.sample(s.uv).rgb * light + vec3(shine, shine, shine), 1.0)
"""
SINES: Final = """
class Lit1(Drawn):
    def fragment(self, s: Surface) -> vec4:
        a = sin(s.normal * 1.5)
        b = sin(a * 2.0 + s.normal)
        c = sin(b * 3.0 + a)
        d = sin(c * 5.0 + b)
        return vec4(sin(d * 7.0 + c) * self.albedo.sample(s.uv).rgb * self.sun.direction.z, 1.0)
"""
TAIL: Final = """
shaders = [each for name, each in list(globals().items()) if name.startswith("Lit")]
corners = [
    ((-0.8, -0.8), (-1, 0, 1), (0, 4)),
    ((0.8, -0.8), (1, 0, 1), (4, 4)),
    ((0, 0.8), (0, 1, 1), (2, 0)),
]
orange, grey = (255, 160, 40, 255), (60, 60, 60, 255)
checker = np.array([[orange, grey], [grey, orange]], np.uint8)
with rhi.create_device(sys.argv[1]) as device:
    image = device.texture((640, 480), rhi.Format.RGBA8_SRGB)
    albedo = device.texture(checker, rhi.Format.RGBA8_SRGB)
    bound = dict(sun=device.uniform(Sun(direction=(0, 0, 1))), albedo=albedo)
    mesh = device.mesh(np.array(corners, Corner.dtype))
    programs = [device.program(shader) for shader in shaders]
    if "prepare" in sys.argv:
        device.prepare([rhi.DrawPlan(program, mesh, (image,)) for program in programs]).result()
    with device.render_pass(image, clear=(0.02, 0.03, 0.05, 1.0)):
        for program in programs:
            device.draw(program, mesh, **bound)
    image.read()
    figures = {"seconds": time.perf_counter() - began, "processor": time.process_time() - spent}
    if "states" in sys.argv:
        depth = device.texture((640, 480), rhi.Format.D32F)
        times = []
        for name in ("RGBA8", "RGBA16F", "R8", "RGBA32F", "RG8"):
            other = device.texture((640, 480), rhi.Format[name])
            for test in (rhi.DepthFunction.LESS, rhi.DepthFunction.GREATER_EQUAL):
                for blend in (rhi.BlendFunction.ALPHA, rhi.BlendFunction.OFF):
                    device.finish()
                    start = time.perf_counter()
                    with device.render_pass(other, depth, clear=(0, 0, 0, 1), clear_depth=0.75):
                        with device.states(test, blend):
                            device.draw(programs[0], mesh, **bound)
                    device.finish()
                    times.append(time.perf_counter() - start)
        figures = {"seconds": sorted(times)[-1], "processor": sorted(times)[len(times) // 2]}
print(json.dumps(figures))
"""
ENGINE: Final = """
import json, sys, time
began, spent = time.perf_counter(), time.process_time()
import rhi
from examples.mini_engine import render
with rhi.create_device(sys.argv[1]) as device:
    render(device, (640, 480)).read()
print(json.dumps({"seconds": time.perf_counter() - began, "processor": time.process_time() - spent}))
"""
CITY: Final = """
import json, sys, time
began, spent = time.perf_counter(), time.process_time()
import rhi
from renderer.content import load_scene
from renderer.renderer import Renderer
scene = load_scene("city")
with rhi.create_device(sys.argv[1]) as device, Renderer(device, scene, size=(640, 480)) as renderer:
    renderer.render(scene.views["street"].with_aspect(4 / 3)).image.read()
print(json.dumps({"seconds": time.perf_counter() - began, "processor": time.process_time() - spent}))
"""
ONE_SHADER: Final = HEAD + LIT_IMAGE.format(number=1) + TAIL
SHADERS: Final = (
    HEAD + "".join(LIT_IMAGE.format(number=number) for number in range(1, SHADER_COUNT + 1)) + TAIL
)
SCENES: Final[dict[str, tuple[str, tuple[str, ...]]]] = {
    "triangle": (ONE_SHADER, ()),
    "sines": (HEAD + SINES + TAIL, ()),
    "lit": (SHADERS, ()),
    "prepared": (SHADERS, ("prepare",)),
    "engine": (ENGINE, ()),
    "city": (CITY, ()),
    "states": (ONE_SHADER, ("states",)),
}
"""The program of each scene, and its arguments."""


def environment() -> dict[str, str]:
    """Return the environment of a run."""
    left_out = ("POCL_CACHE_DIR", "PYTHONDONTWRITEBYTECODE")
    return {name: value for name, value in os.environ.items() if name not in left_out} | {
        "PYTHONPATH": str(ROOT)
    }


def run_alone(*arguments: str, **variables: str) -> Any:
    """Run a program in a new interpreter, and return the JSON that it prints."""
    command = [sys.executable, *arguments]
    done = subprocess.run(
        command, capture_output=True, text=True, check=True, env=environment() | variables, encoding="utf-8"
    )
    return json.loads(done.stdout)


def time_import(name: str) -> dict[str, float]:
    """Return the seconds that an import takes in a new interpreter, without the interpreter's start."""
    code = f"import time; start = time.perf_counter(); {IMPORTS[name]}; print(time.perf_counter() - start)"
    return {"seconds": run_alone("-c", code)}


def time_scene(scene: str, backend: str) -> dict[str, float]:
    """Return the figures of a scene, drawn in new interpreters with empty caches and with what the first one
    left."""
    program, arguments = SCENES[scene]
    figures = {}
    with tempfile.TemporaryDirectory() as folder:
        script = Path(folder) / f"{scene}.py"  # shaders are read from files
        script.write_text(program, encoding="utf-8")
        for state, is_off in (("cold", "true"), ("warm", "false")):
            variables = {"RHI_CACHE": f"{folder}/cache", "MESA_SHADER_CACHE_DISABLE": is_off}
            figures_alone = run_alone(str(script), backend, *arguments, **variables)
            figures |= {f"{name}, {state}": figures_alone[part] for part, name in list_names(scene).items()}
    return figures


def list_names(scene: str) -> dict[str, str]:
    """The two figures of a scene, by the names that its program prints."""
    is_states = scene == "states"
    return {
        "seconds": "longest" if is_states else "seconds",
        "processor": "median" if is_states else "processor",
    }


def make_subject(description: Record, run: Callable[[], dict[str, float]]) -> Subject:
    """Return the subject of what is timed in an interpreter of its own."""
    figures: dict[str, float] = {}
    return Subject(description, lambda _: figures.update(run()), count=lambda: dict(figures))


def measure(arguments: argparse.Namespace) -> Iterator[Record]:
    """Yield the medians of the imports, and of the scenes on each backend."""
    if "import" in arguments.only:
        subjects = [make_subject({"import": name}, partial(time_import, name)) for name in IMPORTS]
        yield from compare(subjects, {"seconds": median_of(digits=4)}, range(arguments.runs))
    scenes = [name for name in SCENES if name in arguments.only]
    for backend in arguments.backends if scenes else ():
        time_scene("triangle", backend)  # writes the bytecode
    for scene in scenes:
        subjects = [
            make_subject({"scene": scene, "backend": backend}, partial(time_scene, scene, backend))
            for backend in arguments.backends
        ]
        names = [f"{name}, {state}" for state in ("cold", "warm") for name in list_names(scene).values()]
        yield from compare(
            subjects, dict.fromkeys(names, median_of()), range(arguments.cold_runs), warm_ups=0
        )


OPTIONS: Final = (
    options.count("--runs", "runs of each import", 15),
    options.count("--cold-runs", "runs of each scene", 3),
    options.names("--backends", ("gl", "cl", "wgpu"), "is not measured", ["gl", "cl"], "gl and cl"),
    options.names("--only", ("import", *SCENES), "is not measured", ["import", *SCENES], "all"),
)


if __name__ == "__main__":
    run_benchmark(__doc__, OPTIONS, measure, kernels="")  # "cold" is what a first run has
