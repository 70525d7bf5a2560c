"""The time that `import rhi` takes in a new process, and that a program takes to its first pictures.

Each run is a new interpreter, and the interpreter's own start isn't counted. Modules are loaded from cached bytecode,
as those of an installed package are: a first run writes it and isn't counted.

- import: `import numpy` is timed for comparison, because `import rhi` includes it.
- triangle: from `import rhi` until the pixels of a lit and textured triangle are read.
- sines: a triangle whose fragment stage computes five `sin` of a vec3.
- lit: 30 shaders with different lights, one triangle each, into one picture.
- prepared: the same 30, after `device.prepare` has finished for all of them.
- states: in a process that has drawn with a program before, the longest and the median time of a draw and its end with
  each of 20 new combinations of blending, depth test and formats.

"cold" begins with an empty cache of compiled kernels (`RHI_CACHE`), "warm" with what a first run left. gl has no such
cache in this comparison: Mesa's is switched off for "cold". "processor" is the time of all threads, but not that of
other processes that compile in the background.

    python benchmarks/startup.py [--json] [--runs 15] [--only import,triangle,…]
"""

from __future__ import annotations

import argparse
import json
import os
import statistics
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any, Final

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
LIT: Final = """
class Lit{number}(Drawn):
    def fragment(self, s: Surface) -> vec4:
        normal = normalize(s.normal)
        light = max(dot(normal, self.sun.direction), 0.0) * {number}.5
        shine = pow(max(dot(normal, normalize(self.sun.direction + vec3(0.0, {number}.0, 1.0))), 0.0), {number}.25)
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
corners = [((-0.8, -0.8), (-1, 0, 1), (0, 4)), ((0.8, -0.8), (1, 0, 1), (4, 4)), ((0, 0.8), (0, 1, 1), (2, 0))]
checker = np.array([[[255, 160, 40, 255], [60, 60, 60, 255]], [[60, 60, 60, 255], [255, 160, 40, 255]]], np.uint8)
with rhi.create_device(sys.argv[1]) as device:
    image = device.texture((640, 480), rhi.Format.RGBA8_SRGB)
    bound = dict(sun=device.uniform(Sun(direction=(0, 0, 1))), albedo=device.texture(checker, rhi.Format.RGBA8_SRGB))
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
        for format in (rhi.Format.RGBA8, rhi.Format.RGBA16F, rhi.Format.R8, rhi.Format.RGBA32F, rhi.Format.RG8):
            other = device.texture((640, 480), format)
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
SCENES: Final[dict[str, tuple[str, tuple[str, ...]]]] = {
    "triangle": (LIT.format(number=1), ()),
    "sines": (SINES, ()),
    "lit": ("".join(LIT.format(number=number) for number in range(1, SHADER_COUNT + 1)), ()),
    "prepared": ("".join(LIT.format(number=number) for number in range(1, SHADER_COUNT + 1)), ("prepare",)),
    "states": (LIT.format(number=1), ("states",)),
}
"""The shaders of each scene, and the arguments of its program."""


def time_import(statement: str) -> float:
    """Return the seconds that a statement takes in a new interpreter, without the interpreter's start."""
    code = f"import time; start = time.perf_counter(); {statement}; print(time.perf_counter() - start)"
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, env=environment())
    return float(run.stdout)


def environment() -> dict[str, str]:
    """Return the environment of a run."""
    left_out = ("POCL_CACHE_DIR", "PYTHONDONTWRITEBYTECODE")
    return {name: value for name, value in os.environ.items() if name not in left_out} | {"PYTHONPATH": str(ROOT)}


def time_scene(name: str, backend: str, folder: Path, cold: bool) -> dict[str, float]:
    """Return the figures of a scene, drawn in a new interpreter with the caches in `folder`."""
    shaders, arguments = SCENES[name]
    script = folder / f"{name}.py"  # shaders are read from files
    script.write_text(HEAD + shaders + TAIL)
    variables = {"RHI_CACHE": str(folder / "cache"), "MESA_SHADER_CACHE_DISABLE": "true" if cold else "false"}
    done = subprocess.run(
        [sys.executable, str(script), backend, *arguments], capture_output=True, text=True, check=True,
        env=environment() | variables,
    )  # fmt: skip
    figures: dict[str, float] = json.loads(done.stdout)
    return figures


def measure_scene(name: str, runs: int) -> list[dict[str, Any]]:
    """Return the medians of a scene: on gl and on cl, cold and warm, in turns."""
    rows: dict[tuple[str, str], list[dict[str, float]]] = {}
    with tempfile.TemporaryDirectory() as folder:
        for backend in ("gl", "cl"):
            time_scene("triangle", backend, Path(folder), True)
    for _ in range(runs):
        for backend in ("gl", "cl"):
            with tempfile.TemporaryDirectory() as folder:
                for state in ("cold", "warm"):
                    figures = time_scene(name, backend, Path(folder), state == "cold")
                    rows.setdefault((backend, state), []).append(figures)
    return [
        {
            "scene": name, "backend": backend, "cache": state,
            **{key: round(statistics.median(each[key] for each in figures), 3) for key in figures[0]},
        }
        for (backend, state), figures in rows.items()
    ]  # fmt: skip


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--json", action="store_true", help="print the figures as JSON")
    parser.add_argument("--runs", type=int, default=15, help="runs of each import (default: %(default)s)")
    parser.add_argument("--cold-runs", type=int, default=3, help="runs of each scene (default: %(default)s)")
    parser.add_argument("--only", default=",".join(["import", *SCENES]), help="what to measure (default: all)")
    options = parser.parse_args()
    wanted = options.only.split(",")
    times: dict[str, list[float]] = {name: [] for name in IMPORTS if "import" in wanted}
    for number in range(options.runs + 1):
        for name in times:
            seconds = time_import(IMPORTS[name])
            times[name] += [seconds] * (number > 0)
    imports = {name: {"milliseconds": statistics.median(values) * 1e3} for name, values in times.items()}
    scenes = [row for name in SCENES if name in wanted for row in measure_scene(name, options.cold_runs)]
    if options.json:
        print(json.dumps({"imports": imports, "scenes": scenes}, indent=2))
        return
    for name, row in imports.items():
        print(f"import {name:<12} {row['milliseconds']:7.1f} ms")
    for row in scenes:
        shown = ("longest", "median") if row["scene"] == "states" else ("seconds", "processor")
        print(
            f"{row['scene']:<9} {row['backend']} {row['cache']:<5} {shown[0]} {row['seconds']:8.3f} s   "
            f"{shown[1]} {row['processor']:8.3f} s"
        )


if __name__ == "__main__":
    main()
