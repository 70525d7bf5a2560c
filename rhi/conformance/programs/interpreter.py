"""An interpreter of programs in float64 and exact integers: it tells what a program may leave on a device.

- A value is an **interval**: the smallest and the largest number that a device may store there. Intervals
  have a width where the interface leaves a choice (which way a conversion rounds, the last bits of an
  interpolated depth) and nowhere else. Everything that follows from such a choice is computed for both ends,
  so a difference is never forgiven by a tolerance on the whole result.
- A fragment that may or may not pass (its depth interval touches the stored one) leaves the union of both
  outcomes.
- Coverage is computed in integers on the grid of 1/256 texel to which window positions are rounded.
- `Tolerances` holds the choices that differ between devices, and the known faults of a driver: each names
  what it makes unknown, so that the rest of a program is still examined.

Nothing here is fast: arrays are those of one primitive's bounding box, (rows, columns, samples).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

import rhi
from rhi.conformance import reference
from rhi.conformance.programs import model
from rhi.conformance.programs.coverage import (
    CoveredPrimitive,
    clip_corners,
    compute_coverage,
    list_primitives,
)
from rhi.conformance.programs.intervals import Float, Interval, MaskBounds, compare
from rhi.conformance.programs.merging import blend, decode, encode, quantise_depth, read_depth
from rhi.conformance.programs.tolerances import EXACT, Effect, Tolerances
from rhi.contract.formats import ChannelKind
from rhi.contract.states import DEFAULTS, MAX_TARGETS, PER_TARGET

_INTEGER_SHADERS: Final = (model.ShaderKind.UINT, model.ShaderKind.INT)
_EARLY: Final = (model.ShaderKind.DISCARD_EARLY, model.ShaderKind.COUNT_EARLY)


@dataclass(slots=True)
class _Level:
    """A level of an image: stored numbers (layers, rows, columns, samples, channels); stencil has no
    channels."""

    low: Float
    high: Float
    stencil_low: Float
    stencil_high: Float


@dataclass(slots=True)
class Result:
    """The values that a read, a count or a buffer may have."""

    name: str
    low: Float
    high: Float


def interpret(program: model.Program, tolerances: Tolerances = EXACT) -> list[Result]:
    """Bounds of each result of `runner.run`, in its order."""
    machine = _Machine(program, tolerances)
    for step in program.steps:
        machine.execute(step)
    return machine.finish()


@dataclass(slots=True)
class _Context:
    """A draw's states, and the pass it is in."""

    program: model.Program
    render_pass: model.Pass
    draw: model.Draw
    states: Mapping[type, Any]
    size: tuple[int, int]
    samples: int
    effects: Effect
    color_faults: tuple[bool, ...]


class _Machine:
    def __init__(self, program: model.Program, tolerances: Tolerances) -> None:
        self._program, self._rules = program, tolerances
        self._levels: dict[tuple[int, int], _Level] = {}
        for number, image in enumerate(program.images):
            for level in range(image.levels):
                width, height = image.level_size(level)
                subresource = (image.level_layers(level), height, width, image.samples)
                colors = (*subresource, image.format.channels)
                self._levels[number, level] = _Level(
                    np.zeros(colors), np.zeros(colors), np.zeros(subresource), np.zeros(subresource)
                )
        self._shapes = list(program.shapes)
        self._counts = np.zeros((program.queries, 2))
        self._sets: list[Result] = []
        self._cells = {name: np.zeros((2, model.CELLS)) for name in ("counts", "reds")}
        self._results: list[Result] = []

    # -- steps -----------------------------------------------------------------------------------------------

    def execute(self, step: model.Step) -> None:
        match step:
            case model.Pass():
                self._pass(step)
            case model.RecordedPasses():
                for _ in range(step.times):
                    for part in step.passes:
                        self._pass(part)
            case model.Copy():
                self._copy(step)
            case model.Write():
                self._write(step)
            case model.Mipmaps():
                self._mipmaps(step.image)
            case model.Resolve():
                self._resolve(step.source, step.target)
            case model.Read():
                self._results.append(self._view(f"read of {step.subresource}", step.subresource))
            case model.Reshape():
                self._reshape(step)
            case model.ClearCells():
                for cells in self._cells.values():
                    cells[:] = step.value
            case model.Dispatch():
                self._dispatch(step)

    def finish(self) -> list[Result]:
        results = self._results
        results += self._sets
        results.append(Result("queries", self._counts[:, 0], self._counts[:, 1]))
        results += [Result(name, cells[0], cells[1]) for name, cells in self._cells.items()]
        for number, image in enumerate(self._program.images):
            if image.samples > 1:
                if not (image.format.is_depth or image.format.is_integer):
                    mean = self._mean(number)
                    results.append(Result(f"image {number}, resolved", mean.low, mean.high))
                continue
            for level in range(image.levels):
                for layer in range(image.level_layers(level)):
                    subresource = model.Subresource(number, level, layer)
                    results.append(self._view(f"image {number}, level {level}, layer {layer}", subresource))
                    if image.format.has_stencil:
                        stored = self._levels[number, level]
                        results.append(
                            Result(
                                f"stencil of image {number}, level {level}, layer {layer}",
                                stored.stencil_low[layer, :, :, 0],
                                stored.stencil_high[layer, :, :, 0],
                            )
                        )
        return results

    def _view(self, name: str, subresource: model.Subresource) -> Result:
        stored = self._levels[subresource.image, subresource.level]
        part = Interval(
            stored.low[subresource.layer, :, :, 0].copy(), stored.high[subresource.layer, :, :, 0].copy()
        )
        format = self._program.images[subresource.image].format
        if format.is_depth:
            part = read_depth(format, part)
            part = Interval(part.low.astype(np.float32), part.high.astype(np.float32)).widen(6e-8)
        return Result(name, part.low, part.high)

    def _copy(self, step: model.Copy) -> None:
        source = self._levels[step.source.image, step.source.level]
        target = self._levels[step.target.image, step.target.level]
        x, y, width, height, layer, layers = step.box
        here = (slice(layer, layer + layers), slice(y, y + height), slice(x, x + width))
        to = step.target.layer
        there = (slice(to, to + layers), slice(step.y, step.y + height), slice(step.x, step.x + width))
        for name in ("low", "high", "stencil_low", "stencil_high"):
            getattr(target, name)[there] = getattr(source, name)[here].copy()

    def _write(self, step: model.Write) -> None:
        stored = self._levels[step.target.image, step.target.level]
        texels = random_texels(self._program.images[step.target.image].format, step)
        rows, columns = slice(step.y, step.y + step.height), slice(step.x, step.x + step.width)
        stored.low[step.target.layer, rows, columns, 0] = texels
        stored.high[step.target.layer, rows, columns, 0] = texels

    def _mean(self, image: int) -> Interval:
        """Return the resolved texels, (rows, columns, channels)."""
        format = self._program.images[image].format
        stored = self._levels[image, 0]
        value = decode(format, Interval(stored.low[0], stored.high[0]), self._rules)
        mean = Interval(value.low.mean(axis=2), value.high.mean(axis=2))
        with np.errstate(all="ignore"):
            same = (value.low == value.high).all(axis=2) & (value.low == value.low[:, :, :1]).all(axis=2)
            error = np.where(
                same | ~np.isfinite(value.size).all(axis=2), 0.0, 2.0**-22 * value.size.max(axis=2)
            )
        return encode(format, mean.widen(error), self._rules)

    def _resolve(self, source: int, target: int) -> None:
        mean, stored = self._mean(source), self._levels[target, 0]
        stored.low[0, :, :, 0], stored.high[0, :, :, 0] = mean.low, mean.high

    def _mipmaps(self, number: int) -> None:
        image = self._program.images[number]
        for level in range(1, image.levels):
            above, below = self._levels[number, level - 1], self._levels[number, level]
            value = decode(image.format, Interval(above.low, above.high), self._rules)
            mean = Interval(*(_box(end, below.low.shape[:3]) for end in (value.low, value.high)))
            size = _box(np.where(np.isfinite(value.size), value.size, 0.0), below.low.shape[:3])
            error = 2.0**-21 * size  # of what is added: the mean may be near 0
            stored = encode(image.format, mean.widen(error), self._rules)
            if image.format.kind is not ChannelKind.FLOAT:
                most = reference.largest(image.format)
                least = -most if image.format.kind is ChannelKind.SNORM else 0
                stored = stored.widen(self._rules.mip_steps).clip(least, most)
            below.low[:], below.high[:] = stored.low, stored.high

    def _reshape(self, step: model.Reshape) -> None:
        shape, source = self._shapes[step.shape], self._shapes[step.source]
        count = min(len(shape.corners), len(source.corners))
        corners = source.corners[:count] + shape.corners[count:]
        self._shapes[step.shape] = model.Shape(shape.primitive, corners, shape.indices)

    def _dispatch(self, step: model.Dispatch) -> None:
        image, stored = self._program.images[step.source.image], self._levels[step.source.image, 0]
        value = decode(image.format, Interval(stored.low[0, :, :, 0], stored.high[0, :, :, 0]), self._rules)
        value = value[..., 0].clip(0.0, 4.0)
        for column in range(value.low.shape[1]):
            self._cells["counts"][0, column % model.CELLS] += np.floor(value.low[:, column] * 8.0).sum()
            self._cells["counts"][1, column % model.CELLS] += np.floor(value.high[:, column] * 8.0).sum()

    # -- passes ----------------------------------------------------------------------------------------------

    def _pass(self, step: model.Pass) -> None:
        images = self._program.images
        first = step.colors[0] if step.colors else step.depth
        assert first is not None
        for subresource, color in zip(step.colors, step.clear, strict=False):
            if color is not None:
                stored = self._levels[subresource.image, subresource.level]
                form = images[subresource.image].format
                clear_value = Interval.of(np.array(color, np.float32).astype(np.float64))
                fresh = encode(form, clear_value, self._rules)
                stored.low[subresource.layer], stored.high[subresource.layer] = fresh.low, fresh.high
        if step.depth is not None:
            stored = self._levels[step.depth.image, step.depth.level]
            if step.clear_depth is not None:
                depth = quantise_depth(
                    images[step.depth.image].format, Interval.of(step.clear_depth), self._rules
                )
                stored.low[step.depth.layer], stored.high[step.depth.layer] = depth.low, depth.high
            if step.clear_stencil is not None:
                stored.stencil_low[step.depth.layer] = stored.stencil_high[step.depth.layer] = (
                    step.clear_stencil
                )
        size = images[first.image].level_size(first.level)
        for draw in step.draws:
            self._draw(step, draw, size, images[first.image].samples)
        for subresource, target in zip(step.colors, step.resolve, strict=False):
            if target is not None:
                self._resolve(subresource.image, target)

    def _draw(self, step: model.Pass, draw: model.Draw, size: tuple[int, int], samples: int) -> None:
        faults = [fault for fault in self._rules.faults if not fault.effect & Effect.COLOR]
        effects = Effect(0)
        for fault in faults:
            if fault.meets(self._program, step, draw, 0):
                effects |= fault.effect
        color_faults = tuple(
            any(
                fault.effect & Effect.COLOR and fault.meets(self._program, step, draw, target)
                for fault in self._rules.faults
            )
            for target in range(len(step.colors))
        )
        context = _Context(
            self._program, step, draw, merge_states(draw), size, samples, effects, color_faults
        )
        runs = np.ones(2, bool)  # must, may
        if draw.condition is not None:
            number, inverted = draw.condition
            low, high = self._counts[number]
            runs[:] = (low > 0, high > 0) if not inverted else (high == 0, low == 0)
        clip, colors = clip_corners(self._shapes[draw.shape], draw.frame)
        shape = self._shapes[draw.shape]
        if draw.query is not None:
            self._counts[draw.query] = 0
        counted = []
        for part in draw.parts:
            total = np.zeros(2)
            if runs[1]:
                for corners, instance in list_primitives(shape, part):
                    total += self._primitive(context, clip, colors, corners, instance, bool(runs[0]))
            counted.append(total)
            if draw.query is not None:
                self._counts[draw.query] += total
        if draw.method.name == "COUNTED":
            both = np.array(counted)
            self._sets.append(Result(f"query set {len(self._sets)}", both[:, 0], both[:, 1]))

    def _primitive(
        self,
        context: _Context,
        clip: NDArray[np.float32],
        colors: NDArray[np.float32],
        corners: tuple[int, ...],
        instance: int,
        runs: bool,
    ) -> Float:
        """Draw one primitive; return the least and the largest number of samples that pass."""
        moved = clip[list(corners)].copy()
        step = np.array(context.draw.step, np.float32) * np.float32(instance)
        moved[:, :2] += step * moved[:, 3:]
        vertex_colors = colors[list(corners)].astype(np.float64)
        covered = compute_coverage(
            context.states,
            context.size,
            context.samples,
            moved,
            vertex_colors,
            self._rules,
            smooth=context.draw.shader is model.ShaderKind.SMOOTH,
            spills=bool(context.effects & Effect.SPILL),
        )
        if covered is None:
            return np.zeros(2)
        if not runs or context.effects & Effect.COVERAGE:
            covered.coverage_mask.must[:] = False
        return self._merge(context, covered)

    def _merge(self, context: _Context, covered: CoveredPrimitive) -> Float:
        draw, states, step = context.draw, context.states, context.render_pass
        images, shader = self._program.images, draw.shader
        rows, columns = covered.rows, covered.columns
        # -- the fragment stage
        color = covered.color
        if draw.source is not None and shader in (model.ShaderKind.LOAD, model.ShaderKind.LOAD_LAYER):
            color = self._load(color, draw.source, rows, columns)
        outputs = [color]
        if shader is model.ShaderKind.TWO_TARGETS:
            outputs.append(Interval(color.low[..., ::-1], color.high[..., ::-1]))
        full = covered.coverage_mask
        undiscarded = MaskBounds(np.ones(full.must.shape[:2], bool), np.ones(full.must.shape[:2], bool))
        if shader in (model.ShaderKind.DISCARD, model.ShaderKind.DISCARD_EARLY):
            y, x = np.mgrid[rows, columns]
            holes = (x + y) % 2 == 0
            undiscarded = undiscarded & MaskBounds(~holes, ~holes)
        floats = shader not in _INTEGER_SHADERS
        if floats and states[rhi.AlphaTest] is rhi.AlphaTest.ON:
            alpha = Interval.of(np.float64(np.float32(states[rhi.AlphaReference].value)))
            undiscarded = undiscarded & compare(states[rhi.AlphaFunction], color[..., 3], alpha)
        visible = MaskBounds(undiscarded.must[..., None] & full.must, undiscarded.may[..., None] & full.may)
        if floats and context.samples > 1 and states[rhi.AlphaToCoverage] is rhi.AlphaToCoverage.ON:
            is_all_drawn, is_some_drawn = color.low[..., 3] >= 1.0, color.high[..., 3] > 0.0
            visible = MaskBounds(
                visible.must & is_all_drawn[..., None], visible.may & is_some_drawn[..., None]
            )
        # -- tests
        early = shader in _EARLY
        passed = self._test(context, covered, full if early else visible)
        written = passed
        if early:
            written = passed & visible
        if shader in (model.ShaderKind.COUNT, model.ShaderKind.COUNT_EARLY):
            ran = passed if early else full
            texels = MaskBounds(np.asarray(ran.must.any(axis=2)), np.asarray(ran.may.any(axis=2)))
            self._count(color, texels, columns)
            if context.effects & Effect.RERUN and covered.is_polygon:
                self._cells["counts"][1, np.arange(columns.start, columns.stop) % model.CELLS] = np.inf
            if context.effects & Effect.SPILL:  # beside the target, whose fragments have effects
                self._cells["counts"][1] += 1
                self._cells["counts"][1, 0] += rows.stop - rows.start
                most = np.floor(color.high[..., 0] * 16).max(initial=0)
                self._cells["reds"][1] = np.maximum(self._cells["reds"][1], most)
        # -- targets
        unknown = Interval(np.full(color.low.shape, -np.inf), np.full(color.low.shape, np.inf))
        outputs += [unknown] * (
            len(step.colors) - len(outputs)
        )  # a target without an output may become anything
        for number, subresource in enumerate(step.colors):
            self._merge_color(
                context,
                covered,
                number,
                subresource,
                images[subresource.image].format,
                outputs[number],
                written,
            )
        must = 0 if context.effects & (Effect.COUNT | Effect.COVERAGE) else int(passed.must.sum())
        may = float(passed.may.sum())
        if context.effects & Effect.COUNT:
            may = np.inf
        return np.array([must, may])

    def _load(self, color: Interval, source: model.Subresource, rows: slice, columns: slice) -> Interval:
        stored = self._levels[source.image, source.level]
        part = Interval(
            stored.low[source.layer, rows, columns, 0], stored.high[source.layer, rows, columns, 0]
        )
        format = self._program.images[source.image].format
        if format.is_depth:
            value = read_depth(format, part)
            texel = decode(rhi.Format.R32F, value.widen(6e-8), self._rules)
        else:
            texel = decode(format, part, self._rules)
        total = color + texel
        with np.errstate(all="ignore"):
            error = 2.0**-22 * np.maximum(color.size, texel.size)
        return total.widen(np.where(np.isfinite(error), error, 0.0))

    def _count(self, color: Interval, ran: MaskBounds, columns: slice) -> None:
        reds = [np.floor(np.maximum(end[..., 0], 0.0) * 16.0) for end in (color.low, color.high)]
        counts, most = self._cells["counts"], self._cells["reds"]
        for subresource, column in enumerate(range(columns.start, columns.stop)):
            cell = column % model.CELLS
            counts[0, cell] += ran.must[:, subresource].sum()
            counts[1, cell] += ran.may[:, subresource].sum()
            for end, mask in enumerate((ran.must, ran.may)):
                values = reds[end][:, subresource][mask[:, subresource]]
                most[end, cell] = max(most[end, cell], values.max(initial=0.0))

    def _test(self, context: _Context, covered: CoveredPrimitive, covers: MaskBounds) -> MaskBounds:
        """Test stencil and depth, and write both; return what passes."""
        states, subresource = context.states, context.render_pass.depth
        if subresource is None:
            return covers
        format = self._program.images[subresource.image].format
        stored = self._levels[subresource.image, subresource.level]
        here = (subresource.layer, covered.rows, covered.columns)
        old = Interval(stored.low[here][..., 0], stored.high[here][..., 0])
        always = MaskBounds(np.ones(old.low.shape, bool), np.ones(old.low.shape, bool))
        z = covered.depth
        if context.draw.shader is model.ShaderKind.WRITTEN_DEPTH:
            alpha = covered.color[..., 3:]
            z = Interval(*(np.broadcast_to(end, old.low.shape) for end in (alpha.low, alpha.high)))
        else:
            z = self._bias(context, covered, format)
        new = quantise_depth(format, z, self._rules)
        if context.effects & Effect.DEPTH:
            new = Interval(np.zeros(new.low.shape), np.full(new.high.shape, float(format.depth_steps or 1)))
        near = always
        if states[rhi.DepthTest] is rhi.DepthTest.ON:
            near = compare(states[rhi.DepthFunction], new, old)
        equal = always
        if format.has_stencil and states[rhi.StencilTest] is rhi.StencilTest.ON:
            equal = self._stencil(context, covered, stored, here, covers, near)
        passed = covers & equal & near
        if states[rhi.DepthWrite] is rhi.DepthWrite.ON:
            after = new.unite(passed.may, old, ~passed.must)
            stored.low[here] = after.low[..., None]
            stored.high[here] = after.high[..., None]
        return passed

    def _stencil(
        self,
        context: _Context,
        covered: CoveredPrimitive,
        stored: _Level,
        here: Any,
        covers: MaskBounds,
        near: MaskBounds,
    ) -> MaskBounds:
        states, front = context.states, covered.is_front
        side = states[rhi.StencilFront if front else rhi.StencilBack]
        reference_, reads, writes = (
            state.front if front else state.back
            for state in (
                states[rhi.StencilReference],
                states[rhi.StencilReadMask],
                states[rhi.StencilWriteMask],
            )
        )
        old = Interval(stored.stencil_low[here].copy(), stored.stencil_high[here].copy())
        exact_values = old.low == old.high
        exact = reference.compare(side.function, reference_ & reads, old.low.astype(np.int64) & reads)
        name = side.function.value
        equal = MaskBounds(
            np.where(exact_values, exact, name == "always"), np.where(exact_values, exact, name != "never")
        )
        outcomes = [
            (~covers.must, rhi.StencilOperation.KEEP),
            (covers.may & ~equal.must, side.stencil_fail),
            (covers.may & equal.may & ~near.must, side.depth_fail),
            (covers.may & equal.may & near.may, side.both_pass),
        ]
        low, high = np.full(old.low.shape, np.inf), np.full(old.low.shape, -np.inf)
        for possible, operation in outcomes:
            table = np.array(
                [reference.stencil(operation, value, reference_, writes) for value in range(256)]
            )
            new = table[old.low.astype(np.int64)]
            changes = operation is not rhi.StencilOperation.KEEP
            least = np.where(exact_values, new, 0.0 if changes else old.low)
            most = np.where(exact_values, new, 255.0 if changes else old.high)
            low = np.where(possible, np.minimum(low, least), low)
            high = np.where(possible, np.maximum(high, most), high)
        stored.stencil_low[here], stored.stencil_high[here] = low, high
        return equal

    def _bias(self, context: _Context, covered: CoveredPrimitive, format: rhi.Format) -> Interval:
        bias, offset = context.states[rhi.DepthBias], context.states[rhi.PolygonOffset]
        z = covered.depth
        if (not bias.units and not offset.slope) or covered.slope < 0:
            return z
        step = 1.0 / format.depth_steps if format.depth_steps else 2.0**-23
        least_step = step if format.depth_steps else 2.0**-30
        sizes = [bias.units * step, bias.units * least_step]
        slope = offset.slope * covered.slope
        error = abs(bias.units) * step + 2 * step + abs(slope) * 0.05
        low, high = min(sizes) + slope - error, max(sizes) + slope + error
        if offset.clamp > 0:
            low, high = min(low, offset.clamp), min(high, offset.clamp)
        elif offset.clamp < 0:
            low, high = max(low, offset.clamp), max(high, offset.clamp)
        return Interval(z.low + low, z.high + high).widen(2e-7)

    def _merge_color(
        self,
        context: _Context,
        covered: CoveredPrimitive,
        number: int,
        subresource: model.Subresource,
        format: rhi.Format,
        output: Interval,
        written: MaskBounds,
    ) -> None:
        states = context.states
        stored = self._levels[subresource.image, subresource.level]
        here = (subresource.layer, covered.rows, covered.columns)
        old = Interval(stored.low[here].copy(), stored.high[here].copy())
        source = output[:, :, None, :]  # for all samples
        function = states[rhi.BlendFunction][number]
        if not format.is_integer and not function.is_off:
            below = decode(format, old, self._rules)
            wide = Interval(*(np.broadcast_to(end, below.low.shape) for end in (source.low, source.high)))
            source = blend(format, function, states[rhi.BlendColor], wide, below, self._rules)
        fresh = encode(format, source, self._rules)
        fresh = Interval(*(np.broadcast_to(end, old.low.shape) for end in (fresh.low, fresh.high)))
        if number < len(context.color_faults) and context.color_faults[number]:
            fresh = Interval(np.full(old.low.shape, -np.inf), np.full(old.low.shape, np.inf))
            if format.kind in (ChannelKind.UNORM, ChannelKind.SRGB, ChannelKind.SNORM):
                most = float(reference.largest(format))
                fresh = fresh.clip(-most if format.kind is ChannelKind.SNORM else 0.0, most)
        write = states[rhi.ColorWrite][number]
        mask = np.array([write.red, write.green, write.blue, write.alpha][: format.channels])
        after = fresh.unite(written.may[..., None] & mask, old, ~(written.must[..., None] & mask))
        stored.low[here], stored.high[here] = after.low, after.high


def merge_states(draw: model.Draw) -> dict[type, Any]:
    """Return the value of each state of a draw; of those that exist once per target, a list."""
    values: dict[type, Any] = {
        kind: [value] * MAX_TARGETS if kind in PER_TARGET else value for kind, value in DEFAULTS.items()
    }
    for state in draw.states:
        kind = type(state)
        target = getattr(state, "target", None)
        if kind not in PER_TARGET:
            values[kind] = state
        elif target is None:
            values[kind] = [state] * MAX_TARGETS
        else:
            values[kind] = [state if i == target else old for i, old in enumerate(values[kind])]
    return values


def _box(values: Float, shape: tuple[int, ...]) -> Float:
    """Return the mean of 2 texels along each axis of (layers, rows, columns) that is halved."""
    for axis in range(3):
        if values.shape[axis] != shape[axis]:
            even = [slice(None)] * values.ndim
            odd = list(even)
            even[axis], odd[axis] = slice(0, None, 2), slice(1, None, 2)
            values = 0.5 * (values[tuple(even)] + values[tuple(odd)])
    return values


def random_texels(format: rhi.Format, step: model.Write) -> NDArray[Any]:
    """Return the texels of a write, (rows, columns, channels) of the format's dtype."""
    rng = np.random.default_rng(step.seed)
    shape = (step.height, step.width, format.channels)
    if format.kind is ChannelKind.FLOAT:
        return (rng.integers(-8, 17, shape) / 8).astype(format.dtype)
    most = min(reference.largest(format), 1 << 20)
    least = -most if format.kind in (ChannelKind.SNORM, ChannelKind.INT) else 0
    return rng.integers(least, most, shape, endpoint=True).astype(format.dtype)
