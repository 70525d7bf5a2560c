"""Execution of programs on a device, and the comparison with what the interpreter allows."""

from __future__ import annotations

from contextlib import ExitStack
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

import rhi
from rhi.conformance.programs import model
from rhi.conformance.programs.coverage import clip_corners
from rhi.conformance.programs.interpreter import Result, interpret, random_texels
from rhi.conformance.programs.shader_kinds import SHADERS, AddTexels, Move
from rhi.conformance.programs.tolerances import EXACT, Tolerances
from rhi.conformance.shaders import Corner
from rhi.device.encoder import Encoder
from rhi.device.resources.programs import Program as DeviceProgram
from rhi.shading import uint


@dataclass(frozen=True, slots=True)
class Difference:
    """A result that lies outside of what the interpreter allows."""

    name: str
    count: int
    first: tuple[int, ...]
    actual: float
    low: float
    high: float

    def __str__(self) -> str:
        at = ", ".join(map(str, self.first))
        expected = f"{self.low!r} to {self.high!r}"
        return f"{self.name}: {self.count} differ, first at ({at}): {self.actual!r}, not {expected}"


def check(device: rhi.Device, program: model.Program, tolerances: Tolerances = EXACT) -> list[Difference]:
    """Run a program on a device and return its differences from the interpreter's results."""
    return compare(run(device, program), interpret(program, tolerances))


def compare(actual: list[tuple[str, NDArray[Any]]], allowed: list[Result]) -> list[Difference]:
    """Return where results lie outside of what is allowed."""
    differences = []
    for (name, array), result in zip(actual, allowed, strict=True):
        assert name == result.name, (name, result.name)
        values = array.astype(np.float64).reshape(result.low.shape)
        if array.dtype == np.int8:
            values = np.maximum(values, -127)  # −128 and −127 both mean −1
        unknown = np.isneginf(result.low) & np.isposinf(result.high)
        with np.errstate(invalid="ignore"):
            wrong = ~((values >= result.low) & (values <= result.high)) & ~unknown
        if wrong.any():
            first = tuple(int(i) for i in np.argwhere(wrong)[0])
            low, high = float(result.low[first]), float(result.high[first])
            differences.append(Difference(name, int(wrong.sum()), first, float(values[first]), low, high))
    return differences


def run(device: rhi.Device, program: model.Program) -> list[tuple[str, NDArray[Any]]]:
    """Execute a program; return its reads, counts and buffers, and the final contents of its images, each
    named."""
    with ExitStack() as stack:
        return _Run(device, program, stack).results()


class _Run:
    def __init__(self, device: rhi.Device, program: model.Program, stack: ExitStack) -> None:
        self._device, self._program, self._stack = device, program, stack
        self._images: list[rhi.Texture] = []
        for image in program.images:
            texture = device.texture(
                image.size,
                image.format,
                kind=image.kind,
                layers=image.layers,
                levels=image.levels,
                samples=image.samples,
            )
            self._images.append(stack.enter_context(texture))
        self._shapes = list(program.shapes)
        self._meshes: dict[tuple[int, tuple[int, int]], rhi.Mesh] = {}
        self._counts: rhi.StorageBuffer[uint] = stack.enter_context(device.storage(uint, model.CELLS))
        self._reds: rhi.StorageBuffer[uint] = stack.enter_context(device.storage(uint, model.CELLS))
        self._queries: list[rhi.OcclusionQuery] = []
        for _ in range(program.queries):
            query = device.occlusion_query()
            stack.callback(query.destroy)
            self._queries.append(query)
        self._used: set[int] = set()
        self._sets: list[rhi.QuerySet] = []
        self._reads: list[tuple[str, NDArray[Any]]] = []

    def results(self) -> list[tuple[str, NDArray[Any]]]:
        for step in self._program.steps:
            self._execute(step)
        results = self._reads
        for number, queries in enumerate(self._sets):
            results.append((f"query set {number}", queries.wait()))
        counts = [self._queries[i].wait() if i in self._used else 0 for i in range(len(self._queries))]
        results.append(("queries", np.array(counts)))
        results += [("counts", self._counts.read()), ("reds", self._reds.read())]
        for number, image in enumerate(self._program.images):
            texture = self._images[number]
            if image.samples > 1:
                if not (image.format.is_depth or image.format.is_integer):
                    with self._device.texture(image.size, image.format) as mean:
                        texture.resolve_to(mean)
                        results.append((f"image {number}, resolved", mean.read()))
                continue
            for level in range(image.levels):
                for layer in range(image.level_layers(level)):
                    subresource = f"image {number}, level {level}, layer {layer}"
                    results.append((subresource, texture.read(level, layer)))
                    if image.format.has_stencil:
                        results.append((f"stencil of {subresource}", texture.read_stencil(level, layer)))
        return results

    def _execute(self, step: model.Step) -> None:
        device, images = self._device, self._images
        match step:
            case model.Pass():
                self._pass(device, step)
            case model.RecordedPasses():
                with device.record() as commands:
                    for part in step.passes:
                        self._pass(commands, part)
                for _ in range(step.times):
                    device.submit(commands)
            case model.Copy():
                x, y, width, height, layer, layers = step.box
                images[step.source.image].copy_to(
                    images[step.target.image],
                    level=step.source.level,
                    region=rhi.Region(x, y, width, height, layer, layers),
                    target_level=step.target.level,
                    x=step.x,
                    y=step.y,
                    layer=step.target.layer,
                )
            case model.Write():
                texture = images[step.target.image]
                texels = random_texels(texture.format, step)
                if texture.format.channels == 1:
                    texels = texels[..., 0]
                texture.write(texels, step.target.level, step.target.layer, step.x, step.y)
            case model.Mipmaps():
                images[step.image].generate_mipmaps()
            case model.Resolve():
                images[step.source].resolve_to(images[step.target])
            case model.Read():
                subresource = step.subresource
                texels = images[subresource.image].read(subresource.level, subresource.layer)
                self._reads.append((f"read of {subresource}", texels))
            case model.Reshape():
                self._reshape(step)
            case model.ClearCells():
                self._counts.clear(step.value)
                self._reds.clear(step.value)
            case model.Dispatch():
                image = images[step.source.image]
                width, height = image.size
                groups = (-(-width // 8), -(-height // 8))
                program = device.program(AddTexels)
                device.dispatch(program, groups, source=image, counts=self._counts)

    def _reshape(self, step: model.Reshape) -> None:
        shape, source = self._shapes[step.shape], self._shapes[step.source]
        count = min(len(shape.corners), len(source.corners))
        corners = source.corners[:count] + shape.corners[count:]
        self._shapes[step.shape] = model.Shape(shape.primitive, corners, shape.indices)
        for (number, frame), mesh in self._meshes.items():
            if number == step.shape:
                assert mesh.vertices is not None
                mesh.vertices.write(_rows(self._shapes[number], frame)[:count])

    def _mesh(self, number: int, frame: tuple[int, int]) -> rhi.Mesh:
        """Return the mesh of a shape in a frame; it is made once, before anything is recorded with it."""
        mesh = self._meshes.get((number, frame))
        if mesh is None:
            shape = self._shapes[number]
            indices = None if shape.indices is None else np.array(shape.indices, np.uint16)
            mesh = self._device.mesh(_rows(shape, frame), indices, primitive=shape.primitive)
            self._meshes[number, frame] = self._stack.enter_context(mesh)
        return mesh

    def _target(self, subresource: model.Subresource) -> Any:
        return self._images[subresource.image].at(subresource.level, subresource.layer)

    def _pass(self, encoder: Encoder, step: model.Pass) -> None:
        sets = []
        resolve = [None if i is None else self._images[i] for i in step.resolve]
        with encoder.render_pass(
            [self._target(subresource) for subresource in step.colors] or None,
            None if step.depth is None else self._target(step.depth),
            clear=list(step.clear) or None,
            clear_depth=step.clear_depth,
            clear_stencil=step.clear_stencil,
            resolve=resolve or None,
        ):
            for draw in step.draws:
                sets += self._draw(encoder, draw)
        self._sets += sets

    def _draw(self, encoder: Encoder, draw: model.Draw) -> list[rhi.QuerySet]:
        device = self._device
        program: DeviceProgram[...] = device.program(SHADERS[draw.shader])
        bindings: dict[str, Any] = {}
        level, layer = (draw.source.level, draw.source.layer) if draw.source is not None else (0, 0)
        bindings["move"] = encoder.transient.uniform(Move(step=draw.step, level=level, layer=layer))
        if draw.shader in (model.ShaderKind.COUNT, model.ShaderKind.COUNT_EARLY):
            bindings |= {"counts": self._counts, "reds": self._reds}
        if draw.source is not None and draw.shader in (model.ShaderKind.LOAD, model.ShaderKind.LOAD_LAYER):
            bindings["source"] = self._images[draw.source.image]
        mesh = self._mesh(draw.shape, draw.frame)
        sets: list[rhi.QuerySet] = []
        with ExitStack() as around:
            around.enter_context(encoder.states(*draw.states))
            if draw.condition is not None:
                number, inverted = draw.condition
                around.enter_context(encoder.conditional(self._queries[number], inverted=inverted))
            if draw.query is not None:
                self._used.add(draw.query)
                around.enter_context(self._query(encoder, draw.query))
            parts = _array(mesh, draw.parts)
            match draw.method:
                case model.DrawMethod.DIRECT:
                    for part in draw.parts:
                        view = mesh.view(part.first, part.count, base_instance=part.base_instance)
                        encoder.draw(program, view, part.instances, **bindings)
                case model.DrawMethod.MANY:
                    encoder.draw_many(program, mesh, parts, **bindings)
                case model.DrawMethod.INDIRECT:
                    arguments: rhi.Buffer = device.buffer(parts)
                    self._stack.enter_context(arguments)
                    encoder.draw_indirect(program, mesh, rhi.IndirectDraws(arguments, len(parts)), **bindings)
                case model.DrawMethod.COUNTED:
                    sets.append(device.query_set(len(parts)))
                    self._stack.callback(sets[0].destroy)
                    encoder.draw_counted(program, mesh, parts, sets[0], **bindings)
        return sets

    def _query(self, encoder: Encoder, number: int) -> Any:
        query = self._queries[number]
        if encoder is self._device:
            return query
        return encoder.query(query)  # type: ignore[attr-defined]


def _rows(shape: model.Shape, frame: tuple[int, int]) -> NDArray[Any]:
    clip, colors = clip_corners(shape, frame)
    rows = np.zeros(len(clip), Corner.dtype)
    rows["position"], rows["color"] = clip, colors
    return rows


def _array(mesh: rhi.Mesh, parts: tuple[model.Part, ...]) -> NDArray[Any]:
    columns = (
        [getattr(part, name) for part in parts] for name in ("first", "count", "instances", "base_instance")
    )
    first, count, instances, base = (np.array(column) for column in columns)
    return mesh.draws(first, count, instances=instances, base_instance=base)
