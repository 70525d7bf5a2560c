"""Compressed images: the bytes of a scene's textures, the errors of each format, and the time that compression takes.

Errors are those of the largest level in levels of 8 bits: the mean over texels and images, and the largest; of normal
maps, those of red and green. Without the package etcpak (the extra `compression`) there is nothing to measure.

    python benchmarks/compressed_images.py [--scenes "yard;city:blocks=4;bazaar"] [--json | --markdown]
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterator
from importlib.util import find_spec
from pathlib import Path
from time import perf_counter
from typing import Final

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1]))

from renderer.cli.comparison import run_benchmark
from renderer.cli.options import option
from renderer.content import load_scene
from renderer.content.compression import choose_format, compress_image
from renderer.frame.scene_images import count_bytes
from renderer.lab.comparison import Record
from renderer.scene import Compression, Scene
from renderer.scene.material_instances import collect_normal_images

OPTIONS: Final = (option("--scenes", "scenes, with semicolons between them", "yard;city:blocks=4;bazaar"),)


def measure(arguments: argparse.Namespace) -> Iterator[Record]:
    """Yield a row for each scene and format."""
    for text in arguments.scenes.split(";"):
        if find_spec("etcpak") is None:
            yield {"scene": text, "remark": "the package etcpak is missing"}
            continue
        scene = load_scene(text)
        for compression in (Compression.BC1, Compression.BC7):
            for row in measure_scene(scene, compression):
                yield {"scene": text, "compression": compression.value, **row}


def measure_scene(scene: Scene, compression: Compression) -> list[Record]:
    """Compress the images of a scene; return a row for each format."""
    normals = collect_normal_images(scene.textures, scene.materials, scene.shaders, scene.parameters)
    rows: dict[str, Record] = {}
    for image, is_color in sorted({(int(use["image"]), bool(use["is_color"])) for use in scene.textures}):
        pixels, is_normal = scene.images[image], not is_color and image in normals
        format = choose_format(pixels, compression, is_color=is_color, is_normal=is_normal)
        if format is None:
            continue
        start = perf_counter()
        blocks = compress_image(pixels, format)
        seconds = perf_counter() - start
        channels = 2 if is_normal else 3
        off = np.abs(blocks.decode()[..., :channels].astype(float) - pixels[..., :channels])
        row = rows.setdefault(
            format.name,
            {
                "format": format.name,
                "images": 0,
                "bytes before": 0,
                "bytes": 0,
                "mean error": 0.0,
                "largest error": 0,
                "seconds": 0.0,
            },
        )
        row["mean error"] = (row["mean error"] * row["images"] + float(off.mean())) / (row["images"] + 1)
        row["largest error"] = max(row["largest error"], int(off.max()))
        row["images"] += 1
        row["bytes before"] += count_bytes(blocks.size)
        row["bytes"] += blocks.bytes
        row["seconds"] += seconds
    return list(rows.values())


if __name__ == "__main__":
    run_benchmark(__doc__, OPTIONS, measure)
