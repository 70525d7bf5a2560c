"""Costs of skinned characters whose vertices the device computes, or NumPy, which uploads them.

The scene is a glTF file: a row of tubes, each with a skin of its own, a chain of joints that all turn, and two
morph targets. Each is drawn with a shadow map. The variants take turns, round by round, in one process; times are
medians over the rounds, from the frame's begin until the device is finished.

    python benchmarks/skins.py [--backend gl] [--objects 20] [--vertices 4000] [--joints 30] [--rounds 15] [--json]
"""

from __future__ import annotations

import argparse
import json
from base64 import b64encode
from collections.abc import Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

import rhi
from renderer.cli import options
from renderer.cli.comparison import run_benchmark
from renderer.content.models import load_model
from renderer.lab.comparison import Column, Record, Subject, average, compare, ratio, time
from renderer.renderer import Renderer
from renderer.scene import Camera, Scene
from renderer.scene.meshes import list_grid_triangles
from renderer.techniques import Forward

AROUND = 20
HEIGHT = 2.0
COLUMNS: dict[str, Column] = {
    "dispatches": average(1),
    "bytes": average(0),
    "milliseconds": time(),
    "ratio": ratio(),
}
"""The columns of a frame's cost; the ratio is to vertices by NumPy."""


class OnNumpy:
    """A simulation of vertices that hides from devices how it computes them there."""

    def __init__(self, simulation: Any) -> None:
        self.catch_up = simulation.catch_up
        self.set_time, self.vertices = simulation.set_time, simulation.vertices

    def __deepcopy__(self, memo: object) -> OnNumpy:
        return self


class Document:
    """A glTF document of skinned tubes."""

    def __init__(self, count: int, vertices: int, joints: int) -> None:
        self.values: dict[str, list[Any]] = {
            name: [] for name in ("accessors", "bufferViews", "nodes", "skins")
        }
        self.data = bytearray()
        rows = max(vertices // AROUND, 2)
        angle, height = np.meshgrid(np.linspace(0.0, 2.0 * np.pi, AROUND), np.linspace(0.0, HEIGHT, rows))
        normals = np.stack([np.cos(angle), 0.0 * angle, -np.sin(angle)], axis=-1).reshape(-1, 3)
        positions = 0.2 * normals
        positions[:, 1] = height.reshape(-1)
        nearest = np.clip(positions[:, 1] / HEIGHT * joints - 0.5, 0.0, joints - 1.0)
        lower = np.minimum(nearest.astype(np.int64), max(joints - 2, 0))
        share = nearest - lower
        zeros = np.zeros_like(lower)
        attributes = {
            "POSITION": self.store(positions.astype(np.float32), "VEC3"),
            "NORMAL": self.store(normals.astype(np.float32), "VEC3"),
            "JOINTS_0": self.store(
                np.stack([lower, np.minimum(lower + 1, joints - 1), zeros, zeros], 1).astype(np.uint16),
                "VEC4",
            ),
            "WEIGHTS_0": self.store(
                np.stack([1.0 - share, share, zeros, zeros], 1).astype(np.float32), "VEC4"
            ),
        }
        targets = [
            {
                "POSITION": self.store(
                    (scale * np.sin(3.0 * positions[:, 1:2]) * normals).astype(np.float32), "VEC3"
                )
            }
            for scale in (0.05, -0.03)
        ]
        indices = self.store(list_grid_triangles(rows, AROUND).astype(np.uint32), "SCALAR")
        binds = np.tile(np.eye(4, dtype=np.float32), (joints, 1, 1))
        binds[:, 3, 1] = -HEIGHT / joints * np.arange(joints)
        bind_matrices = self.store(binds.reshape(-1, 16), "MAT4")
        times = self.store(np.linspace(0.0, 2.0, 9).astype(np.float32), "SCALAR")
        turns = np.sin(np.linspace(0.0, 2.0 * np.pi, 9)) * 1.0 / joints
        rotations = np.stack([np.sin(turns / 2), 0 * turns, 0 * turns, np.cos(turns / 2)], axis=1)
        turned = self.store(rotations.astype(np.float32), "VEC4")
        weights = self.store(np.tile(np.float32([0.0, 1.0]), 9), "SCALAR")
        samplers = [{"input": times, "output": turned}, {"input": times, "output": weights}]
        channels = []
        for character in range(count):
            first = len(self.values["nodes"])
            for joint in range(joints):
                position = [1.0 * character, 0.0, 0.0] if joint == 0 else [0.0, HEIGHT / joints, 0.0]
                below = {"children": [first + joint + 1]} if joint < joints - 1 else {}
                self.values["nodes"].append({"translation": position, **below})
                channels.append({"sampler": 0, "target": {"node": first + joint, "path": "rotation"}})
            mesh_node = len(self.values["nodes"])
            self.values["nodes"].append({"mesh": 0, "skin": character})
            channels.append({"sampler": 1, "target": {"node": mesh_node, "path": "weights"}})
            chain = list(range(first, first + joints))
            self.values["skins"].append({"joints": chain, "inverseBindMatrices": bind_matrices})
        primitive = {"attributes": attributes, "indices": indices, "targets": targets}
        self.meshes = [{"primitives": [primitive], "weights": [0.0, 0.0]}]
        self.animations = [{"samplers": samplers, "channels": channels}]

    def store(self, array: np.ndarray, kind: str) -> int:
        """Add an accessor of an array; return its number."""
        data = array.tobytes()
        view = {"buffer": 0, "byteOffset": len(self.data), "byteLength": len(data)}
        self.data += data + bytes(-len(data) % 4)
        component = {"f4": 5126, "u2": 5123, "u4": 5125}[array.dtype.str[1:]]
        self.values["bufferViews"].append(view)
        accessor = {"bufferView": len(self.values["bufferViews"]) - 1, "componentType": component}
        self.values["accessors"].append({**accessor, "count": len(array), "type": kind})
        return len(self.values["accessors"]) - 1

    def load(self) -> Scene:
        """Return the document as a scene."""
        uri = "data:application/octet-stream;base64," + b64encode(bytes(self.data)).decode()
        document = {
            "asset": {"version": "2.0"},
            "buffers": [{"byteLength": len(self.data), "uri": uri}],
            "meshes": self.meshes,
            "animations": self.animations,
            **self.values,
        }
        with TemporaryDirectory() as folder:
            path = Path(folder) / "tubes.gltf"
            path.write_text(json.dumps(document), encoding="utf-8")
            return load_model(path)


class Variant:
    """A scene and its renderer."""

    def __init__(self, device: rhi.Device, scene: Scene, count: int) -> None:
        self.device = device
        scene.lights.add_directional((0.4, -1.0, -0.3))
        self.renderer = Renderer(device, scene, visibility="frustum", size=(320, 180), technique=Forward())
        middle = 0.5 * (count - 1)
        self.towards = Camera.look_at((middle, 1.5, 2.0 + 0.8 * count), (middle, 1.0, 0.0))
        self.away = Camera.look_at((middle, 1.5, 2.0 + 0.8 * count), (middle, 1.0, 1e3))
        self.camera = self.towards
        self.frames = 0

    def draw(self, _: int) -> None:
        """Draw the next frame."""
        self.frames += 1
        before = self.device.statistics.dispatches
        self.result = self.renderer.render(self.camera, self.frames / 60)
        self.device.finish()
        self.dispatches = self.device.statistics.dispatches - before

    def count(self) -> Mapping[str, int]:
        return {"dispatches": self.dispatches, "bytes": self.result.statistics.upload_bytes}


def measure(arguments: argparse.Namespace) -> Iterator[Record]:
    """Yield the cost of each view and variant."""
    count = arguments.objects
    with rhi.create_device(arguments.backend) as device:
        variants = {}
        for name in ("NumPy", "device"):
            scene = Document(count, arguments.vertices, arguments.joints).load()
            if name == "NumPy":
                scene.simulated = tuple(
                    replace(part, simulation=OnNumpy(part.simulation)) if len(part.objects) else part
                    for part in scene.simulated
                )
            variants[name] = Variant(device, scene, count)
        for view in ("towards", "away"):
            subjects = []
            for name, variant in variants.items():
                variant.camera = getattr(variant, view)
                subjects.append(
                    Subject(
                        {"view": view, "vertices by": name}, variant.draw, count=variant.count, device=device
                    )
                )
            yield from compare(subjects, COLUMNS, range(arguments.rounds), warm_ups=2)
        for variant in variants.values():
            variant.renderer.destroy()


OPTIONS = (
    options.option("--backend", "the device", "gl"),
    options.count("--objects", "skinned tubes", 20),
    options.count("--vertices", "vertices of each", 4000),
    options.count("--joints", "joints of each", 30),
    options.rounds("rounds", 15),
)


if __name__ == "__main__":
    run_benchmark(__doc__, OPTIONS, measure)
