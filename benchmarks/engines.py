"""The same city drawn by other engines of Python and by this one, as glTF from `save_scene`, seen from above
the roofs.

Each engine loads the file by its own loader, shades it by its own means, and runs in a process and in an
environment of its own (`out/engines`), which is installed when it is asked for. The programs are in
`benchmarks/engines`. All draw `--size` pixels, one sample each, and read the image back. Mesa's cache of
shaders is off, and ours begins empty.

- `load_s`: from the start of the process until the scene is there. `first_ms`: the first frame after that.
- `ms`: a frame, once each engine has drawn for `--warm-up` seconds; the engines take turns, and times are
  medians.
- `ratio`: that time, compared with the first row's in the same round. `memory_mib`: the most that the process
  has held.

`web` and `three` are this renderer and three.js in a page of headless Chromium, on SwiftShader
(`scripts/run_in_node.py --fetch`). Their `memory_mib` is what the page's JavaScript and WebAssembly hold.

What they leave out differs, so no two images are the same; `--images` shows all of them. Ours has haze, which
glTF can't say. Panda3D's fixed pipeline lights vertices, by eight lights, and its own rasteriser filters no
textures.

    python benchmarks/engines.py [--only gl,pygfx] [--scene city] [--rounds 9] [--pictures engines.png]
    [--json]
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
import venv
from collections.abc import Iterator, Mapping
from contextlib import ExitStack
from pathlib import Path
from time import perf_counter
from typing import Any, Final

import numpy as np
from PIL import Image, ImageDraw

from renderer.cli import options
from renderer.cli.comparison import run_benchmark
from renderer.cli.output import note, prepare_image, write_image
from renderer.content import load_scene, save_scene
from renderer.lab.comparison import Record, Subject, compare, ratio, time
from renderer.scene import Scene

FOLDER: Final = Path(__file__).parent / "engines"
ENVIRONMENTS: Final = Path(__file__).parents[1] / "out" / "engines"
PACKAGES: Final[dict[str, tuple[str, ...]]] = {
    "rhi": (),
    "page": (),
    "pygfx": ("numpy", "pygfx==0.17.0", "gltflib==1.0.13", "imageio==2.38.1"),
    "panda3d": ("numpy", "panda3d==1.10.16", "panda3d-gltf==1.3.0"),
    "vtk": ("numpy", "vtk==9.7.2"),
}
"""What the environment of each program of `benchmarks/engines` has; ours is the present one."""
ENGINES: Final = {
    "gl": "rhi",
    "cl": "rhi",
    "wgpu": "rhi",
    "pygfx": "pygfx",
    "panda3d": "panda3d",
    "panda3d_software": "panda3d",
    "vtk": "vtk",
    "web": "page",
    "three": "page",
}
"""The program of each row."""
SEPARATE: Final = ("wgpu", "web", "three")
"""Those that are measured only if they are asked for."""
COLUMNS: Final = {"ms": time(digits=1), "ratio": ratio(2)}
FAR: Final = 4000.0


class Worker:
    """A process in which an engine draws.

    Attributes:
        device: what draws.
        load_s, first_ms: as in the table.
    """

    def __init__(self, engine: str, job: dict[str, Any], cache: str, warm_up: int) -> None:
        program = ENGINES[engine]
        python = install(program)
        begin = perf_counter()
        command = [python, str(FOLDER / f"with_{program}.py"), json.dumps(job | {"engine": engine})]
        variables = {"RHI_CACHE": f"{cache}/{engine}", "MESA_SHADER_CACHE_DISABLE": "true"}
        self._log = Path(f"{cache}/{engine}.log")
        with self._log.open("w", encoding="utf-8") as log:
            self._process = subprocess.Popen(
                command,
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=log,
                text=True,
                env=os.environ
                | variables
                | {"PYTHONPATH": str(FOLDER.parents[1]) if program == "rhi" else ""},
                encoding="utf-8",
            )
        self.device = str(self._read()["device"])
        self.load_s = perf_counter() - begin
        begin = perf_counter()
        self.send("frame")
        self.first_ms = 1e3 * (perf_counter() - begin)
        while perf_counter() - begin < warm_up:
            self.send("frame")

    def send(self, order: str) -> Any:
        """Give an order, and return the answer."""
        assert self._process.stdin is not None
        self._process.stdin.write(f"{order}\n")
        self._process.stdin.flush()
        return self._read()

    def _read(self) -> Any:
        assert self._process.stdout is not None
        line = self._process.stdout.readline()
        if not line:
            raise SystemExit(f"error: an engine has ended: {self._log.read_text(encoding='utf-8')[-2000:]}")
        return json.loads(line)

    def close(self) -> None:
        """End the process."""
        self._process.communicate()


def install(program: str) -> str:
    """Return the interpreter of a program's environment, which is made if it isn't there."""
    if not (packages := PACKAGES[program]):
        return sys.executable
    folder = ENVIRONMENTS / program
    python, done = folder / "bin" / "python", folder / "installed.txt"
    if not done.exists() or done.read_text(encoding="utf-8") != "\n".join(packages):
        note(f"installing {', '.join(packages)} in {folder}")
        venv.create(folder, clear=True, with_pip=True)
        subprocess.run([python, "-m", "pip", "install", "--quiet", *packages], check=True)
        done.write_text("\n".join(packages), encoding="utf-8")
    return str(python)


def make_job(scene: Scene, path: str, size: tuple[int, int]) -> dict[str, Any]:
    """A `Job` of `benchmarks/engines/serving.py`: the scene's first view."""
    eye = next(iter(scene.views.values()))
    return {
        "path": path,
        "width": size[0],
        "height": size[1],
        "eye": eye.position.tolist(),
        "ahead": eye.forward.tolist(),
        "fov": float(np.degrees(eye.projection.fov)),
        "near": eye.projection.near,
        "far": FAR,
        "background": list(scene.background),
        "ambient": list(scene.lights.sky),
        "sun": scene.lights.directional["color"][0].tolist()
        if len(scene.lights.directional)
        else [1.0, 1.0, 1.0],
    }


def join(images: Mapping[str, Any]) -> Any:
    """Return images (h, w, 3) by their engines' names, of half their size in rows of two, with the names on
    them."""
    height, width = (size // 2 for size in next(iter(images.values())).shape[:2])
    montage = Image.new("RGB", (2 * width, height * -(-len(images) // 2)), "white")
    pen = ImageDraw.Draw(montage)
    for number, (name, pixels) in enumerate(images.items()):
        corner = number % 2 * width, number // 2 * height
        montage.paste(Image.fromarray(pixels).resize((width, height), Image.Resampling.LANCZOS), corner)
        pen.text((corner[0] + 8, corner[1] + 6), name, "black", font_size=height / 16)
    return np.asarray(montage)


OPTIONS: Final = (
    options.names(
        "--only",
        ENGINES,
        "no engine that is compared",
        [name for name in ENGINES if name not in ("wgpu", "web", "three")],
    ),
    options.option("--scene", "what is drawn", "city"),
    options.size((1280, 720)),
    options.rounds("rounds", 9),
    options.count("--warm-up", "seconds for which each engine draws before it is timed", 20),
    options.file("--images", "write all images, of half their size in rows of two"),
)


def measure(arguments: argparse.Namespace) -> Iterator[Record]:
    if arguments.images is not None:
        prepare_image(arguments.images, "--images")
    with ExitStack() as opened:
        folder = opened.enter_context(tempfile.TemporaryDirectory())
        scene = load_scene(arguments.scene)
        path = f"{folder}/scene.glb"
        save_scene(scene, path)
        job = make_job(scene, path, arguments.size)
        subjects, images = [], {}
        for engine in arguments.only:
            worker = Worker(engine, job, folder, arguments.warm_up)
            opened.callback(worker.close)

            def finish(engine: str = engine, worker: Worker = worker) -> Record:
                answer = worker.send(f"end {folder}/{engine}.rgb")
                pixels = np.fromfile(f"{folder}/{engine}.rgb", np.uint8)
                images[engine] = pixels.reshape(job["height"], job["width"], 3)
                parts = [f"{round(answer[name])} MiB {name}" for name in answer if name != "memory"]
                if parts:
                    note(f"{engine}: {', '.join(parts)}")
                return {
                    "first_ms": round(worker.first_ms),
                    "load_s": round(worker.load_s, 2),
                    "memory_mib": round(answer["memory"]),
                }

            labels = {"engine": engine, "device": worker.device}
            subjects.append(Subject(labels, lambda _, worker=worker: worker.send("frame"), summarize=finish))
        yield from compare(subjects, COLUMNS, range(arguments.rounds))
        if arguments.images is not None:
            write_image(arguments.images, join(images))


if __name__ == "__main__":
    run_benchmark(__doc__, OPTIONS, measure, kernels="")
