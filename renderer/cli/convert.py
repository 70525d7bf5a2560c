"""`convert`: write a scene as a glTF file.

  python -m renderer convert city:blocks=12 city.glb
  python -m renderer convert model.obj model.gltf
  python -m renderer render city.glb --camera ground

A scene that was written is read back the same. What the file can't hold is listed on stderr.
"""

from __future__ import annotations

import argparse
import json
from dataclasses import asdict
from pathlib import Path
from typing import Final

from renderer.cli import options
from renderer.cli.arguments import open_scene
from renderer.cli.output import note
from renderer.cli.subcommand import Subcommand
from renderer.content import save_scene
from renderer.content.gltf import check_model_name
from rhi.errors.output_paths import check_output_file

_OPTIONS: Final = (
    options.SCENE,
    options.output_file("output", "file to write: .glb, or .gltf with a .bin beside it", "FILE"),
    options.JSON,
)


def _run(arguments: argparse.Namespace) -> None:
    file: Path = arguments.output
    check_model_name(file)
    if file.suffix.lower() == ".gltf":
        check_output_file(file.with_suffix(".bin"), "output")
    scene = open_scene(arguments.scene)
    arguments.output.parent.mkdir(parents=True, exist_ok=True)
    left_out = save_scene(scene, arguments.output)
    for omission in left_out:
        note(f"left out: {omission}")
    report = {
        "file": str(arguments.output),
        "bytes": arguments.output.stat().st_size,
        "objects": len(scene.objects),
        "triangles": scene.triangle_count,
        "left_out": [asdict(omission) for omission in (*scene.omissions, *left_out)],
    }
    summary = f"{arguments.output}: {len(scene.objects):,} objects, {scene.triangle_count:,} triangles"
    print(json.dumps(report) if arguments.json else summary)


COMMAND: Final = Subcommand("convert", "write a scene as a glTF file", _OPTIONS, _run, __doc__)
