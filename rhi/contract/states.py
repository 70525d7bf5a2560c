"""Render states: the type is the state (thesis 4.2, Listings 4.5 to 4.8).

- Each state is a type of its own, so a value can't go to the wrong state and a scope needs no names:
  `device.states(CullMode.NONE, DepthWrite.OFF, Viewport(0, 0, 64, 64))`.
- On/off and choice states are enums; states with numbers are frozen, interned values: equal ones are the same
  object. So all of them hash and compare by identity, at the speed of C: a scope looks them up by hash, and a
  dataclass's own hash costs 150 ns, Enum's 52. (Never named tuples: `Viewport(0, 0, 1, 1)` would equal
  `Scissor(0, 0, 1, 1)`.)
- `ColorWrite` and `BlendFunction` exist once per color target: a plain value is for all targets,
  `ColorWrite.OFF.at(2)` for one.
- `STATE_TYPES` fixes the order of a state vector; commonly changed states come first.
- The thesis's `ZTEST_USE_W` has no counterpart: no hardware with a W buffer is left.
"""

from __future__ import annotations

import dataclasses
import enum
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar, Final, NamedTuple, TypeAlias
from weakref import WeakValueDictionary

from rhi.errors import refuse
from rhi.errors.rules import STATE_VALUE

__rhi_internal__ = True

MAX_TARGETS: Final = 8


class Comparison(enum.Enum):
    """`new OP stored`: a parameter of samplers and stencil states, not a state itself."""

    NEVER = "never"
    LESS = "less"
    EQUAL = "equal"
    LESS_EQUAL = "less_equal"
    GREATER = "greater"
    NOT_EQUAL = "not_equal"
    GREATER_EQUAL = "greater_equal"
    ALWAYS = "always"

    __hash__ = object.__hash__


class CullMode(enum.Enum):
    """Which faces are dropped."""

    NONE = "none"
    FRONT = "front"
    BACK = "back"

    __hash__ = object.__hash__


class FrontFace(enum.Enum):
    """Which winding, seen with +Y up, is the front."""

    COUNTER_CLOCKWISE = "counter_clockwise"
    CLOCKWISE = "clockwise"

    __hash__ = object.__hash__


class DepthTest(enum.Enum):
    """OFF lets every fragment pass; it doesn't stop depth writes (`DepthWrite` does)."""

    OFF = "off"
    ON = "on"

    __hash__ = object.__hash__


class DepthWrite(enum.Enum):
    """OFF leaves the stored depth as it is."""

    OFF = "off"
    ON = "on"

    __hash__ = object.__hash__


class DepthFunction(enum.Enum):
    """`fragment OP stored`. Depth is reversed by default (near 1, far 0), so the default is GREATER."""

    NEVER = "never"
    LESS = "less"
    EQUAL = "equal"
    LESS_EQUAL = "less_equal"
    GREATER = "greater"
    NOT_EQUAL = "not_equal"
    GREATER_EQUAL = "greater_equal"
    ALWAYS = "always"

    __hash__ = object.__hash__


class AlphaTest(enum.Enum):
    """ON drops a fragment unless `alpha of target 0 OP reference` (needs `capabilities.alpha_test`)."""

    OFF = "off"
    ON = "on"

    __hash__ = object.__hash__


class AlphaFunction(enum.Enum):
    """The alpha test's comparison; its reference is `AlphaReference`."""

    NEVER = "never"
    LESS = "less"
    EQUAL = "equal"
    LESS_EQUAL = "less_equal"
    GREATER = "greater"
    NOT_EQUAL = "not_equal"
    GREATER_EQUAL = "greater_equal"
    ALWAYS = "always"

    __hash__ = object.__hash__


class StencilTest(enum.Enum):
    """OFF neither tests nor writes stencil."""

    OFF = "off"
    ON = "on"

    __hash__ = object.__hash__


class AlphaToCoverage(enum.Enum):
    """ON turns alpha into a coverage mask on multi-sampled targets."""

    OFF = "off"
    ON = "on"

    __hash__ = object.__hash__


_VALUES: Final[WeakValueDictionary[tuple[object, ...], Any]] = WeakValueDictionary()


class _Interned(type):
    """Makes equal values of a class the same object."""

    def __call__(cls, *arguments: Any, **named: Any) -> Any:
        value = super().__call__(*arguments, **named)  # which checks the numbers
        key = (cls, *(getattr(value, name) for name in cls.__match_args__))  # type: ignore[attr-defined]
        return _VALUES.setdefault(key, value)


if TYPE_CHECKING:  # type checkers take a metaclass's __call__ for the constructor's signature

    class _Value: ...

else:

    class _Value(metaclass=_Interned):
        """Base of the states with numbers: interned, so identity is equality."""

        __slots__ = ("__weakref__",)

        def __copy__(self) -> Any:
            return self

        def __deepcopy__(self, memo: object) -> Any:
            return self

        def __reduce__(self) -> Any:
            return type(self), tuple(getattr(self, name) for name in type(self).__match_args__)


def _check(condition: bool, value: object, allowed: str) -> None:
    if not condition:
        refuse(STATE_VALUE, type(value).__name__, _show(value), allowed)


def _show(value: object) -> str:
    parts = ", ".join(f"{f.name}={getattr(value, f.name)!r}" for f in dataclasses.fields(value))  # type: ignore[arg-type]
    return f"{type(value).__name__}({parts})"


def _is_finite(*numbers: float) -> bool:
    return all(-3.4e38 < number < 3.4e38 for number in numbers)  # false for NaN too


@dataclass(frozen=True, slots=True, eq=False)
class AlphaReference(_Value):
    """What the alpha test compares with, 0…1."""

    value: float = 0.5

    def __post_init__(self) -> None:
        _check(0.0 <= self.value <= 1.0, self, "0 to 1")


@dataclass(frozen=True, slots=True, eq=False)
class ColorWrite(_Value):
    """Which channels are written; `target` None means all targets."""

    red: bool = True
    green: bool = True
    blue: bool = True
    alpha: bool = True
    target: int | None = None

    ON: ClassVar[ColorWrite]
    OFF: ClassVar[ColorWrite]

    def __post_init__(self) -> None:
        _check(self.target is None or 0 <= self.target < MAX_TARGETS, self, f"target 0 to {MAX_TARGETS - 1}")

    def at(self, target: int) -> ColorWrite:
        """The same for one color target."""
        return ColorWrite(self.red, self.green, self.blue, self.alpha, target)


ColorWrite.ON = ColorWrite()
ColorWrite.OFF = ColorWrite(False, False, False, False)


class BlendFactor(enum.Enum):
    """What source or destination is multiplied by; CONSTANT is the `BlendColor`."""

    ZERO = "zero"
    ONE = "one"
    SOURCE_COLOR = "source_color"
    ONE_MINUS_SOURCE_COLOR = "one_minus_source_color"
    SOURCE_ALPHA = "source_alpha"
    ONE_MINUS_SOURCE_ALPHA = "one_minus_source_alpha"
    DESTINATION_COLOR = "destination_color"
    ONE_MINUS_DESTINATION_COLOR = "one_minus_destination_color"
    DESTINATION_ALPHA = "destination_alpha"
    ONE_MINUS_DESTINATION_ALPHA = "one_minus_destination_alpha"
    CONSTANT = "constant"
    ONE_MINUS_CONSTANT = "one_minus_constant"
    SOURCE_ALPHA_SATURATE = "source_alpha_saturate"

    __hash__ = object.__hash__


class BlendOperation(enum.Enum):
    """MINIMUM and MAXIMUM ignore the factors."""

    ADD = "add"
    SUBTRACT = "subtract"
    REVERSE_SUBTRACT = "reverse_subtract"
    MINIMUM = "minimum"
    MAXIMUM = "maximum"

    __hash__ = object.__hash__


@dataclass(frozen=True, slots=True, eq=False)
class BlendFunction(_Value):
    """`source · source factor OP destination · destination factor`; alpha may differ from color.

    `BlendFunction.OFF`, `ALPHA`, `ADDITIVE`, `PREMULTIPLIED` and `MULTIPLY` are the common ones. `target` None
    means all targets. Integer targets don't blend.
    """

    source: BlendFactor = BlendFactor.ONE
    destination: BlendFactor = BlendFactor.ZERO
    operation: BlendOperation = BlendOperation.ADD
    source_alpha: BlendFactor | None = None
    destination_alpha: BlendFactor | None = None
    operation_alpha: BlendOperation | None = None
    target: int | None = None

    OFF: ClassVar[BlendFunction]
    ALPHA: ClassVar[BlendFunction]
    ADDITIVE: ClassVar[BlendFunction]
    PREMULTIPLIED: ClassVar[BlendFunction]
    MULTIPLY: ClassVar[BlendFunction]

    def __post_init__(self) -> None:
        _check(self.target is None or 0 <= self.target < MAX_TARGETS, self, f"target 0 to {MAX_TARGETS - 1}")

    def at(self, target: int) -> BlendFunction:
        """The same for one color target."""
        # Not by dataclasses.replace: a refusal would name its line as the user's.
        return BlendFunction(
            self.source,
            self.destination,
            self.operation,
            self.source_alpha,
            self.destination_alpha,
            self.operation_alpha,
            target,
        )

    @property
    def is_off(self) -> bool:
        """Whether it only replaces, so that blending can be switched off."""
        return (
            self.source is BlendFactor.ONE
            and self.destination is BlendFactor.ZERO
            and self.operation is BlendOperation.ADD
            and self.source_alpha in (None, BlendFactor.ONE)
            and self.destination_alpha in (None, BlendFactor.ZERO)
            and self.operation_alpha in (None, BlendOperation.ADD)
        )


BlendFunction.OFF = BlendFunction()
BlendFunction.ALPHA = BlendFunction(
    BlendFactor.SOURCE_ALPHA,
    BlendFactor.ONE_MINUS_SOURCE_ALPHA,
    source_alpha=BlendFactor.ONE,
    destination_alpha=BlendFactor.ONE_MINUS_SOURCE_ALPHA,
)
BlendFunction.ADDITIVE = BlendFunction(BlendFactor.ONE, BlendFactor.ONE)
BlendFunction.PREMULTIPLIED = BlendFunction(BlendFactor.ONE, BlendFactor.ONE_MINUS_SOURCE_ALPHA)
BlendFunction.MULTIPLY = BlendFunction(BlendFactor.DESTINATION_COLOR, BlendFactor.ZERO)


@dataclass(frozen=True, slots=True, eq=False)
class BlendColor(_Value):
    """The constant of the CONSTANT blend factors."""

    red: float = 0.0
    green: float = 0.0
    blue: float = 0.0
    alpha: float = 0.0

    def __post_init__(self) -> None:
        _check(_is_finite(self.red, self.green, self.blue, self.alpha), self, "finite numbers")


class StencilOperation(enum.Enum):
    """What becomes of the stored stencil value; the plain INCREMENT and DECREMENT stop at 255 and 0."""

    KEEP = "keep"
    ZERO = "zero"
    REPLACE = "replace"
    INCREMENT = "increment"
    INCREMENT_WRAP = "increment_wrap"
    DECREMENT = "decrement"
    DECREMENT_WRAP = "decrement_wrap"
    INVERT = "invert"

    __hash__ = object.__hash__


@dataclass(frozen=True, slots=True, eq=False)
class StencilFront(_Value):
    """Front faces (and points and lines): `reference & mask OP stored & mask`, and what happens to the
    stored value when the stencil test fails, when the depth test fails, and when both pass."""

    function: Comparison = Comparison.ALWAYS
    stencil_fail: StencilOperation = StencilOperation.KEEP
    depth_fail: StencilOperation = StencilOperation.KEEP
    both_pass: StencilOperation = StencilOperation.KEEP


@dataclass(frozen=True, slots=True, eq=False)
class StencilBack(_Value):
    """Back faces; see `StencilFront`."""

    function: Comparison = Comparison.ALWAYS
    stencil_fail: StencilOperation = StencilOperation.KEEP
    depth_fail: StencilOperation = StencilOperation.KEEP
    both_pass: StencilOperation = StencilOperation.KEEP


@dataclass(frozen=True, slots=True, eq=False)
class _StencilBytes(_Value):
    front: int
    back: int

    def __post_init__(self) -> None:
        _check(0 <= self.front <= 255 and 0 <= self.back <= 255, self, "0 to 255")


@dataclass(frozen=True, slots=True, eq=False)
class StencilReference(_StencilBytes):
    """The value compared with and written by REPLACE, 0…255, front and back."""

    front: int = 0
    back: int = 0


@dataclass(frozen=True, slots=True, eq=False)
class StencilReadMask(_StencilBytes):
    """ANDed to both sides of the stencil comparison."""

    front: int = 255
    back: int = 255


@dataclass(frozen=True, slots=True, eq=False)
class StencilWriteMask(_StencilBytes):
    """The bits that stencil writes change."""

    front: int = 255
    back: int = 255


@dataclass(frozen=True, slots=True, eq=False)
class Viewport(_Value):
    """Where clip space lands, in texels from the target's top left corner, and its depth range.

    `Viewport.TARGET` (the default) is the whole target of the pass, whichever that is.
    """

    x: float = 0.0
    y: float = 0.0
    width: float = 0.0
    height: float = 0.0
    near: float = 0.0
    far: float = 1.0

    TARGET: ClassVar[Viewport]

    def __post_init__(self) -> None:
        _check(_is_finite(self.x, self.y, self.width, self.height), self, "finite numbers")
        _check(self.width >= 0.0 and self.height >= 0.0, self, "width and height of 0 or more")
        _check(0.0 <= self.near <= 1.0 and 0.0 <= self.far <= 1.0, self, "near and far from 0 to 1")


Viewport.TARGET = Viewport()


@dataclass(frozen=True, slots=True, eq=False)
class Scissor(_Value):
    """The only texels a pass's draws may touch, from the target's top left corner; clears ignore it.

    `Scissor.OFF` (the default) is the whole target. A scissor of width or height 0 lets nothing through.
    """

    x: int = 0
    y: int = 0
    width: int = 1 << 30
    height: int = 1 << 30

    OFF: ClassVar[Scissor]

    def __post_init__(self) -> None:
        _check(self.width >= 0 and self.height >= 0, self, "width and height of 0 or more")
        _check(abs(self.x) <= 1 << 30 and abs(self.y) <= 1 << 30, self, "x and y within 2**30")


Scissor.OFF = Scissor()


@dataclass(frozen=True, slots=True, eq=False)
class DepthBias(_Value):
    """A constant added to every depth, in units of the smallest step of the depth format (positive is a
    larger depth value: nearer under reversed depth)."""

    units: float = 0.0

    def __post_init__(self) -> None:
        _check(_is_finite(self.units), self, "a finite number")


@dataclass(frozen=True, slots=True, eq=False)
class PolygonOffset(_Value):
    """`slope` times a polygon's steepest depth slope is added to its depth; with `clamp` not 0 the whole
    offset (bias included) is kept within it (needs `capabilities.depth_bias_clamp`)."""

    slope: float = 0.0
    clamp: float = 0.0

    def __post_init__(self) -> None:
        _check(_is_finite(self.slope, self.clamp), self, "finite numbers")


State: TypeAlias = (
    CullMode
    | FrontFace
    | DepthTest
    | DepthWrite
    | DepthFunction
    | AlphaTest
    | AlphaFunction
    | AlphaReference
    | ColorWrite
    | BlendFunction
    | BlendColor
    | StencilTest
    | StencilFront
    | StencilBack
    | StencilReference
    | StencilReadMask
    | StencilWriteMask
    | Viewport
    | Scissor
    | DepthBias
    | PolygonOffset
    | AlphaToCoverage
)
"""Any render state value."""

DEFAULTS: Final[dict[type, State]] = {
    CullMode: CullMode.BACK,
    DepthTest: DepthTest.ON,
    DepthWrite: DepthWrite.ON,
    ColorWrite: ColorWrite.ON,
    DepthFunction: DepthFunction.GREATER,
    BlendFunction: BlendFunction.OFF,
    Viewport: Viewport.TARGET,
    Scissor: Scissor.OFF,
    FrontFace: FrontFace.COUNTER_CLOCKWISE,
    DepthBias: DepthBias(),
    PolygonOffset: PolygonOffset(),
    StencilTest: StencilTest.OFF,
    StencilFront: StencilFront(),
    StencilBack: StencilBack(),
    StencilReference: StencilReference(),
    StencilReadMask: StencilReadMask(),
    StencilWriteMask: StencilWriteMask(),
    BlendColor: BlendColor(),
    AlphaTest: AlphaTest.OFF,
    AlphaFunction: AlphaFunction.GREATER,
    AlphaReference: AlphaReference(),
    AlphaToCoverage: AlphaToCoverage.OFF,
}
"""What holds where no scope says otherwise."""

STATE_TYPES: Final = tuple(DEFAULTS)
PER_TARGET: Final = (ColorWrite, BlendFunction)


class StateChange(NamedTuple):
    """One value for the hardware. For `ColorWrite` and `BlendFunction`, `value` is a tuple of 8, one per
    target; for the other types it is the state itself."""

    type: type
    value: object


def default_values() -> tuple[object, ...]:
    """What holds where nothing was set, in the order of `STATE_TYPES`."""
    return tuple((v,) * MAX_TARGETS if t in PER_TARGET else v for t, v in DEFAULTS.items())
