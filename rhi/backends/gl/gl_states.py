"""Render states: a table from each state's type to the function that applies it.

- Some states go to GL together (stencil function, reference and mask; bias and slope). Each such function
  reads the others from `values`, which holds the latest values. Passes use `values` too: clears have to
  ignore the write masks and the scissor, which GL's clears obey, and a pass of another size changes
  `Viewport.TARGET`.
- A depth test that is off lets all fragments pass but must not stop depth writes, as GL's disabled test does.
  So GL's test is disabled only when writes are off too; otherwise it compares with ALWAYS.
- Window coordinates are given to GL unchanged, since programs flip y. Integers are converted, since users
  create states from NumPy scalars, of which ctypes accepts only floats.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from rhi.backends.gl import enums
from rhi.backends.gl.entry_points import EntryPoints
from rhi.backends.gl.gl_formats import map_enums
from rhi.backends.gl.platform_states import DepthClamp
from rhi.contract import states

COMPARISONS: Final = map_enums(
    states.Comparison, LESS_EQUAL="LEQUAL", GREATER_EQUAL="GEQUAL", NOT_EQUAL="NOTEQUAL"
)
_DEPTH_FUNCTIONS: Final = {f: COMPARISONS[states.Comparison(f.value)] for f in states.DepthFunction}
_FACES: Final = {states.CullMode.FRONT: enums.FRONT, states.CullMode.BACK: enums.BACK}
_WINDINGS: Final = {
    states.FrontFace.COUNTER_CLOCKWISE: enums.CW,
    states.FrontFace.CLOCKWISE: enums.CCW,
}  # y is flipped
_FACTORS: Final = map_enums(states.BlendFactor, SOURCE="SRC", DESTINATION="DST", CONSTANT="CONSTANT_COLOR")
_EQUATIONS: Final = {
    states.BlendOperation.ADD: enums.FUNC_ADD,
    states.BlendOperation.SUBTRACT: enums.FUNC_SUBTRACT,
    states.BlendOperation.REVERSE_SUBTRACT: enums.FUNC_REVERSE_SUBTRACT,
    states.BlendOperation.MINIMUM: enums.MIN,
    states.BlendOperation.MAXIMUM: enums.MAX,
}
_STENCIL_OPERATIONS: Final = map_enums(states.StencilOperation, INCREMENT="INCR", DECREMENT="DECR")
_PROGRAMMED: Final = (states.AlphaTest, states.AlphaFunction, states.AlphaReference)
"""The states that programs implement, since GL lacks them."""
_SCISSOR_LIMIT: Final = 1 << 15  # no target is larger, and Mesa stores each edge in 16 bits

_ALL_COLORS: Final = (states.ColorWrite.ON,) * states.MAX_TARGETS
_ALL_STENCIL: Final = states.StencilWriteMask()
_TARGET: Final = states.Viewport.TARGET
_NO_SCISSOR: Final = states.Scissor.OFF
_TESTS_DEPTH: Final = states.DepthTest.ON  # looking up a member through its class costs 80 ns in Python 3.11
_WRITES_DEPTH: Final = states.DepthWrite.ON
_WIREFRAME: Final = states.PolygonMode.LINE


class RenderStates:
    """The render states of one context, initially the defaults.

    Attributes:
        values: the latest value of each state type.
        unwritten: the color targets, as bits, that the bound program has no output for. They keep their
            contents, where GL would write anything.
    """

    def __init__(self, gl: EntryPoints, has_offset_clamp: bool, alpha_changed: Callable[[], None]) -> None:
        """Apply the defaults. `alpha_changed` is called when a state of the alpha test changes; programs do
        the test."""
        self._gl = gl
        self._has_offset_clamp = has_offset_clamp
        self._size = (0, 0)
        self._depth_range: tuple[float, float] | None = None
        self.unwritten = 0
        self.values: dict[type, Any] = dict(zip(states.STATE_TYPES, states.default_values(), strict=True))
        self._apply: dict[type, Callable[[Any], None]] = {
            states.CullMode: self._cull,
            states.FrontFace: lambda value: gl.FrontFace(_WINDINGS[value]),
            states.DepthTest: self._depth_test,
            states.DepthWrite: self._depth_write,
            states.DepthFunction: self._depth_test,
            **dict.fromkeys(_PROGRAMMED, lambda _: alpha_changed()),
            states.ColorWrite: self._color_write,
            states.BlendFunction: self._blend,
            states.BlendColor: lambda value: gl.BlendColor(value.red, value.green, value.blue, value.alpha),
            states.StencilTest: lambda value: self._switch(
                enums.STENCIL_TEST, value is states.StencilTest.ON
            ),
            states.StencilFront: lambda face: self._stencil_face(enums.FRONT, face),
            states.StencilBack: lambda face: self._stencil_face(enums.BACK, face),
            states.StencilReference: self._stencil_functions,
            states.StencilReadMask: self._stencil_functions,
            states.StencilWriteMask: self._stencil_write_mask,
            states.Viewport: self._viewport,
            states.Scissor: self._scissor,
            states.DepthBias: self._offset,
            states.PolygonOffset: self._offset,
            states.LineWidth: lambda value: gl.LineWidth(value.width),
            states.PolygonMode: self._polygon_mode,
            states.PlatformState: lambda value: self._switch(enums.DEPTH_CLAMP, DepthClamp.ON in value),
            states.AlphaToCoverage: lambda value: self._switch(
                enums.SAMPLE_ALPHA_TO_COVERAGE, value is states.AlphaToCoverage.ON
            ),
        }
        self.apply_all()

    def apply_all(self) -> None:
        """Set all states again, whatever GL's states are. The alpha test is left to programs."""
        self._depth_range = None
        for state, value in self.values.items():
            if state not in _PROGRAMMED:
                self._apply[state](value)

    def set(self, changes: Sequence[states.StateChange]) -> None:
        values, apply = self.values, self._apply
        try:
            for state, value in changes:
                values[state] = value
                apply[state](value)
        except (
            BaseException
        ):  # creating a variant with an alpha test failed; the device counts all changes as sent
            values.update(changes)
            self.apply_all()
            raise

    def set_target_size(self, size: tuple[int, int]) -> None:
        """Set the size of the pass that begins, to which `Viewport.TARGET` refers."""
        if size != self._size:
            self._size = size
            if self.values[states.Viewport] == _TARGET:
                self._viewport(_TARGET)

    def open_masks(self, color: bool, depth: bool, stencil: bool) -> None:
        """Disable the scissor and the write masks of these buffers for clears, until `close_masks`."""
        gl, values = self._gl, self.values
        if values[states.Scissor] != _NO_SCISSOR:
            gl.Disable(enums.SCISSOR_TEST)
        if color and (self.unwritten or values[states.ColorWrite] != _ALL_COLORS):
            gl.ColorMask(1, 1, 1, 1)
        if depth and values[states.DepthWrite] is not _WRITES_DEPTH:
            gl.DepthMask(1)
        if stencil and values[states.StencilWriteMask] != _ALL_STENCIL:
            self._stencil_write_mask(_ALL_STENCIL)

    def close_masks(self, color: bool, depth: bool, stencil: bool) -> None:
        """Restore what `open_masks` changed; takes the same arguments."""
        gl, values = self._gl, self.values
        if values[states.Scissor] != _NO_SCISSOR:
            gl.Enable(enums.SCISSOR_TEST)
        if color and (self.unwritten or values[states.ColorWrite] != _ALL_COLORS):
            self._color_write(values[states.ColorWrite])
        if depth and values[states.DepthWrite] is not _WRITES_DEPTH:
            gl.DepthMask(0)
        if stencil and values[states.StencilWriteMask] != _ALL_STENCIL:
            self._stencil_write_mask(values[states.StencilWriteMask])

    def _switch(self, capability: int, on: bool) -> None:
        if on:
            self._gl.Enable(capability)
        else:
            self._gl.Disable(capability)

    def _cull(self, value: states.CullMode) -> None:
        face = _FACES.get(value)
        if face is None:
            self._gl.Disable(enums.CULL_FACE)
        else:
            self._gl.Enable(enums.CULL_FACE)
            self._gl.CullFace(face)

    def _depth_test(self, _: object) -> None:
        gl, values = self._gl, self.values
        if values[states.DepthTest] is _TESTS_DEPTH:
            gl.Enable(enums.DEPTH_TEST)
            gl.DepthFunc(_DEPTH_FUNCTIONS[values[states.DepthFunction]])
        elif values[states.DepthWrite] is _WRITES_DEPTH:
            gl.Enable(enums.DEPTH_TEST)
            gl.DepthFunc(enums.ALWAYS)
        else:
            gl.Disable(enums.DEPTH_TEST)

    def _depth_write(self, value: states.DepthWrite) -> None:
        self._gl.DepthMask(value is _WRITES_DEPTH)
        if self.values[states.DepthTest] is not _TESTS_DEPTH:
            self._depth_test(None)

    def leave_unwritten(self, targets: int) -> None:
        """Mask these color targets for the next draws; `targets` has their bits."""
        self.unwritten = targets
        self._color_write(self.values[states.ColorWrite])

    def _color_write(self, targets: tuple[states.ColorWrite, ...]) -> None:
        unwritten = self.unwritten
        if unwritten:
            off = states.ColorWrite.OFF
            targets = tuple(off if unwritten >> index & 1 else write for index, write in enumerate(targets))
        first = targets[0]
        if targets.count(first) == states.MAX_TARGETS:
            self._gl.ColorMask(first.red, first.green, first.blue, first.alpha)
            return
        for index, write in enumerate(targets):
            self._gl.ColorMaski(index, write.red, write.green, write.blue, write.alpha)

    def _blend(self, targets: tuple[states.BlendFunction, ...]) -> None:
        gl, first = self._gl, targets[0]
        if targets.count(first) == states.MAX_TARGETS:
            if first.is_off:
                gl.Disable(enums.BLEND)
                return
            gl.Enable(enums.BLEND)
            gl.BlendEquationSeparate(*_blend_equations(first))
            gl.BlendFuncSeparate(*_blend_factors(first))
            return
        for index, function in enumerate(targets):
            if function.is_off:
                gl.Disablei(enums.BLEND, index)
                continue
            gl.Enablei(enums.BLEND, index)
            gl.BlendEquationSeparatei(index, *_blend_equations(function))
            gl.BlendFuncSeparatei(index, *_blend_factors(function))

    def _stencil_face(self, side: int, face: states.StencilFront | states.StencilBack) -> None:
        operations = (
            _STENCIL_OPERATIONS[operation]
            for operation in (face.stencil_fail, face.depth_fail, face.both_pass)
        )
        self._gl.StencilOpSeparate(side, *operations)
        self._stencil_functions(None)

    def _stencil_functions(self, _: object) -> None:
        gl, values = self._gl, self.values
        reference, mask = values[states.StencilReference], values[states.StencilReadMask]
        front, back = (
            COMPARISONS[values[face].function] for face in (states.StencilFront, states.StencilBack)
        )
        gl.StencilFuncSeparate(enums.FRONT, front, int(reference.front), int(mask.front))
        gl.StencilFuncSeparate(enums.BACK, back, int(reference.back), int(mask.back))

    def _stencil_write_mask(self, mask: states.StencilWriteMask) -> None:
        self._gl.StencilMaskSeparate(enums.FRONT, int(mask.front))
        self._gl.StencilMaskSeparate(enums.BACK, int(mask.back))

    def _viewport(self, value: states.Viewport) -> None:
        gl = self._gl
        if value == _TARGET:
            gl.Viewport(0, 0, *self._size)
        else:
            gl.ViewportIndexedf(0, value.x, value.y, value.width, value.height)
        depth_range = value.near, value.far
        if depth_range != self._depth_range:
            self._depth_range = depth_range
            gl.DepthRangef(*depth_range)

    def _scissor(self, value: states.Scissor) -> None:
        if value == _NO_SCISSOR:
            self._gl.Disable(enums.SCISSOR_TEST)
            return
        self._gl.Scissor(*value.clamp(_SCISSOR_LIMIT, _SCISSOR_LIMIT))
        self._gl.Enable(enums.SCISSOR_TEST)

    def call_in_scissors(
        self, call: Callable[..., object], arguments: Iterable[tuple[Any, ...]], clips: NDArray[np.int64]
    ) -> None:
        """Call a function with each of `arguments` (n) in one of the rectangles `clips` (n, 4)."""
        corners = np.clip(
            np.concatenate([clips[:, :2], clips[:, :2] + clips[:, 2:]], axis=1), 0, _SCISSOR_LIMIT
        )
        corners[:, 2:] -= corners[:, :2]
        scissor = self._gl.Scissor
        try:
            self._gl.Enable(enums.SCISSOR_TEST)
            for corner, values in zip(corners.tolist(), arguments, strict=True):
                scissor(*corner)
                call(*values)
        finally:
            self._scissor(self.values[states.Scissor])

    def _polygon_mode(self, mode: states.PolygonMode) -> None:
        self._gl.PolygonMode(enums.FRONT_AND_BACK, enums.LINE if mode is _WIREFRAME else enums.FILL)
        self._offset(None)

    def _offset(self, _: object) -> None:
        offset: states.PolygonOffset = self.values[states.PolygonOffset]
        slope, units = offset.slope, self.values[states.DepthBias].units
        self._switch(enums.POLYGON_OFFSET_FILL, bool(units or slope))
        if self.values[states.PolygonMode] is _WIREFRAME:
            self._switch(enums.POLYGON_OFFSET_LINE, bool(units or slope))
        if self._has_offset_clamp:
            self._gl.PolygonOffsetClamp(slope, units, offset.clamp)
        else:
            self._gl.PolygonOffset(slope, units)


def _blend_equations(function: states.BlendFunction) -> tuple[int, int]:
    return _EQUATIONS[function.operation], _EQUATIONS[function.operation_alpha or function.operation]


def _blend_factors(function: states.BlendFunction) -> tuple[int, int, int, int]:
    return (
        _FACTORS[function.source],
        _FACTORS[function.destination],
        _FACTORS[function.source_alpha or function.source],
        _FACTORS[function.destination_alpha or function.destination],
    )
