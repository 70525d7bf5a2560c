"""Random command buffers that are submitted again and again, compared with the same commands given directly.

Between submissions, contents of buffers and textures change, and other draws set states and bindings. Platforms may
prepare draws that repeat: no earlier one may be seen in a later one.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import ExitStack
from typing import Any, Final

import numpy as np
import pytest

import rhi
import rhi.shading as sl
from rhi import (
    BlendColor,
    BlendFactor,
    BlendFunction,
    BufferUsage,
    ColorWrite,
    Comparison,
    CullMode,
    DepthFunction,
    DepthTest,
    DepthWrite,
    Device,
    Format,
    Primitive,
    Scissor,
    State,
    StencilFront,
    StencilOperation,
    StencilReference,
    StencilTest,
    Texture,
    Viewport,
)
from rhi.conformance.compare import assert_same
from rhi.conformance.shaders import Colored, FlatColored, FlatShade, Loads, Tint, Tinted, Weighted
from rhi.conformance.shapes import corners

pytestmark = [pytest.mark.requires("draws", "shading"), pytest.mark.recorded_too]

SIZE: Final = (24, 16)
CORNERS: Final = 48
SUBMISSIONS: Final = 5
SEEDS: Final = 12
BLENDS: Final = (
    BlendFunction.OFF,
    BlendFunction.ADDITIVE,
    BlendFunction(BlendFactor.CONSTANT, BlendFactor.ONE),
    BlendFunction(BlendFactor.ONE, BlendFactor.ONE_MINUS_CONSTANT),
)
RESTARTING: Final = (Primitive.TRIANGLE_STRIP, Primitive.TRIANGLE_FAN, Primitive.QUADS)
"""Primitives that the largest index restarts everywhere."""


class Tally(FlatColored):
    """Draws colors, and counts its fragments."""

    total: sl.StorageRW[sl.uint]

    def fragment(self, v: FlatShade) -> sl.vec4:
        sl.atomic_add(self.total[0], sl.uint(1))
        return v.color


Draw = Callable[[rhi.Encoder, "Scene"], None]


class Scene:
    """The resources of random draws.

    Attributes:
        targets: for direct draws and for recorded ones: a color and a depth target each.
        totals: what fragments count, for each of them.
        side: 0 for direct draws, 1 for recorded ones.
    """

    def __init__(self, device: Device, numbers: np.random.Generator, opened: ExitStack) -> None:
        self.device = device
        self.numbers = numbers
        self.side = 0
        keep = opened.enter_context
        self.depth_format = Format.D24S8 if device.capabilities.stencil else Format.D32F
        self.targets = [
            (keep(device.texture(SIZE, Format.RGBA8)), keep(device.texture(SIZE, self.depth_format)))
            for _ in range(2)
        ]
        self.small = [keep(device.texture((8, 8), Format.RGBA16F)) for _ in range(2)]
        self.vertices = keep(device.buffer(self.make_corners()))
        streamed = self.streamed = keep(
            device.buffer(CORNERS, self.make_corners().dtype, usage=BufferUsage.STREAM)
        )
        streamed.write(self.make_corners())
        restarts = device.capabilities.list_restart
        self.meshes: list[rhi.Mesh] = []
        self.indices: list[tuple[rhi.Buffer, bool]] = []  # and whether they may restart
        for primitive in (Primitive.TRIANGLES, *RESTARTING):
            self.meshes.append(keep(device.mesh(self.vertices, primitive=primitive)))
            for usage in (BufferUsage.STATIC, BufferUsage.STREAM):
                buffer = keep(device.buffer(CORNERS, np.dtype("u2"), usage=usage))
                buffer.write(self.make_indices(False))
                self.indices.append((buffer, restarts or primitive in RESTARTING))
                self.meshes.append(keep(device.mesh(self.vertices, buffer, primitive=primitive)))
        self.meshes.append(keep(device.mesh(streamed)))
        indexed = [self.meshes[1], self.meshes[4]]
        self.plain_meshes = [*indexed, *(mesh for mesh in self.meshes if not mesh.is_indexed)]
        self.tints = device.uniform_array(Tint, 16)
        self.texture = keep(device.texture(SIZE, Format.RGBA8))
        self.weights = keep(device.storage(sl.vec4, numbers.random((3, 4), np.float32)))
        self.totals = [keep(device.storage(sl.uint, np.zeros(1, np.uint32))) for _ in range(2)]
        self.queries: list[list[rhi.OcclusionQuery]] = [[], []]
        if device.capabilities.occlusion_queries:
            self.queries = [[device.occlusion_query() for _ in range(2)] for _ in range(2)]
        self.used_queries: set[int] = set()
        self.programs: dict[type, Any] = {
            each: device.program(each) for each in (Tinted, Colored, Weighted, Loads, Tally)
        }
        self.change()

    def make_corners(self) -> Any:
        numbers = self.numbers
        positions = numbers.random((CORNERS, 3)) * (2.4, 2.4, 1.0) - (1.2, 1.2, 0.0)
        return corners(positions[:, :2], numbers.random((CORNERS, 4)), positions[:, 2])

    def make_indices(self, restarts: bool) -> Any:
        indices = self.numbers.integers(0, CORNERS, CORNERS).astype("u2")
        if restarts:
            indices[self.numbers.random(CORNERS) < 0.1] = 0xFFFF
        return indices

    def change(self) -> None:
        """Change the contents of buffers and textures, each with some probability."""
        numbers = self.numbers
        for buffer, restarts in self.indices:
            if numbers.random() < 0.5:
                buffer.write(self.make_indices(restarts and bool(numbers.random() < 0.3)))
        for vertices in (self.vertices, self.streamed):
            if numbers.random() < 0.5:
                vertices.write(self.make_corners())
        rows = np.zeros(16, self.tints.dtype)
        rows["color"] = numbers.random((16, 4))
        self.tints.write(rows)
        self.texture.write(numbers.integers(0, 256, (*SIZE[::-1], 4), dtype=np.uint8))
        self.weights.write(numbers.random((3, 4), np.float32))

    def reset(self) -> None:
        """Clear the targets and the totals of both sides."""
        for total in self.totals:
            total.write(np.zeros(1, np.uint32))
        for color, depth in self.targets:
            with self.device.render_pass(color, depth, clear=(0, 0, 0, 0), clear_depth=0.5):
                pass

    def bind(self, kind: type) -> dict[str, Any]:
        """Return bindings of a program; a value for `Tinted` is bound as a range, or as it is."""
        if kind is Tinted:
            index = int(self.numbers.integers(0, 24))
            return {"tint": self.tints[index] if index < 16 else Tint(color=(index / 24, 0.5, 0.25, 1.0))}
        if kind is Weighted:
            return {"weights": self.weights}
        return {"source": self.texture} if kind is Loads else {}

    def read(self) -> list[Any]:
        """Return the images of this side, what fragments have counted, and what queries have."""
        color, depth = self.targets[self.side]
        images = [color.read(), depth.read(), self.small[self.side].read()]
        counted = [self.queries[self.side][number].wait() for number in sorted(self.used_queries)]
        return [*images, self.totals[self.side].read(), *counted]


def choose_states(scene: Scene) -> list[State]:
    """Return up to three random states."""
    numbers, (width, height) = scene.numbers, SIZE
    x, y = numbers.integers(0, 12, 2).tolist()
    states: list[State] = [
        BLENDS[numbers.integers(len(BLENDS))],
        ColorWrite(red=bool(numbers.random() < 0.5)),
        CullMode.BACK,
        DepthTest.OFF,
        DepthWrite.OFF,
        DepthFunction.GREATER,
        Scissor(x, y, 9, 7),
        Viewport(x - 2.0, y, width, height, 0.25, 0.75) if x % 2 else Viewport(0, 0, width, height, 1.0, 0.0),
        BlendColor(*numbers.random(4).tolist()),
    ]
    if scene.device.capabilities.stencil:
        passes = StencilFront(Comparison.NOT_EQUAL, both_pass=StencilOperation.REPLACE)
        states += [StencilTest.ON, passes, StencilReference(x, x)]
    return [states[index] for index in numbers.permutation(len(states))[: numbers.integers(0, 4)]]


def draw_plainly(scene: Scene, kind: type, meshes: Sequence[rhi.Mesh]) -> Draw:
    """Return one or two instances of a part of a mesh."""
    numbers = scene.numbers
    mesh = meshes[int(numbers.integers(len(meshes)))]
    step = {Primitive.TRIANGLES: 3, Primitive.QUADS: 4}.get(mesh.primitive, 1)
    first, count = (step * int(each) for each in numbers.integers(1, 20 // step + 1, 2))
    part, bindings = mesh.view(first, max(count, 4 if step == 1 else step)), scene.bind(kind)
    instances = int(numbers.integers(1, 3))

    def draw(encoder: rhi.Encoder, scene: Scene) -> None:
        own = {"total": scene.totals[scene.side]} if kind is Tally else bindings
        encoder.draw(scene.programs[kind], part, instances, **own)

    return draw


def draw_listed(scene: Scene) -> Draw:
    """Return an indirect draw of several parts."""
    mesh = scene.meshes[0]
    parts = mesh.draws(3 * scene.numbers.integers(0, 8, 4), 6)
    bindings = scene.bind(Tinted)
    return lambda encoder, scene: encoder.draw_many(scene.programs[Tinted], mesh, parts, **bindings)


def choose_draws(scene: Scene) -> list[Draw]:
    """Return a run of draws, most of them with the same program; in two of three runs of meshes that no draw has to
    convert or look at."""
    numbers = scene.numbers
    meshes = scene.meshes if numbers.random() < 0.33 else scene.plain_meshes
    common: list[type] = [Tinted, Colored, Weighted, Loads]
    draws = []
    kind = common[numbers.integers(4)]
    for _ in range(int(numbers.integers(1, 40))):
        if numbers.random() < 0.2:
            kind = common[numbers.integers(4)]
        rare = numbers.random()
        if rare < 0.03:
            draws.append(draw_listed(scene))
        else:
            draws.append(draw_plainly(scene, Tally if rare > 0.97 else kind, meshes))
    return draws


def in_query(number: int, draws: Sequence[Draw]) -> Draw:
    """Return draws inside a query."""

    def draw(encoder: rhi.Encoder, scene: Scene) -> None:
        query = scene.queries[scene.side][number]
        scene.used_queries.add(number)
        counting: Any = encoder.query(query) if isinstance(encoder, rhi.CommandBuffer) else query
        with counting:
            for each in draws:
                each(encoder, scene)

    return draw


def in_states(states: Sequence[State], draws: Sequence[Draw]) -> Draw:
    """Return draws inside a scope of states."""

    def draw(encoder: rhi.Encoder, scene: Scene) -> None:
        with encoder.states(*states):
            for each in draws:
                each(encoder, scene)

    return draw


def choose_passes(scene: Scene) -> list[tuple[int, list[Draw]]]:
    """Return passes: the number of the kind of their targets, and their draws."""
    numbers = scene.numbers
    passes, queries = [], [0, 1][: len(scene.queries[0])]
    for _ in range(int(numbers.integers(1, 4))):
        draws: list[Draw] = []
        for _ in range(int(numbers.integers(1, 6))):
            part = choose_draws(scene)
            if queries and numbers.random() < 0.2:
                part = [in_query(queries.pop(), part)]
            draws.append(in_states(choose_states(scene), part))
        passes.append((int(numbers.integers(4)), draws))
    return passes


def give(encoder: rhi.Encoder, scene: Scene, passes: Sequence[tuple[int, Sequence[Draw]]]) -> None:
    """Give the commands of passes to an encoder."""
    color, depth = scene.targets[scene.side]
    small = scene.small[scene.side]
    for number, draws in passes:
        target = (
            encoder.render_pass(color, clear=(0.5, 0, 0.25, 1)),
            encoder.render_pass(color, depth, clear=(0.1, 0.2, 0.3, 0.4), clear_depth=0.7),
            encoder.render_pass(small, clear=(0.5, 0, 0.25, 1)),
            encoder.render_pass(None, depth),
        )[number]
        with target:
            for draw in draws:
                draw(encoder, scene)


def disturb(device: Device, scene: Scene, image: Texture) -> None:
    """Draw something else, with states and bindings of its own, to another image."""
    with device.render_pass(image, clear=(0, 0, 0, 0)), device.states(*choose_states(scene)):
        for draw in choose_draws(scene):
            draw(device, scene)


@pytest.mark.parametrize("seed", range(SEEDS))
def test_random_commands_that_are_submitted_again_draw_as_directly(device: Device, seed: int) -> None:
    numbers = np.random.default_rng(seed)
    with ExitStack() as opened:
        scene = Scene(device, numbers, opened)
        other = opened.enter_context(device.texture(SIZE, Format.RGBA8))
        passes = choose_passes(scene)
        scene.side = 1
        with device.record() as commands:
            give(commands, scene, passes)
        for submission in range(SUBMISSIONS):
            if submission:
                scene.change()
            disturb(device, scene, other)
            scene.reset()
            results = []
            for scene.side in (0, 1):
                if scene.side:
                    device.submit(commands)
                else:
                    give(device, scene, passes)
                results.append(scene.read())
            for drawn, expected in zip(results[1], results[0], strict=True):
                assert_same(drawn, expected)
