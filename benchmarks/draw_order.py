"""Cost of the order of draws where each object is a draw of its own, and as one draw of all.

Objects have one of several programs, materials and meshes, by chance, as in a scene: each draw binds its object's
constants, and its program, material and mesh where they aren't those of the draw before. The orders are

- `as listed`: by chance;
- `sorted`: by program, then by material, then by mesh;
- `one draw`: the same objects from tables, as the renderer draws: one program for all, materials are rows of a storage
  buffer, and meshes are ranges of one.

Changes are counted on a null device. Times are those of the GL backend on 64×64 pixels, without rasterising: filling
pixels costs all orders the same. The orders take turns in one process; figures are medians over the rounds.

    python benchmarks/draw_order.py [--json] [--objects 5000] [--programs 2] [--materials 300] [--meshes 400]
                                    [--rounds 15]
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from dataclasses import asdict
from typing import Any

import moderngl
import numpy as np

import rhi
from renderer.cli import options
from renderer.cli.comparison import run_benchmark
from renderer.lab.comparison import Record, Subject, compare, time
from renderer.lab.measure.draw_order import count_changes
from rhi.shading import Shader, Storage, Struct, Uniform, instance_index, vec2, vec4

RASTERIZER_DISCARD = 0x8C89
TRIANGLES = 8


class Corner(Struct):
    position: vec2


class Object(Struct):
    offset: vec4


class Material(Struct):
    color: vec4


class Row(Struct):
    offset: vec4
    material: int


class Varying(Struct):
    clip: vec4
    color: vec4


class Flat(Shader):
    """Has the constants of one object and one material."""

    object: Uniform[Object]
    material: Uniform[Material]

    def vertex(self, v: Corner) -> Varying:
        return Varying(clip=vec4(v.position, 0.5, 1.0) + self.object.offset, color=self.material.color)

    def fragment(self, v: Varying) -> vec4:
        return v.color


class FromTables(Shader):
    """Finds its object by its instance, and its material by its object."""

    objects: Storage[Row]
    materials: Storage[Material]

    def vertex(self, v: Corner) -> Varying:
        row = self.objects[instance_index()]
        return Varying(clip=vec4(v.position, 0.5, 1.0) + row.offset, color=self.materials[row.material].color)

    def fragment(self, v: Varying) -> vec4:
        return v.color


class Orders:
    """Objects on a device, and what draws them in each order."""

    def __init__(self, device: rhi.Device, given: argparse.Namespace) -> None:
        self._device = device
        random, count = np.random.default_rng(0), given.objects
        material, mesh = random.integers(0, given.materials, count), random.integers(0, given.meshes, count)
        program = material % given.programs  # that of a material
        corners = (random.random((given.meshes, TRIANGLES * 3, 2), np.float32) - 0.5) * 0.1
        offset = np.zeros((count, 4), np.float32)
        offset[:, :2] = random.random((count, 2)) * 1.8 - 0.9

        kinds = [type(f"Flat{number}", (Flat,), {"__module__": __name__}) for number in range(given.programs)]
        programs = [device.program(kind) for kind in kinds]
        meshes = [device.mesh({"position": part}) for part in corners]
        objects, materials = device.uniform_array(Object, count), device.uniform_array(Material, given.materials)
        for array, name, values in (
            (objects, "offset", offset),
            (materials, "color", random.random((given.materials, 4))),
        ):
            rows = np.zeros(len(values), array.dtype)
            rows[name] = values
            array.write(rows)
        self._draws: list[tuple[Any, Any, Any, Any]] = [
            (programs[program[i]].draw, meshes[mesh[i]], objects[i], materials[material[i]]) for i in range(count)
        ]
        self._sorted = [self._draws[i] for i in np.lexsort((mesh, material, program))]

        table: Any = np.zeros(count, Row.dtype)
        table["offset"], table["material"] = offset, material
        self._tables = {
            "objects": device.storage(Row, table),
            "materials": device.storage(Material, np.zeros(given.materials, Material.dtype)),
        }
        self._from_tables: Any = device.program(FromTables)
        self._all = device.mesh({"position": corners.reshape(-1, 2)})
        self._parts = self._all.draws(mesh * TRIANGLES * 3, TRIANGLES * 3, base_instance=np.arange(count))
        self.image = device.texture((64, 64), rhi.Format.RGBA8)

    def as_listed(self) -> None:
        for draw, mesh, constants, material in self._draws:
            draw(mesh, object=constants, material=material)

    def sorted(self) -> None:
        for draw, mesh, constants, material in self._sorted:
            draw(mesh, object=constants, material=material)

    def one_draw(self) -> None:
        self._device.draw_many(self._from_tables, self._all, self._parts, **self._tables)

    @property
    def by_name(self) -> dict[str, Callable[[], None]]:
        return {"as listed": self.as_listed, "sorted": self.sorted, "one draw": self.one_draw}


def count(given: argparse.Namespace) -> dict[str, dict[str, int]]:
    """Return what changes in each order, and the number of draw commands."""
    found = {}
    with rhi.create_device("null") as device:
        orders = Orders(device, given)
        for name, draw in orders.by_name.items():
            with device.render_pass(orders.image):
                draw()  # so that no order profits from what is bound before
            device.stream.clear()
            with device.render_pass(orders.image):
                draw()
            found[name] = asdict(count_changes(device.stream)) | {"draws": len(device.stream.draws())}
    return found


def measure(given: argparse.Namespace) -> Iterator[Record]:
    """Yield what changes in each order, and its microseconds per object on the CPU."""
    counts = count(given)
    with rhi.create_device("gl") as device, ExitStack() as opened:
        orders = Orders(device, given)

        def open_pass() -> None:
            opened.close()
            device.finish()
            opened.enter_context(device.render_pass(orders.image))

        context = moderngl.get_context()
        context.enable_direct(RASTERIZER_DISCARD)
        subjects = [
            Subject({"order": name, **counts[name]}, lambda _, draw=draw: draw(), open_pass)
            for name, draw in orders.by_name.items()
        ]
        columns = {"microseconds": time(1e6 / given.objects, processor=True)}
        yield from compare(subjects, columns, range(given.rounds), warm_ups=2)  # these build programs
        opened.close()
        context.disable_direct(RASTERIZER_DISCARD)


OPTIONS = (
    *(
        options.count(f"--{name}", f"number of {name}", default)
        for name, default in {"objects": 5000, "programs": 2, "materials": 300, "meshes": 400}.items()
    ),
    options.rounds("rounds", 15),
)


if __name__ == "__main__":
    run_benchmark(__doc__, OPTIONS, measure)
