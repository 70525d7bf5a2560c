"""Random programs.

- A **theme** is a few kinds of passes (formats, samples), each with a few pipelines (ink, depth function,
  whether targets blend, and so on): everything that a backend may compile. Programs of one theme differ in
  everything else. So thousands of programs need only a few pipelines for each theme.
- Corners lie on 1/16 texel, which every device's grid represents exactly, and most depths are flat multiples
  of 1/64, which interpolation keeps. So most texels have one possible value. 1/2 is left out: it lies
  half-way between two depths of 16 and 24 bits.
"""

from __future__ import annotations

from dataclasses import dataclass
from random import Random
from typing import Final

import rhi
from rhi.conformance.programs.model import (
    ClearCells,
    Color,
    Copy,
    Dispatch,
    Draw,
    DrawMethod,
    Image,
    Mipmaps,
    Part,
    Pass,
    Program,
    Read,
    RecordedPasses,
    Reshape,
    Resolve,
    ShaderKind,
    Shape,
    Step,
    Subresource,
    Write,
)
from rhi.conformance.reference import largest
from rhi.contract.formats import COLOR_FORMATS, DEPTH_FORMATS, ChannelKind

SIZES: Final = ((24, 20), (16, 16), (40, 33), (70, 45), (67, 9), (32, 16), (64, 64), (5, 3))
FORMATS: Final = tuple(f for f in COLOR_FORMATS if not f.is_packed)
"""The formats of color targets: those whose channels are numbers of their own."""
_GRID: Final = 16
_FLOAT_SHADERS: Final = (
    ShaderKind.FLAT,
    ShaderKind.FLAT,
    ShaderKind.SMOOTH,
    ShaderKind.DISCARD,
    ShaderKind.DISCARD_EARLY,
    ShaderKind.WRITTEN_DEPTH,
    ShaderKind.COUNT,
    ShaderKind.COUNT_EARLY,
    ShaderKind.LOAD,
    ShaderKind.LOAD_LAYER,
)


@dataclass(frozen=True, slots=True)
class Pipeline:
    """The states that a draw may be compiled for, beside the formats of its pass."""

    shader: ShaderKind
    blends: tuple[bool, ...]
    depth: tuple[rhi.State, ...]
    alpha_test: bool = False
    alpha_to_coverage: bool = False
    stencil: bool = False


@dataclass(frozen=True, slots=True)
class PassKind:
    """The formats of a pass, and the pipelines of its draws."""

    colors: tuple[rhi.Format, ...]
    depth: rhi.Format | None
    samples: int
    pipelines: tuple[Pipeline, ...]


@dataclass(frozen=True, slots=True)
class Theme:
    """The kinds of passes in some programs, and what they may ask for."""

    kinds: tuple[PassKind, ...]
    capabilities: rhi.Capabilities


def make_theme(seed: int, capabilities: rhi.Capabilities) -> Theme:
    """Return a random theme of what a device offers."""
    random = Random(f"theme {seed}")
    colors = [f for f in FORMATS if f not in capabilities.unrenderable_formats]
    depths = [f for f in DEPTH_FORMATS if f not in capabilities.unsupported_formats]
    samples = [1, 1, 1, *capabilities.sample_counts[1:]]
    kinds: list[PassKind] = []
    for number in range(2):
        count = random.choice(samples)
        if (
            number and kinds[0].samples == 1
        ):  # a source for the other one, or the same targets with other pipelines
            first = kinds[0]
            formats, depth, count = first.colors, random.choice([first.depth, None]), 1
            if depth is None and not formats:
                depth = first.depth
        else:
            family = random.choice(["float", "float", "float", "integer"])
            pool = [f for f in colors if f.is_integer == (family == "integer")]
            if family == "integer":
                kind = random.choice([ChannelKind.UINT, ChannelKind.INT])
                pool = [f for f in pool if f.kind is kind]
            formats = tuple(random.choice(pool) for _ in range(random.choice([1, 1, 1, 2])))
            depth = random.choice([*depths, None, None])
            if depth is not None and random.random() < 0.08:
                formats = ()
        pipelines = tuple(_make_pipeline(random, formats, depth, count, capabilities) for _ in range(2))
        kinds.append(PassKind(formats, depth, count, pipelines))
    return Theme(tuple(kinds), capabilities)


def _make_pipeline(
    random: Random,
    formats: tuple[rhi.Format, ...],
    depth: rhi.Format | None,
    samples: int,
    capabilities: rhi.Capabilities,
) -> Pipeline:
    kind = formats[0].kind if formats else ChannelKind.UNORM
    if kind in (ChannelKind.UINT, ChannelKind.INT):
        shader = ShaderKind.UINT if kind is ChannelKind.UINT else ShaderKind.INT
        blends: tuple[bool, ...] = (False,) * len(formats)
    else:
        shader = (
            ShaderKind.TWO_TARGETS
            if len(formats) == 2 and random.random() < 0.7
            else random.choice(_FLOAT_SHADERS)
        )
        blends = tuple(random.random() < 0.6 and f not in capabilities.unblendable_formats for f in formats)
    states: tuple[rhi.State, ...] = ()
    if depth is not None:
        states = (
            random.choice([*rhi.DepthFunction]),
            random.choice([rhi.DepthWrite.ON, rhi.DepthWrite.ON, rhi.DepthWrite.OFF]),
            random.choice([rhi.DepthTest.ON] * 5 + [rhi.DepthTest.OFF]),
        )
    floats = shader not in (ShaderKind.UINT, ShaderKind.INT)
    return Pipeline(
        shader,
        blends,
        states,
        alpha_test=floats and random.random() < 0.15,
        alpha_to_coverage=floats and samples > 1 and random.random() < 0.15,
        stencil=depth is not None and depth.has_stencil and random.random() < 0.7,
    )


def make_program(seed: int, theme: Theme) -> Program:
    """Return a random program of a theme."""
    return _ProgramGenerator(Random(f"program {seed}"), theme).make()


class _ProgramGenerator:
    def __init__(self, random: Random, theme: Theme) -> None:
        self._random, self._theme = random, theme
        self._images: list[Image] = []
        self._shapes: list[Shape] = []
        self._size = random.choice(SIZES)
        self._queries = random.choice([0, 2, 3])
        self._ended: set[int] = set()
        self._targets: list[
            tuple[list[list[int]], list[int]]
        ] = []  # for each kind: images of each slot, and of depth
        self._resolved: dict[int, int] = {}
        self._sources: list[int] = []
        self._float_shapes: list[int] = []
        self._integer_shapes: list[int] = []

    def make(self) -> Program:
        random = self._random
        for kind in self._theme.kinds:
            self._make_images(kind)
        formats = [f for kind in self._theme.kinds for f in kind.colors]
        if any(
            pipeline.shader not in (ShaderKind.UINT, ShaderKind.INT)
            for kind in self._theme.kinds
            for pipeline in kind.pipelines
        ):
            self._float_shapes = [self._make_shape(None) for _ in range(random.choice([2, 3]))]
        integers = [f for f in formats if f.is_integer]
        if integers:  # shared by all integer targets, so negative only if all are signed
            sign = min((f.kind for f in integers), key=lambda channel_kind: channel_kind is ChannelKind.INT)
            most = min(map(largest, integers))
            self._integer_shapes = [self._make_shape((sign, most)) for _ in range(2)]
        steps: list[Step] = [self._make_pass(clear=True)]
        for _ in range(random.choice([3, 5, 7])):
            step = self._make_step()
            if step is not None:
                steps.append(step)
        return Program(tuple(self._images), tuple(self._shapes), tuple(steps), self._queries)

    # -- resources -------------------------------------------------------------------------------------------

    def _make_images(self, kind: PassKind) -> None:
        slots: list[list[int]] = []
        for number, format in enumerate(kind.colors):
            shared = [
                i
                for i, image in enumerate(self._images)
                if image.format is format
                and image.samples == kind.samples
                and not any(i in slot for slot in slots)
            ]
            numbers = shared[:1] if shared and self._random.random() < 0.7 else []
            while len(numbers) < 2 - (number > 0):
                numbers.append(self._add_image(format, kind.samples))
            slots.append(numbers)
        depths = [] if kind.depth is None else [self._add_image(kind.depth, kind.samples) for _ in range(2)]
        self._targets.append((slots, depths))

    def _add_image(self, format: rhi.Format, samples: int) -> int:
        random, (width, height) = self._random, self._size
        number = len(self._images)
        if samples > 1:
            self._images.append(Image(self._size, format, samples=samples))
            if not (format.is_depth or format.is_integer):
                self._resolved[number] = len(self._images)
                self._images.append(Image(self._size, format))
                self._sources.append(number + 1)
            return number
        kinds = [rhi.TextureKind.D2] * 3 + [rhi.TextureKind.D2_ARRAY]
        if width == height:
            kinds += [rhi.TextureKind.CUBE] * 2
        if not format.is_depth:
            kinds.append(rhi.TextureKind.D3)
        kind = random.choice(kinds)
        layers = {rhi.TextureKind.D2: 1, rhi.TextureKind.CUBE: 6}.get(kind, random.choice([2, 4]))
        levels = random.choice([1, 3]) if width % 16 == 0 == height % 16 else 1
        if kind is rhi.TextureKind.D3 and levels > 1:
            layers = 4
        self._images.append(Image(self._size, format, kind, layers, levels))
        if not format.is_integer and kind in (rhi.TextureKind.D2, rhi.TextureKind.D2_ARRAY):
            self._sources.append(number)
        return number

    def _make_shape(self, integers: tuple[ChannelKind, int] | None) -> int:
        """Add a shape; `integers` are the kind and the largest number of its colors."""
        random, (width, height) = self._random, self._size
        primitive = random.choice(
            [rhi.Primitive.TRIANGLES] * 4
            + [
                rhi.Primitive.QUADS,
                rhi.Primitive.TRIANGLE_STRIP,
                rhi.Primitive.TRIANGLE_FAN,
                rhi.Primitive.POINTS,
            ]
        )
        corners: list[tuple[float, ...]] = []

        def add(points: list[tuple[float, float]], slope: float = 0.0, perspective: bool = False) -> None:
            depth = self._depth()
            w = random.choice([1.0, 1.0, 0.5, 2.0])
            color = self._color(integers)
            smooth = random.random() < 0.5
            for x, y in points:
                weight = random.choice([0.5, 1.0, 2.0, 4.0]) if perspective else w
                z = min(max(depth + slope * x / width, 0.0), 1.0)
                corners.append((x, y, z, weight, *(self._color(integers) if smooth else color)))

        for _ in range(random.choice([1, 3, 6])):
            slope = random.choice([0.0, 0.0, 0.0, 0.25, -0.5])
            perspective = random.random() < 0.1
            if primitive is rhi.Primitive.POINTS:
                add([(random.randrange(width) + 0.5, random.randrange(height) + 0.5)])
            elif primitive is rhi.Primitive.QUADS:
                add(self._rectangle(), slope)
            elif primitive is rhi.Primitive.TRIANGLES and random.random() < 0.5:
                a, b, c, d = self._rectangle()
                add([a, b, c, a, c, d], slope)
            else:
                add([self._point() for _ in range(3)], slope, perspective)
        indices = None
        if random.random() < 0.4:
            count = len(corners) + random.choice([0, 3])
            per = {rhi.Primitive.TRIANGLES: 3, rhi.Primitive.QUADS: 4}.get(primitive, 1)
            starts = [per * random.randrange(len(corners) // per) for _ in range(max(1, count // per))]
            listed = [start + i for start in starts for i in range(per)]
            if primitive in (rhi.Primitive.TRIANGLE_STRIP, rhi.Primitive.TRIANGLE_FAN):
                listed = [random.randrange(len(corners)) for _ in range(count)]
            indices = tuple(listed)
        self._shapes.append(Shape(primitive, tuple(corners), indices))
        return len(self._shapes) - 1

    def _point(self) -> tuple[float, float]:
        random, (width, height) = self._random, self._size
        beyond = random.random() < 0.06
        low, high = (-0.5, 1.5) if beyond else (0.0, 1.0)
        return tuple(round(random.uniform(low, high) * extent * _GRID) / _GRID for extent in (width, height))  # type: ignore[return-value]

    def _rectangle(self) -> list[tuple[float, float]]:
        random, (width, height) = self._random, self._size
        if random.random() < 0.25:
            left, top, right, bottom = 0.0, 0.0, float(width), float(height)
        else:
            (left, top), (right, bottom) = self._point(), self._point()
        around = [(left, top), (left, bottom), (right, bottom), (right, top)]
        return around if random.random() < 0.7 else around[::-1]

    def _depth(self) -> float:
        return self._random.choice([k for k in range(1, 64) if k != 32]) / 64

    def _color(self, integers: tuple[ChannelKind, int] | None) -> Color:
        random = self._random
        if integers is not None:
            kind, most = integers
            top = random.choice([255, min(most, 1 << 24)])
            low = -top if kind is ChannelKind.INT else 0
            return tuple(float(random.randint(low, min(top, most))) for _ in range(4))  # type: ignore[return-value]
        pick = random.choice(["unit", "unit", "eighths", "bytes", "any"])

        def channel() -> float:
            match pick:
                case "unit":
                    return random.choice([0.0, 1.0, 0.5, 0.25])
                case "eighths":
                    return random.randint(-8, 16) / 8
                case "any":
                    return round(random.uniform(-0.5, 1.5), 3)
                case _:
                    return random.randint(0, 255) / 255

        return channel(), channel(), channel(), channel()

    # -- steps -----------------------------------------------------------------------------------------------

    def _make_step(self) -> Step | None:
        random = self._random
        choice = random.random()
        if choice < 0.55:
            return self._make_pass()
        if choice < 0.65:
            passes = tuple(self._make_pass(recorded=True) for _ in range(random.choice([1, 2])))
            return RecordedPasses(passes, random.choice([1, 1, 2]))
        make = random.choice(
            [
                self._make_copy,
                self._make_copy,
                self._make_write,
                self._make_mipmaps,
                self._make_resolve,
                self._make_read,
                self._make_reshape,
                self._make_clear,
                self._make_dispatch,
            ]
        )
        return make()

    def _choose_subresource(self, image: int, size: tuple[int, int] | None = None) -> Subresource | None:
        """Return a random level and layer of an image, of the given size."""
        shape = self._images[image]
        levels = [i for i in range(shape.levels) if size is None or shape.level_size(i) == size]
        if not levels:
            return None
        level = self._random.choice(levels)
        return Subresource(image, level, self._random.randrange(shape.level_layers(level)))

    def _make_pass(self, clear: bool = False, recorded: bool = False) -> Pass:
        random = self._random
        number = random.randrange(len(self._theme.kinds))
        kind, (slots, depths) = self._theme.kinds[number], self._targets[number]
        used = [random.choice(slot) for slot in slots]
        depth_image = random.choice(depths) if depths else None
        images = used + ([depth_image] if depth_image is not None else [])
        level = random.choice([0, 0, min(self._images[i].levels for i in images) - 1])
        size = self._images[images[0]].level_size(level)
        colors = []
        for image in used:
            subresource = self._choose_subresource(image, size)
            assert subresource is not None
            colors.append(subresource)
        depth = self._choose_subresource(depth_image, size) if depth_image is not None else None
        clears = tuple(self._clear_color(f) if clear or random.random() < 0.25 else None for f in kind.colors)
        taken = {subresource.image for subresource in colors} | ({depth.image} if depth else set())
        draws = tuple(
            draw
            for _ in range(random.choice([1, 2, 4]))
            if (draw := self._make_draw(kind, size, taken, recorded)) is not None
        )
        resolve: tuple[int | None, ...] = ()
        if kind.samples > 1 and random.random() < 0.5:
            resolve = tuple(self._resolved.get(image) for image in used)
        return Pass(
            tuple(colors),
            depth,
            draws,
            clears,
            random.choice([0.0, 1.0, 0.25, self._depth()])
            if depth and (clear or random.random() < 0.25)
            else None,
            random.randrange(256)
            if depth and kind.depth and kind.depth.has_stencil and (clear or random.random() < 0.25)
            else None,
            resolve,
        )

    def _clear_color(self, format: rhi.Format) -> Color:
        if format.is_integer:
            return self._color((format.kind, min(largest(format), 1 << 24)))
        return self._color(None)

    def _make_draw(
        self, kind: PassKind, size: tuple[int, int], taken: set[int], recorded: bool
    ) -> Draw | None:
        random = self._random
        pipeline = random.choice(kind.pipelines)
        floats = pipeline.shader not in (ShaderKind.UINT, ShaderKind.INT)
        number = random.choice(self._float_shapes if floats else self._integer_shapes)
        shape = self._shapes[number]
        source = None
        if pipeline.shader in (ShaderKind.LOAD, ShaderKind.LOAD_LAYER):
            texture_kind = (
                rhi.TextureKind.D2 if pipeline.shader is ShaderKind.LOAD else rhi.TextureKind.D2_ARRAY
            )
            possible = [
                subresource
                for i in self._sources
                if i not in taken and self._images[i].kind is texture_kind
                if (subresource := self._choose_subresource(i, size)) is not None
            ]
            if not possible:
                return None
            source = random.choice(possible)
        method = random.choice(
            [DrawMethod.DIRECT, DrawMethod.DIRECT, DrawMethod.MANY, DrawMethod.INDIRECT, DrawMethod.COUNTED]
        )
        query = condition = None
        if self._queries:
            if random.random() < 0.25 and self._ended and self._theme.capabilities.conditional_rendering:
                condition = (random.choice(sorted(self._ended)), random.random() < 0.5)
            if random.random() < 0.3 and method is not DrawMethod.COUNTED and not recorded:
                query = random.randrange(self._queries)
                if condition is not None and condition[0] == query:
                    query = None
                else:
                    self._ended.add(query)
        if shape.primitive is rhi.Primitive.QUADS and method in (DrawMethod.MANY, DrawMethod.INDIRECT):
            method = DrawMethod.DIRECT
        if method is DrawMethod.COUNTED and recorded:
            method = DrawMethod.DIRECT
        states, view = self._make_states(kind, pipeline, size)
        frame = size
        if view is not None and random.random() < 0.5 and view[0] and view[1]:
            frame = view
        step = (0.0, 0.0)
        if random.random() < 0.4:
            step = (2 * random.randint(-3, 3) / frame[0], 2 * random.randint(-3, 3) / frame[1])
        return Draw(
            pipeline.shader,
            number,
            self._make_parts(shape, method),
            frame,
            states,
            step,
            method,
            query,
            condition,
            source,
        )

    def _make_parts(self, shape: Shape, method: DrawMethod) -> tuple[Part, ...]:
        random = self._random
        per = {rhi.Primitive.TRIANGLES: 3, rhi.Primitive.QUADS: 4}.get(shape.primitive, 1)
        parts = []
        for _ in range(
            1 if method is DrawMethod.DIRECT and random.random() < 0.8 else random.choice([1, 2, 3])
        ):
            first, end = 0, shape.elements
            if random.random() < 0.4:
                bounds = range(0, shape.elements + 1, per)
                first, end = sorted(random.choice(bounds) for _ in range(2))
            base = random.choice([0, 0, 1])
            parts.append(Part(first, end - first, random.choice([1, 1, 1, 2, 3, 0]), base))
        return tuple(parts)

    def _make_states(
        self, kind: PassKind, pipeline: Pipeline, size: tuple[int, int]
    ) -> tuple[tuple[rhi.State, ...], tuple[int, int] | None]:
        random = self._random
        states: list[rhi.State] = list(pipeline.depth)
        states.append(random.choice([rhi.CullMode.NONE] * 4 + [rhi.CullMode.BACK, rhi.CullMode.FRONT]))
        if random.random() < 0.3:
            states.append(rhi.FrontFace.CLOCKWISE)
        blended = False
        for target, blends in enumerate(pipeline.blends):
            if blends:
                states.append(self._make_blending().at(target))
                blended = True
            if target >= (2 if pipeline.shader is ShaderKind.TWO_TARGETS else 1):
                states.append(rhi.ColorWrite.OFF.at(target))
            elif random.random() < 0.2:
                flags = [random.random() < 0.6 for _ in range(4)]
                flags[0] |= kind.colors[target].channels == 1 or not any(flags)
                states.append(rhi.ColorWrite(*flags).at(target))
        if blended:
            states.append(rhi.BlendColor(*self._color(None)))
        if pipeline.alpha_test:
            states += [rhi.AlphaTest.ON, random.choice([*rhi.AlphaFunction])]
            states.append(rhi.AlphaReference(random.choice([0.0, 0.25, 0.5, 1.0, 0.3])))
        if pipeline.alpha_to_coverage:
            states.append(rhi.AlphaToCoverage.ON)
        if pipeline.stencil:
            states.append(rhi.StencilTest.ON)
            states += self._make_stencil()
        if kind.depth is not None and random.random() < 0.1:
            states.append(rhi.DepthBias(random.choice([1.0, -2.0, 16.0])))
        if kind.depth is not None and random.random() < 0.1:
            states.append(rhi.PolygonOffset(random.choice([0.5, -1.0, 2.0]), random.choice([0.0, 0.0, 0.01])))
        if random.random() < 0.25:
            x, y = (random.randint(-4, extent) for extent in size)
            states.append(rhi.Scissor(x, y, random.randint(0, size[0]), random.randint(0, size[1])))
        view = None
        if random.random() < 0.2:
            view = random.randint(1, size[0]), random.randint(1, size[1])
            part = random.choice([0.0, 0.0, 0.5, 0.25]) if kind.samples == 1 else 0.0
            near, far = random.choice([(0.0, 1.0), (0.0, 1.0), (1.0, 0.0), (0.25, 0.75)])
            left, top = (random.randint(-2, extent // 2) + part for extent in size)
            states.append(rhi.Viewport(left, top, view[0], view[1], near, far))
        return tuple(states), view

    def _make_blending(self) -> rhi.BlendFunction:
        random = self._random
        if random.random() < 0.2:
            named = [
                rhi.BlendFunction.ALPHA,
                rhi.BlendFunction.ADDITIVE,
                rhi.BlendFunction.PREMULTIPLIED,
                rhi.BlendFunction.MULTIPLY,
            ]
            return random.choice(named)
        while True:
            function = rhi.BlendFunction(
                random.choice([*rhi.BlendFactor]),
                random.choice([*rhi.BlendFactor]),
                random.choice([*rhi.BlendOperation]),
                random.choice([None, *rhi.BlendFactor]),
                random.choice([None, *rhi.BlendFactor]),
                random.choice([None, *rhi.BlendOperation]),
            )
            if not function.is_off:
                return function

    def _make_stencil(self) -> list[rhi.State]:
        random = self._random
        operations = [*rhi.StencilOperation]
        states: list[rhi.State] = []
        for side in (rhi.StencilFront, rhi.StencilBack):
            if random.random() < 0.8:
                function = random.choice([*rhi.Comparison, rhi.Comparison.ALWAYS, rhi.Comparison.ALWAYS])
                states.append(side(function, *(random.choice(operations) for _ in range(3))))
        for kind, usual in (
            (rhi.StencilReference, 1),
            (rhi.StencilReadMask, 255),
            (rhi.StencilWriteMask, 255),
        ):
            if random.random() < 0.6:
                front, back = (random.choice([usual, random.randrange(256)]) for _ in range(2))
                states.append(kind(front, back if self._theme.capabilities.stencil_per_face else front))
        return states

    def _make_copy(self) -> Step | None:
        random = self._random
        single = [i for i, image in enumerate(self._images) if image.samples == 1]
        if not single:
            return None
        source = random.choice(single)
        format = self._images[source].format
        target = random.choice([i for i in single if self._images[i].format is format])
        from_, to = self._choose_subresource(source), self._choose_subresource(target)
        assert from_ is not None
        assert to is not None
        from_size = self._images[source].level_size(from_.level)
        to_size = self._images[target].level_size(to.level)
        width = random.randint(1, min(from_size[0], to_size[0]))
        height = random.randint(1, min(from_size[1], to_size[1]))
        if random.random() < 0.4:
            width, height = min(from_size[0], to_size[0]), min(from_size[1], to_size[1])
        x, y = random.randint(0, from_size[0] - width), random.randint(0, from_size[1] - height)
        to_x, to_y = random.randint(0, to_size[0] - width), random.randint(0, to_size[1] - height)
        if source == target and from_.level == to.level and from_.layer == to.layer:
            return None
        return Copy(Subresource(source, from_.level), (x, y, width, height, from_.layer, 1), to, to_x, to_y)

    def _make_write(self) -> Step | None:
        random = self._random
        single = [
            i for i, image in enumerate(self._images) if image.samples == 1 and not image.format.is_depth
        ]
        if not single:
            return None
        subresource = self._choose_subresource(random.choice(single))
        assert subresource is not None
        wide, high = self._images[subresource.image].level_size(subresource.level)
        width, height = random.randint(1, wide), random.randint(1, high)
        x, y = random.randint(0, wide - width), random.randint(0, high - height)
        return Write(subresource, x, y, width, height, random.randrange(1 << 16))

    def _make_mipmaps(self) -> Step | None:
        able = [
            i
            for i, image in enumerate(self._images)
            if image.levels > 1 and not (image.format.is_integer or image.format.is_depth)
        ]
        return Mipmaps(self._random.choice(able)) if able else None

    def _make_resolve(self) -> Step | None:
        if not self._resolved:
            return None
        source = self._random.choice(sorted(self._resolved))
        return Resolve(source, self._resolved[source])

    def _make_read(self) -> Step | None:
        single = [i for i, image in enumerate(self._images) if image.samples == 1]
        subresource = self._choose_subresource(self._random.choice(single)) if single else None
        return Read(subresource) if subresource is not None else None

    def _make_reshape(self) -> Step | None:
        shapes = self._random.choice([self._float_shapes, self._integer_shapes])
        if len(shapes) < 2:
            return None
        shape, source = self._random.sample(shapes, 2)
        return Reshape(shape, source)

    def _make_clear(self) -> Step:
        return ClearCells(self._random.choice([0, 7]))

    def _make_dispatch(self) -> Step | None:
        flat = [
            i
            for i in self._sources
            if self._images[i].kind is rhi.TextureKind.D2 and not self._images[i].format.is_depth
        ]
        return Dispatch(Subresource(self._random.choice(flat))) if flat else None
