"""Render states, and pipelines that contain most of them.

Viewport, scissor, blend color and stencil reference are set in a pass; everything else is a part of a
pipeline. A program caches its pipelines by the layouts of bindings and vertices, the topology, the states and
the targets.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Final

from rhi.backends.webgpu.implementation import GpuObject, Handle, Implementation
from rhi.backends.webgpu.webgpu_errors import translate_errors
from rhi.backends.webgpu.webgpu_formats import (
    DUMMY_FORMAT,
    FACTORS,
    FORMATS,
    OPERATIONS,
    STENCIL,
    TOPOLOGIES,
    VERTICES,
    word,
)
from rhi.backends.webgpu.webgpu_programs import GpuProgram, PipelineLayout
from rhi.contract.backend import Capabilities
from rhi.contract.descriptors import Primitive, Stage, VertexArrayDescriptor
from rhi.contract.formats import Format, IndexFormat
from rhi.contract.states import (
    DEFAULTS,
    STATE_TYPES,
    AlphaFunction,
    AlphaReference,
    AlphaTest,
    AlphaToCoverage,
    BlendColor,
    BlendFactor,
    BlendFunction,
    BlendOperation,
    ColorWrite,
    CullMode,
    DepthBias,
    DepthFunction,
    DepthTest,
    DepthWrite,
    FrontFace,
    PolygonMode,
    PolygonOffset,
    Scissor,
    StateChange,
    StencilBack,
    StencilFront,
    StencilReadMask,
    StencilReference,
    StencilTest,
    StencilWriteMask,
    Viewport,
    default_values,
)
from rhi.errors import DeviceError
from rhi.errors.rules import DEVICE_CAPABILITY
from rhi.shading.wgsl.wgsl_stages import ALPHA_TESTS

TargetFormats = tuple[tuple[Format, ...], Format | None, int]
"""The color formats, the depth format, and the number of samples of a pass."""

MAX_PIPELINES: Final = 512
"""Largest number of pipelines of a device: on llvmpipe each allocates .8 MiB, and writes to .2 of it at first."""
_MAX_BIAS: Final = (1 << 31) - 1
DYNAMIC: Final = frozenset({Viewport, Scissor, BlendColor, StencilReference})
"""The states that are set in a pass, and not a part of pipelines."""
_ALPHA: Final = frozenset({AlphaTest, AlphaFunction, AlphaReference})
_BAKED: Final = tuple(state for state in DEFAULTS if state not in DYNAMIC | _ALPHA)
_TRIANGLES: Final = frozenset(
    {Primitive.TRIANGLES, Primitive.TRIANGLE_STRIP, Primitive.TRIANGLE_FAN, Primitive.QUADS}
)
_EMPTY: Final = "@fragment fn main() {}"
_TESTED: Final = AlphaTest.ON
_FAR: Final = 64
"""Texels between a target and a viewport in which nothing can be drawn."""


class States:
    """The render states of a device, initially the defaults.

    Attributes:
        changed: whether the states may need another pipeline.
        moved: whether a state that is set in a pass has changed.
    """

    def __init__(self, implementation: Implementation) -> None:
        self._implementation = implementation
        self.values: dict[type, Any] = dict(zip(STATE_TYPES, default_values(), strict=True))
        self.changed = True
        self.moved = True
        self.is_reversed = False  # the viewport's depth
        self._baked: tuple[object, ...] = ()

    def set(self, changes: Sequence[StateChange]) -> None:
        """Change states."""
        for state, value in changes:
            self.values[state] = value
            if state in DYNAMIC:
                self.moved = True
                if state is Viewport:
                    reversed_ = self.values[Viewport].near > self.values[Viewport].far
                    self.changed = self.changed or reversed_ != self.is_reversed
                    self.is_reversed = reversed_
            else:
                self.changed = True

    @property
    def alpha(self) -> tuple[int, float] | None:
        """The number of the alpha test and its reference, or None."""
        if self.values[AlphaTest] is not _TESTED:
            return None
        return ALPHA_TESTS[self.values[AlphaFunction]][1], self.values[AlphaReference].value

    def bake(self) -> tuple[object, ...]:
        """Return the states that a pipeline contains; their values hash by identity."""
        if self.changed:
            values = self.values
            self._baked = (self.is_reversed, self.alpha, *(values[state] for state in _BAKED))
            self.changed = False
        return self._baked

    def apply(self, render: Handle, size: tuple[int, int]) -> None:
        """Set the states of a pass with targets of this size."""
        values, (width, height) = self.values, size
        implementation = self._implementation
        view: Viewport = values[Viewport]
        if view is Viewport.TARGET:
            implementation.set_viewport(render, 0, 0, width, height, 0, 1)
        else:
            near, far = min(view.near, view.far), max(view.near, view.far)
            implementation.set_viewport(render, *_move_near(view, width, height), near, far)
        cut: Scissor = values[Scissor]
        implementation.set_scissor_rect(render, *cut.clamp(width, height))
        color: BlendColor = values[BlendColor]
        implementation.set_blend_constant(render, (color.red, color.green, color.blue, color.alpha))
        implementation.set_stencil_reference(render, values[StencilReference].front)
        self.moved = False


def _move_near(view: Viewport, width: int, height: int) -> tuple[float, float, float, float]:
    """Return x, y, width and height of a viewport as WebGPU takes them, for a target of this size.

    WebGPU refuses viewports far from the target. Nothing is drawn in these, so a near one takes their place.
    """
    is_far = (
        view.x >= width + _FAR
        or view.y >= height + _FAR
        or view.x + view.width <= -_FAR
        or view.y + view.height <= -_FAR
    )
    return (-2 * _FAR, -2 * _FAR, _FAR, _FAR) if is_far else (view.x, view.y, view.width, view.height)


class _CachedPipeline:
    """A pipeline in its program's table, and the count of creations when it was last asked for."""

    __slots__ = ("key", "pipeline", "table", "used")

    def __init__(
        self, pipeline: GpuObject, table: dict[object, _CachedPipeline], key: object, used: int
    ) -> None:
        self.pipeline = pipeline
        self.table = table
        self.key = key
        self.used = used


class Pipelines:
    """Makes pipelines, and keeps at most `MAX_PIPELINES`; those that were not asked for longest go."""

    def __init__(self, device: GpuObject, capabilities: Capabilities) -> None:
        self._device = device
        self._unblendable = capabilities.unblendable_formats
        self._empty: GpuObject | None = None
        self._cached: list[_CachedPipeline] = []
        self._created = 0

    def forget(self, program: GpuProgram) -> None:
        """Drop the pipelines of a program that is destroyed."""
        self._cached = [cached for cached in self._cached if cached.table is not program.pipelines]
        program.pipelines.clear()

    def _keep(self, table: dict[object, _CachedPipeline], key: object, pipeline: GpuObject) -> None:
        self._created += 1
        if len(self._cached) >= MAX_PIPELINES:
            self._cached.sort(key=lambda cached: cached.used)
            half = MAX_PIPELINES // 2
            for cached in self._cached[:half]:
                del cached.table[cached.key]
            del self._cached[:half]
        table[key] = _CachedPipeline(pipeline, table, key, self._created)
        self._cached.append(table[key])

    def get_render_pipeline(
        self,
        program: GpuProgram,
        layout: PipelineLayout,
        array: VertexArrayDescriptor,
        array_key: object,
        primitive: Primitive,
        states: States,
        targets: TargetFormats,
    ) -> GpuObject:
        """Return the render pipeline for a draw."""
        topology = TOPOLOGIES[primitive]
        strip = array.index_format if array.index_buffer and topology.endswith("strip") else None
        key = (array_key, topology, strip, states.bake(), targets, layout.unfiltered)
        cached = program.pipelines.get(key)
        if cached is not None:
            cached.used = self._created
            return cached.pipeline
        with translate_errors(f"draw with {program.descriptor.name}"):
            pipeline = self._make(program, layout, array, primitive, strip, states, targets)
        self._keep(program.pipelines, key, pipeline)
        return pipeline

    def get_compute_pipeline(self, program: GpuProgram, layout: PipelineLayout) -> GpuObject:
        """Return the compute pipeline of a program."""
        cached = program.pipelines.get(layout.unfiltered)
        if cached is None:
            stage = {"module": program.modules[Stage.COMPUTE], "entry_point": "main"}
            with translate_errors(f"dispatch of {program.descriptor.name}"):
                pipeline = self._device.create_compute_pipeline(
                    label=program.descriptor.name, layout=layout.object, compute=stage
                )
            self._keep(program.pipelines, layout.unfiltered, pipeline)
            return pipeline
        cached.used = self._created
        return cached.pipeline

    def _make(
        self,
        program: GpuProgram,
        layout: PipelineLayout,
        array: VertexArrayDescriptor,
        primitive: Primitive,
        strip: IndexFormat | None,
        states: States,
        targets: TargetFormats,
    ) -> GpuObject:
        values, (colors, depth, samples) = states.values, targets
        vertex: dict[str, Any] = {"module": program.modules[Stage.VERTEX], "entry_point": "main"}
        vertex["buffers"] = _buffers(array)
        if states.is_reversed:
            vertex["constants"] = {"rhi_reversed": 1.0}
        form: dict[str, Any] = {
            "topology": TOPOLOGIES[primitive],
            "cull_mode": values[CullMode].value,
            "front_face": "ccw" if values[FrontFace] is FrontFace.COUNTER_CLOCKWISE else "cw",
        }
        if strip is not None:
            form["strip_index_format"] = "uint16" if strip is IndexFormat.UINT16 else "uint32"
        if values[PolygonMode] is PolygonMode.LINE and primitive in _TRIANGLES:
            form["polygon_mode"] = "Line"
        multisample: dict[str, Any] = {"count": samples}
        if samples > 1 and values[AlphaToCoverage] is AlphaToCoverage.ON and program.tests_alpha and colors:
            multisample["alpha_to_coverage_enabled"] = True
        return self._device.create_render_pipeline(
            label=program.descriptor.name,
            layout=layout.object,
            vertex=vertex,
            primitive=form,
            depth_stencil=_depth_stencil(values, depth, primitive) if depth is not None else None,
            multisample=multisample,
            fragment=self._fragment(program, states, colors, depth is None),
        )

    def _fragment(
        self, program: GpuProgram, states: States, colors: tuple[Format, ...], lone: bool
    ) -> dict[str, Any] | None:
        """Return the fragment stage and its targets; `lone` means that there is no depth target."""
        outputs = {output.location for output in program.descriptor.outputs}
        entries = [self._target(states, i, format, i in outputs) for i, format in enumerate(colors)]
        if not colors and lone:
            entries.append({"format": FORMATS[DUMMY_FORMAT], "write_mask": 0})
        if Stage.FRAGMENT not in program.modules:
            if not entries:
                return None
            if self._empty is None:
                self._empty = self._device.create_shader_module(code=_EMPTY)
            return {"module": self._empty, "entry_point": "main", "targets": entries}
        stage = {
            "module": program.get_fragment_module(has_depth=not lone),
            "entry_point": "main",
            "targets": entries,
        }
        alpha = states.alpha
        if alpha is not None and program.tests_alpha:
            stage["constants"] = {"rhi_alpha_test": float(alpha[0]), "rhi_alpha_reference": alpha[1]}
        return stage

    def _target(self, states: States, number: int, format: Format, written: bool) -> dict[str, Any]:
        write: ColorWrite = states.values[ColorWrite][number]
        mask = write.red | 2 * write.green | 4 * write.blue | 8 * write.alpha if written else 0
        entry: dict[str, Any] = {"format": FORMATS[format], "write_mask": mask}
        blend: BlendFunction = states.values[BlendFunction][number]
        if not blend.is_off and not format.is_integer and written:
            if format in self._unblendable:
                given, allowed = (
                    f"blending on {format}",
                    "formats outside of capabilities.unblendable_formats",
                )
                raise DeviceError(DEVICE_CAPABILITY, "draw", given, allowed)
            entry["blend"] = {
                "color": _blend(blend.operation, blend.source, blend.destination),
                "alpha": _blend(
                    blend.operation_alpha or blend.operation,
                    blend.source_alpha or blend.source,
                    blend.destination_alpha or blend.destination,
                ),
            }
        return entry


def _blend(operation: BlendOperation, source: BlendFactor, destination: BlendFactor) -> dict[str, str]:
    plain = operation in (BlendOperation.MINIMUM, BlendOperation.MAXIMUM)
    return {
        "operation": OPERATIONS[operation],
        "src_factor": "one" if plain else FACTORS[source],
        "dst_factor": "one" if plain else FACTORS[destination],
    }


def _depth_stencil(values: dict[type, Any], depth: Format, primitive: Primitive) -> dict[str, Any]:
    tested = values[DepthTest] is DepthTest.ON
    description = {
        "format": FORMATS[depth],
        "depth_write_enabled": values[DepthWrite] is DepthWrite.ON,
        "depth_compare": word(values[DepthFunction].value) if tested else "always",
    }
    if primitive in _TRIANGLES and values[PolygonMode] is PolygonMode.FILL:
        offset: PolygonOffset = values[PolygonOffset]
        units = min(max(values[DepthBias].units, -_MAX_BIAS), _MAX_BIAS)
        description["depth_bias"] = round(units)  # WebGPU's is a whole number
        description |= {"depth_bias_slope_scale": offset.slope, "depth_bias_clamp": offset.clamp}
    if depth.has_stencil and values[StencilTest] is StencilTest.ON:
        description |= {
            "stencil_front": _face(values[StencilFront]),
            "stencil_back": _face(values[StencilBack]),
            "stencil_read_mask": values[StencilReadMask].front,
            "stencil_write_mask": values[StencilWriteMask].front,
        }
    return description


def _face(face: StencilFront | StencilBack) -> dict[str, str]:
    return {
        "compare": word(face.function.value),
        "fail_op": STENCIL[face.stencil_fail],
        "depth_fail_op": STENCIL[face.depth_fail],
        "pass_op": STENCIL[face.both_pass],
    }


def _buffers(array: VertexArrayDescriptor) -> list[dict[str, Any]]:
    return [
        {
            "array_stride": stream.stride,
            "step_mode": "instance" if stream.per_instance else "vertex",
            "attributes": [
                {"format": VERTICES[a.format], "offset": a.offset, "shader_location": a.location}
                for a in stream.attributes
            ],
        }
        for stream in array.streams
    ]
