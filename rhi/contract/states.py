"""Render states: the type is the state (thesis 4.2, Listings 4.5 to 4.8).

- Each state is a type of its own, so a value can't be given to the wrong state and a scope needs no names:
  `device.states(CullMode.NONE, DepthWrite.OFF, Viewport(0, 0, 64, 64))`.
- States with a choice are enums. States with numbers are frozen, interned values: equal values are the same
  object. So all states hash and compare by identity, at the speed of C. A scope is looked up by the hash of
  its states; a dataclass's own hash costs 150 ns, Enum's 52. (Named tuples won't do: `Viewport(0, 0, 1, 1)`
  would equal `Scissor(0, 0, 1, 1)`.)
- `ColorWrite` and `BlendFunction` exist once per color target: a plain value applies to all targets,
  `ColorWrite.OFF.at(2)` to one.
- `STATE_TYPES` fixes the order of a state vector; commonly changed states come first.
- The thesis's `ZTEST_USE_W` has no counterpart: current hardware has no W buffer.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, ClassVar, Final, Self, TypeAlias
from weakref import WeakValueDictionary

from rhi.errors.arguments import FieldChecker
from rhi.errors.choices import Choice
from rhi.errors.data_classes import dataclass
from rhi.errors.named_tuples import NamedTuple
from rhi.errors.rules import STATE_VALUE
from rhi.errors.shared_caches import make_shared_lock

MAX_TARGETS: Final = 8
MAX_VIEWPORT_SIZE: Final = 16_384
MAX_VIEWPORT_OFFSET: Final = 32_767
"""Largest |x| and |y| of a viewport in texels. Beyond it, platforms clamp differently."""


class Comparison(Choice):
    """A comparison `new OP stored`. It is a parameter of samplers and stencil states, not a state itself."""

    NEVER = "never"
    LESS = "less"
    EQUAL = "equal"
    LESS_EQUAL = "less_equal"
    GREATER = "greater"
    NOT_EQUAL = "not_equal"
    GREATER_EQUAL = "greater_equal"
    ALWAYS = "always"


class CullMode(Choice):
    """The faces that are culled."""

    NONE = "none"
    FRONT = "front"
    BACK = "back"


class FrontFace(Choice):
    """The winding of front faces, seen with +Y up."""

    COUNTER_CLOCKWISE = "counter_clockwise"
    CLOCKWISE = "clockwise"


class DepthTest(Choice):
    """Depth test. OFF lets every fragment pass, but doesn't disable depth writes (`DepthWrite` does)."""

    OFF = "off"
    ON = "on"


class DepthWrite(Choice):
    """Writes of depth by fragments that pass."""

    OFF = "off"
    ON = "on"


class DepthFunction(Choice):
    """The depth comparison `fragment OP stored`. Depth is reversed by default (near 1, far 0), so the default
    is GREATER."""

    NEVER = "never"
    LESS = "less"
    EQUAL = "equal"
    LESS_EQUAL = "less_equal"
    GREATER = "greater"
    NOT_EQUAL = "not_equal"
    GREATER_EQUAL = "greater_equal"
    ALWAYS = "always"


class AlphaTest(Choice):
    """Alpha test. ON discards a fragment unless `alpha of target 0 OP reference` is true. It needs
    `capabilities.alpha_test`."""

    OFF = "off"
    ON = "on"


class AlphaFunction(Choice):
    """The comparison of the alpha test. Its reference is `AlphaReference`."""

    NEVER = "never"
    LESS = "less"
    EQUAL = "equal"
    LESS_EQUAL = "less_equal"
    GREATER = "greater"
    NOT_EQUAL = "not_equal"
    GREATER_EQUAL = "greater_equal"
    ALWAYS = "always"


class StencilTest(Choice):
    """Stencil test. OFF neither tests nor writes stencil values."""

    OFF = "off"
    ON = "on"


class AlphaToCoverage(Choice):
    """Alpha to coverage. ON turns the alpha of target 0 into a coverage mask on multi-sampled targets."""

    OFF = "off"
    ON = "on"


class PolygonMode(Choice):
    """The drawing of triangles: filled, or as their three edges (wireframe). LINE needs
    `capabilities.wireframe`.

    An edge is a line of the `LineWidth`; triangles that share it draw it twice. Culling, the depth offset and
    flat varyings are those of the triangle. Some drivers test the edges of back faces by `StencilFront`.
    """

    FILL = "fill"
    LINE = "line"


_VALUES: Final[WeakValueDictionary[tuple[object, ...], Any]] = WeakValueDictionary()
_LOCK: Final = make_shared_lock()  # of its own: no frame waits for a thread that compiles


class _Interned(type):
    """Metaclass that interns: equal values of a class are the same object."""

    def __call__(cls, *arguments: Any, **named: Any) -> Any:
        value = super().__call__(*arguments, **named)  # validates the numbers
        key = (cls, *(getattr(value, name) for name in cls.__match_args__))  # type: ignore[attr-defined]
        interned = _VALUES.get(key)
        if interned is None:
            with _LOCK:
                interned = _VALUES.setdefault(key, value)
        return interned


if TYPE_CHECKING:  # type checkers would use the metaclass's __call__ as the constructor's signature

    class _Value: ...

else:

    class _Value(metaclass=_Interned):
        """Base class of states with numbers. Values are interned, so equality is identity."""

        __slots__ = ("__weakref__",)

        def __copy__(self) -> Any:
            return self

        def __deepcopy__(self, memo: object) -> Any:
            return self

        def __reduce__(self) -> Any:
            return type(self), tuple(getattr(self, name) for name in type(self).__match_args__)


@dataclass(frozen=True, slots=True, eq=False)
class AlphaReference(_Value):
    """The reference value of the alpha test, 0 to 1."""

    value: float = 0.5

    def __post_init__(self) -> None:
        FieldChecker(self, STATE_VALUE).numbers("value", minimum=0, maximum=1)


class _OfTarget(_Value):
    """Base class of states that exist per color target. `target`, the last field, selects one; None means
    all."""

    __slots__ = ()

    def at(self, target: int) -> Self:
        """Return this state for one color target."""
        # Not with dataclasses.replace: an error would name a line of `dataclasses` as the user's.
        kind: Any = type(self)
        state: Self = kind(*(getattr(self, name) for name in kind.__match_args__[:-1]), target)
        return state


@dataclass(frozen=True, slots=True, eq=False)
class ColorWrite(_OfTarget):
    """The channels that fragments write. `target` None applies to all targets."""

    red: bool = True
    green: bool = True
    blue: bool = True
    alpha: bool = True
    target: int | None = None

    ON: ClassVar[ColorWrite]
    OFF: ClassVar[ColorWrite]

    def __post_init__(self) -> None:
        fields = FieldChecker(self, STATE_VALUE)
        fields.flags("red", "green", "blue", "alpha")
        fields.integers_or_none("target", minimum=0, maximum=MAX_TARGETS - 1)


ColorWrite.ON = ColorWrite()
ColorWrite.OFF = ColorWrite(False, False, False, False)


class BlendFactor(Choice):
    """The factor of the source or destination color in blending. CONSTANT is the `BlendColor`."""

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


class BlendOperation(Choice):
    """The operation by which blending combines source and destination. MINIMUM and MAXIMUM ignore the
    factors."""

    ADD = "add"
    SUBTRACT = "subtract"
    REVERSE_SUBTRACT = "reverse_subtract"
    MINIMUM = "minimum"
    MAXIMUM = "maximum"


@dataclass(frozen=True, slots=True, eq=False)
class BlendFunction(_OfTarget):
    """Blending: `source · source factor OP destination · destination factor`. Alpha may differ from color.

    Common functions are `BlendFunction.OFF`, `ALPHA`, `ADDITIVE`, `PREMULTIPLIED` and `MULTIPLY`. `target`
    None applies to all targets. Integer targets don't blend.
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
        fields = FieldChecker(self, STATE_VALUE)
        fields.choices(BlendFactor, "source", "destination")
        fields.choices(BlendOperation, "operation")
        fields.choices_or_none(BlendFactor, "source_alpha", "destination_alpha")
        fields.choices_or_none(BlendOperation, "operation_alpha")
        fields.integers_or_none("target", minimum=0, maximum=MAX_TARGETS - 1)

    @property
    def is_off(self) -> bool:
        """True if the source only replaces the destination, so that blending can be disabled."""
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
    """The color of the CONSTANT blend factors."""

    red: float = 0.0
    green: float = 0.0
    blue: float = 0.0
    alpha: float = 0.0

    def __post_init__(self) -> None:
        FieldChecker(self, STATE_VALUE).numbers("red", "green", "blue", "alpha")


class StencilOperation(Choice):
    """The change of the stored stencil value. INCREMENT and DECREMENT saturate at 255 and 0."""

    KEEP = "keep"
    ZERO = "zero"
    REPLACE = "replace"
    INCREMENT = "increment"
    INCREMENT_WRAP = "increment_wrap"
    DECREMENT = "decrement"
    DECREMENT_WRAP = "decrement_wrap"
    INVERT = "invert"


@dataclass(frozen=True, slots=True, eq=False)
class _StencilFace(_Value):
    function: Comparison = Comparison.ALWAYS
    stencil_fail: StencilOperation = StencilOperation.KEEP
    depth_fail: StencilOperation = StencilOperation.KEEP
    both_pass: StencilOperation = StencilOperation.KEEP

    def __post_init__(self) -> None:
        fields = FieldChecker(self, STATE_VALUE)
        fields.choices(Comparison, "function")
        fields.choices(StencilOperation, "stencil_fail", "depth_fail", "both_pass")


class StencilFront(_StencilFace):
    """Stencil test of front faces, points and lines: the comparison `reference & mask OP stored & mask`, and
    how the stored value changes when the stencil test fails, when the depth test fails, and when both
    pass."""

    __slots__ = ()


class StencilBack(_StencilFace):
    """Stencil test of back faces; see `StencilFront`."""

    __slots__ = ()


@dataclass(frozen=True, slots=True, eq=False)
class _StencilBytes(_Value):
    front: int
    back: int

    def __post_init__(self) -> None:
        FieldChecker(self, STATE_VALUE).integers("front", "back", minimum=0, maximum=255)


@dataclass(frozen=True, slots=True, eq=False)
class StencilReference(_StencilBytes):
    """The stencil reference of front and back faces, 0 to 255: the value to compare with, and which REPLACE
    writes."""

    front: int = 0
    back: int = 0


@dataclass(frozen=True, slots=True, eq=False)
class StencilReadMask(_StencilBytes):
    """The mask that both sides of the stencil comparison are ANDed with."""

    front: int = 255
    back: int = 255


@dataclass(frozen=True, slots=True, eq=False)
class StencilWriteMask(_StencilBytes):
    """The bits that stencil writes may change."""

    front: int = 255
    back: int = 255


@dataclass(frozen=True, slots=True, eq=False)
class Viewport(_Value):
    """The rectangle that clip space maps to, in texels from the target's top left corner, and its depth
    range.

    `Viewport.TARGET`, the default, is the whole target of the current pass. Width and height are at most
    16,384, x and y within ±32,767.
    """

    x: float = 0.0
    y: float = 0.0
    width: float = 0.0
    height: float = 0.0
    near: float = 0.0
    far: float = 1.0

    TARGET: ClassVar[Viewport]

    def __post_init__(self) -> None:
        fields = FieldChecker(self, STATE_VALUE)
        fields.numbers("x", "y", minimum=-MAX_VIEWPORT_OFFSET, maximum=MAX_VIEWPORT_OFFSET)
        fields.numbers("width", "height", minimum=0, maximum=MAX_VIEWPORT_SIZE)
        fields.numbers("near", "far", minimum=0, maximum=1)


Viewport.TARGET = Viewport()


@dataclass(frozen=True, slots=True, eq=False)
class Scissor(_Value):
    """The rectangle of texels that draws may write, from the target's top left corner. Clears ignore it.

    `Scissor.OFF`, the default, is the whole target. A scissor of width or height 0 discards every fragment.
    """

    x: int = 0
    y: int = 0
    width: int = 1 << 30
    height: int = 1 << 30

    OFF: ClassVar[Scissor]

    def __post_init__(self) -> None:
        fields = FieldChecker(self, STATE_VALUE)
        fields.integers("x", "y", minimum=-(1 << 30), maximum=1 << 30)
        fields.integers("width", "height", minimum=0, maximum=1 << 30)

    def clamp(self, width: int, height: int) -> tuple[int, int, int, int]:
        """Return x, y, width and height of the part inside a target of this size.

        Drivers store edges in as few as 16 bits, so backends pass only this part on. Outside the target, the
        part is empty.
        """
        return clamp_rectangle((self.x, self.y, self.width, self.height), width, height)


def clamp_rectangle(rectangle: Sequence[int], width: int, height: int) -> tuple[int, int, int, int]:
    """Return the part of a rectangle (x, y, width, height) inside a target of this size, which may be
    empty."""
    x, y, rectangle_width, rectangle_height = rectangle
    left, top = min(max(x, 0), width), min(max(y, 0), height)
    right, bottom = min(max(x + rectangle_width, left), width), min(max(y + rectangle_height, top), height)
    return left, top, right - left, bottom - top


Scissor.OFF = Scissor()


@dataclass(frozen=True, slots=True, eq=False)
class DepthBias(_Value):
    """A constant that is added to every depth, in units of the smallest step of the depth format. A positive
    bias gives a larger depth value, which is nearer with reversed depth."""

    units: float = 0.0

    def __post_init__(self) -> None:
        FieldChecker(self, STATE_VALUE).numbers("units")


@dataclass(frozen=True, slots=True, eq=False)
class PolygonOffset(_Value):
    """Slope-scaled depth offset: `slope` times the steepest depth slope of a polygon is added to its depth. A
    `clamp` other than 0 limits the whole offset, bias included; it needs `capabilities.depth_bias_clamp`."""

    slope: float = 0.0
    clamp: float = 0.0

    def __post_init__(self) -> None:
        FieldChecker(self, STATE_VALUE).numbers("slope", "clamp")


@dataclass(frozen=True, slots=True, eq=False)
class LineWidth(_Value):
    """The width of lines in texels, from 1 to `capabilities.max_line_width`.

    It is rounded to whole texels. On targets of one sample, a line that is wider than high covers as many
    texels in each of its columns, any other in each of its rows.
    """

    width: float = 1.0

    def __post_init__(self) -> None:
        FieldChecker(self, STATE_VALUE).numbers("width", minimum=1)


class PlatformState(Choice):
    """Base class of states that only one platform has (thesis 3.3). Its first member is the default.

    A backend derives an enum from it and names it in `Capabilities.platform_states`. Scopes accept its
    members on devices that name it, and refuse it elsewhere (`platform-state`). The state vector has one
    entry for all of them: the members that differ from their defaults, sorted by name.
    """

    @property
    def full_name(self) -> str:
        """The name of this value in traces: backend, state and value."""
        return f"{type(self).platform()}.{type(self).__name__}.{self.name}"

    @classmethod
    def platform(cls) -> str:
        """Return the name of the backend that has this state."""
        raise NotImplementedError

    @classmethod
    def default(cls) -> PlatformState:
        """The value outside all scopes."""
        return next(iter(cls))


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
    | LineWidth
    | PolygonMode
    | PlatformState
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
    LineWidth: LineWidth(),
    PolygonMode: PolygonMode.FILL,
}
"""The value of each state outside all scopes. Platform states have their own defaults."""

STATE_TYPES: Final[tuple[type, ...]] = (*DEFAULTS, PlatformState)
PER_TARGET: Final = (ColorWrite, BlendFunction)


class StateChange(NamedTuple):
    """A new value of one state type. For `ColorWrite` and `BlendFunction`, `value` is a tuple of 8, one per
    target; for `PlatformState` a tuple of all that differ from their defaults; for the other types it is the
    state itself."""

    type: type
    value: object


def default_values() -> tuple[object, ...]:
    """Return the default value of each state type, in the order of `STATE_TYPES`."""
    return (*((v,) * MAX_TARGETS if t in PER_TARGET else v for t, v in DEFAULTS.items()), ())
