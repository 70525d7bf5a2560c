"""Writes vertex and fragment stages as OpenCL C functions for 16 lanes, which a rasteriser's kernels call.

    void rhi_vertex(BINDINGS, const uint16 *inputs, int16 vertex, int instance, int draw, int16 mask, uint16 *outputs);
    void rhi_bounds(BINDINGS, const uint16 *inputs, const uint *reaches, int16 vertex, int instance, int draw,
                    int16 mask, uint16 *outputs);
    int16 rhi_fragment(BINDINGS, const uint16 *inputs, const uint *flat, float16 x, float16 y, float16 z, float16 w,
                       int front, int primitive, float16 across, float16 down, int16 mask, uint16 *outputs,
                       float16 *depth);

- BINDINGS are the program's bindings in order, as for a compute kernel, but uniforms are `global const uint
  *`. A texture or image is passed as its texels and the words that describe it. A checked program has a last
  parameter `global int *` (`rhi.shading.ir.faults`).
- A vertex stage gets the components of its attributes as words, one attribute after the other. It returns the
  clip position in words 0 to 3 and the fragment stage's varyings from word 4 on. Vertices may have any
  indices; if these are consecutive, buffers indexed by the vertex are read with vector loads.
- Where the clip position is an affine function of attributes, `RHI_BOXED(WORD)` expands to WORD(i) for each
  word of `inputs` that it depends on, and `rhi_bounds` is a vertex stage that returns only the position and,
  in words 4 to 7, its slacks (`rhi.shading.lowering.bounds`). `reaches` are floats, the largest magnitudes of
  the inputs.
- The lanes of a fragment stage are 4 by 4 pixels, lane = x + 4 y. It gets smooth and linear varyings for all
  lanes, including those outside the mask, since differences need them; flat varyings of the first vertex; and
  the pixels' centres, window depth and 1 / clip w, and the position inside a point. `front` is 1 or 0. It
  writes component c of location l to word 4 l + c and the depth if the stage has one, and returns the lanes
  that remain.
- Arrays are indexed by constants, so that they live in registers once a function is inlined.
- Contraction is off in a vertex stage, so that two programs compute the same position to the bit.
"""

from __future__ import annotations

from typing import Final

from rhi.contract.descriptors import Binding, Stage, StageText
from rhi.shading.ir import tree
from rhi.shading.ir.lanes import FIRST_VERTEX, WIDTH, Argument, PositionBounds, StageCode, Uniformity
from rhi.shading.language.builtins import Precision
from rhi.shading.opencl.opencl_writer import OpenCLWriter

LANGUAGE: Final = f"opencl{WIDTH}"
_INLINE: Final = "inline __attribute__((always_inline))"
_VERTEX: Final = "int16 vertex, int instance, int draw, int16 mask, private uint16 *outputs"
_INPUTS: Final = "private const uint16 *inputs"
_REACHES: Final = "private const uint *reaches"
_FRAGMENT: Final = (
    "private const uint16 *inputs, private const uint *flat, float16 x, float16 y, float16 z, float16 w, int "
    "front, "
    "int primitive, float16 across, float16 down, int16 mask, private uint16 *outputs, private float16 *depth"
)


def write_opencl_stage(
    stage: tree.StageTree,
    code: StageCode,
    bounds: PositionBounds | None,
    bindings: tuple[Binding, ...],
    precision: Precision,
) -> StageText:
    """Return the text of a stage's function and of all functions that it calls.

    Args:
        code: the lane code of the stage; empty for a stage whose body is written in OpenCL C.
        bounds: the bounds of a vertex stage's positions, where there are any (`rhi.shading.lowering.bounds`).
    """
    native = stage.entry if LANGUAGE in stage.entry.native else None
    return _OpenCLStageWriter(code, precision, native).stage(stage.stage, bounds, bindings)


class _OpenCLStageWriter(OpenCLWriter):
    uniform_space = "global const"

    def __init__(self, code: StageCode, precision: Precision, native: tree.Function | None) -> None:
        super().__init__(code.code, precision, native)
        self.outputs = code

    def stage(self, stage: Stage, bounds: PositionBounds | None, bindings: tuple[Binding, ...]) -> StageText:
        assert self.width == WIDTH
        parameters = [text for binding in bindings for text in self.parameters(binding)]
        parameters += ["global int *rhi_faults"] if self.code.checked else []
        if stage is Stage.FRAGMENT:
            self.function("int16 rhi_fragment", [*parameters, _FRAGMENT])
            return self.finish()
        self.lines.add("#pragma OPENCL FP_CONTRACT OFF")
        self.steps = "rhi_steps"
        self.function("void rhi_vertex", [*parameters, _INPUTS, _VERTEX])
        if bounds is not None:
            self.code, self.outputs = bounds.stage.code, bounds.stage
            words = " ".join(f"WORD({word})" for word in bounds.inputs)
            self.lines.add(f"#define RHI_BOXED(WORD) {words}")
            self.function("void rhi_bounds", [*parameters, _INPUTS, _REACHES, _VERTEX])
        return self.finish()

    def function(self, head: str, parameters: list[str]) -> None:
        """Write one function from the current `code`."""
        is_vertex = bool(self.steps)
        with self.lines.braces(f"{_INLINE} {head}({', '.join(parameters)})"):
            if is_vertex:
                self.lines.add("const int16 rhi_steps = vertex - vertex.s0;")
            self.body()
            results = list(self.code.results)
            for word, value in zip(self.outputs.words, results, strict=False):
                self.lines.add(f"outputs[{word}] = {self.bits(value, True)};")
            if self.outputs.has_depth:
                self.lines.add(f"*depth = {self.wide(results[len(self.outputs.words)])};")
            if results and not is_vertex:
                self.lines.add(f"return {self.wide(results[-1])};")

    def argument(self, node: Argument) -> str:
        array, _, word = node.name.partition("_")
        if not word:
            return node.name if node.name != FIRST_VERTEX else "vertex.s0"
        return self.cast(node.kind, node.uniformity is Uniformity.VARYING, f"{array}[{word}]")
