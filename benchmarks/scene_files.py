"""Times that glTF files of some 60 MB take to load: one large mesh, many meshes and nodes, and many images.

The files are written by this program into a temporary folder; images are JPEG files beside the third one.
Times are processor time of all threads and by the clock, medians of the rounds, in which the files take
turns. "decoding" is that of the images alone, without the rest of the file.

    python benchmarks/scene_files.py [--rounds 5] [--json]
"""

from __future__ import annotations

import argparse
import io
import json
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Final

import numpy as np
from PIL import Image

from renderer.cli import options
from renderer.cli.comparison import run_benchmark
from renderer.content import load_model, save_scene
from renderer.lab.comparison import Column, Record, Subject, compare, time
from renderer.scene import MeshGeometry, SceneBuilder, make_geometry, translation

IMAGES: Final = 24
IMAGE_SIZE: Final = 1024
COLUMNS: Final[dict[str, Column]] = {"processor seconds": time(1.0, processor=True), "seconds": time(1.0)}


def make_grid(side: int, seed: int) -> MeshGeometry:
    """Return a ground of (side, side) vertices with random heights."""
    y, x = np.mgrid[:side, :side].reshape(2, -1)
    heights = np.random.default_rng(seed).uniform(0, 1, side * side)
    first = (np.arange(side - 1)[:, None] * side + np.arange(side - 1)).reshape(-1, 1)
    corners = np.array([[0, side, 1], [1, side, side + 1]])
    triangles = np.concatenate([first + corner for corner in corners])
    return make_geometry(np.stack([x, heights, y], 1), triangles, uv=np.stack([x, y], 1) / side)


def write_scene(path: Path, meshes: int, side: int, nodes: int) -> None:
    """Write a scene of so many different meshes and nodes, and a material with a texture for each image to
    come."""
    builder = SceneBuilder("measured")
    material = builder.add_material(base_color=(0.5, 0.5, 0.5), metallic=0.0)
    rows = [builder.add_mesh(make_grid(side, number)) for number in range(meshes)]
    for number in range(nodes):
        node = builder.add_node(translation(np.array([number % 100, 0, number // 100]) * side))
        builder.add_objects(node, rows[number % meshes], material)
    save_scene(builder.build(), path)


def add_images(path: Path) -> list[bytes]:
    """Give a written document materials with images, in files beside it; return the encoded images."""
    document = json.loads(path.read_text(encoding="utf-8"))
    encoded = []
    for number in range(IMAGES):
        blocks = np.random.default_rng(number).integers(
            0, 256, (IMAGE_SIZE // 8, IMAGE_SIZE // 8, 3), np.uint8
        )
        noise = np.random.default_rng(number).integers(0, 24, (IMAGE_SIZE, IMAGE_SIZE, 3), np.uint8)
        file = io.BytesIO()
        Image.fromarray(blocks.repeat(8, 0).repeat(8, 1) // 2 + noise).save(file, "JPEG", quality=92)
        encoded.append(file.getvalue())
        (path.parent / f"{number}.jpg").write_bytes(encoded[-1])
    document["images"] = [{"uri": f"{number}.jpg"} for number in range(IMAGES)]
    document["textures"] = [{"source": number} for number in range(IMAGES)]
    document["materials"] = [
        {"pbrMetallicRoughness": {"baseColorTexture": {"index": number}}} for number in range(IMAGES)
    ]
    for number, mesh in enumerate(document["meshes"]):
        for primitive in mesh["primitives"]:
            primitive["material"] = number % IMAGES
    document.pop("extras", None)
    path.write_text(json.dumps(document), encoding="utf-8")
    return encoded


def decode(images: list[bytes]) -> None:
    for image in images:
        np.asarray(Image.open(io.BytesIO(image)).convert("RGBA"))


def measure(arguments: argparse.Namespace) -> Iterator[Record]:
    """Yield the times of each file."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        write_scene(folder / "mesh.glb", 1, 1030, 1)
        write_scene(folder / "meshes.glb", 2000, 24, 5000)
        write_scene(folder / "images.gltf", 200, 60, 5000)
        images = add_images(folder / "images.gltf")
        runs: dict[str, Callable[[], object]] = {
            "one mesh": lambda: load_model(str(folder / "mesh.glb")),
            "2,000 meshes, 5,000 nodes": lambda: load_model(str(folder / "meshes.glb")),
            f"200 meshes, 5,000 nodes, {IMAGES} images": lambda: load_model(str(folder / "images.gltf")),
            "decoding": lambda: decode(images),
        }
        total = sum(map(len, images))
        sizes = [(folder / f"{stem}.glb").stat().st_size for stem in ("mesh", "meshes")]
        sizes += [total + sum(file.stat().st_size for file in folder.glob("images.*")), total]
        subjects = [
            Subject({"file": what, "megabytes": round(size / 1e6)}, lambda _, run=run: run())
            for (what, run), size in zip(runs.items(), sizes, strict=True)
        ]
        yield from compare(subjects, COLUMNS, range(arguments.rounds), warm_ups=0)


if __name__ == "__main__":
    run_benchmark(__doc__, (options.rounds("rounds"),), measure)
