"""Written by `python -m rhi.shading.tools.stubs`; don't edit."""

# ruff: noqa

from collections.abc import Iterator, Sequence
from typing import Any, ClassVar, Generic, TypeVar, overload

import numpy as np
import numpy.typing as npt
from rhi.contract.layout import HostType, MatrixType, ScalarType, VectorType

__all__ = ['Array', 'ReadOnlyArray', 'array', 'bvec2', 'bvec3', 'bvec4', 'ivec2', 'ivec3', 'ivec4', 'mat2', 'mat3', 'mat4', 'uint', 'uvec2', 'uvec3', 'uvec4', 'vec2', 'vec3', 'vec4']

T = TypeVar("T")

CLASSES: dict[Any, Any]

class Composite:
    components: tuple[Any, ...]
    shape: ClassVar[tuple[int, ...]]
    shading_type: ClassVar[Any]
    def __array__(self, dtype: Any = None, copy: Any = None) -> npt.NDArray[Any]: ...
    def __len__(self) -> int: ...
    def __hash__(self) -> int: ...

class ReadOnlyArray(Generic[T]):
    def __getitem__(self, index: int | uint) -> T: ...
    def __len__(self) -> int: ...

class Array(ReadOnlyArray[T]):
    def __get__(self, instance: object, owner: Any = None) -> Array[T]: ...
    def __set__(self, instance: object, value: Array[T] | Sequence[Any] | npt.NDArray[Any]) -> None: ...
    @overload
    def __setitem__(self: Array[uint], index: int | uint, value: uint | int) -> None: ...
    @overload
    def __setitem__(self, index: int | uint, value: T) -> None: ...

class ArrayLength:
    element: object
    length: int
    def __init__(self, element: object, length: int) -> None: ...

def array(element: type[T], length: int) -> Array[T]: ...

class uint:
    shading_type: ClassVar[ScalarType]
    def __init__(self, value: float | uint | bool = ..., /) -> None: ...
    def __get__(self, instance: object, owner: Any = None) -> uint: ...
    def __set__(self, instance: object, value: uint | int) -> None: ...
    def __add__(self, other: uint | int) -> uint: ...
    def __radd__(self, other: int) -> uint: ...
    def __sub__(self, other: uint | int) -> uint: ...
    def __rsub__(self, other: int) -> uint: ...
    def __mul__(self, other: uint | int) -> uint: ...
    def __rmul__(self, other: int) -> uint: ...
    def __floordiv__(self, other: uint | int) -> uint: ...
    def __rfloordiv__(self, other: int) -> uint: ...
    def __mod__(self, other: uint | int) -> uint: ...
    def __rmod__(self, other: int) -> uint: ...
    def __and__(self, other: uint | int) -> uint: ...
    def __rand__(self, other: int) -> uint: ...
    def __or__(self, other: uint | int) -> uint: ...
    def __ror__(self, other: int) -> uint: ...
    def __xor__(self, other: uint | int) -> uint: ...
    def __rxor__(self, other: int) -> uint: ...
    def __lshift__(self, other: uint | int) -> uint: ...
    def __rshift__(self, other: uint | int) -> uint: ...
    def __pow__(self, other: uint | int) -> uint: ...
    def __truediv__(self, other: uint | int | float) -> float: ...
    def __rtruediv__(self, other: int | float) -> float: ...
    def __lt__(self, other: uint | int) -> bool: ...
    def __le__(self, other: uint | int) -> bool: ...
    def __gt__(self, other: uint | int) -> bool: ...
    def __ge__(self, other: uint | int) -> bool: ...
    def __invert__(self) -> uint: ...
    def __int__(self) -> int: ...
    def __index__(self) -> int: ...
    def __float__(self) -> float: ...
    def __hash__(self) -> int: ...

class vec2(Composite):
    shading_type: ClassVar[VectorType]
    @overload
    def __init__(self, a: float, /) -> None: ...
    @overload
    def __init__(self, a: vec2 | ivec2 | uvec2 | bvec2, /) -> None: ...
    @overload
    def __init__(self, a: float, b: float, /) -> None: ...
    def __get__(self, instance: object, owner: Any = None) -> vec2: ...
    def __set__(self, instance: object, value: vec2 | tuple[float, float] | list[float] | npt.NDArray[Any]) -> None: ...
    def __getitem__(self, index: int | uint) -> float: ...
    def __setitem__(self, index: int | uint, value: float) -> None: ...
    def __iter__(self) -> Iterator[float]: ...
    def __add__(self, other: vec2 | float) -> vec2: ...
    def __radd__(self, other: float) -> vec2: ...
    def __sub__(self, other: vec2 | float) -> vec2: ...
    def __rsub__(self, other: float) -> vec2: ...
    def __mul__(self, other: vec2 | float) -> vec2: ...
    def __rmul__(self, other: float) -> vec2: ...
    def __floordiv__(self, other: vec2 | float) -> vec2: ...
    def __rfloordiv__(self, other: float) -> vec2: ...
    def __mod__(self, other: vec2 | float) -> vec2: ...
    def __rmod__(self, other: float) -> vec2: ...
    def __truediv__(self, other: vec2 | float) -> vec2: ...
    def __rtruediv__(self, other: float) -> vec2: ...
    def __pow__(self, other: vec2 | float) -> vec2: ...
    def __matmul__(self, other: mat2) -> vec2: ...
    def __neg__(self) -> vec2: ...
    def __pos__(self) -> vec2: ...
    x: float
    y: float
    xx: vec2
    xy: vec2
    yx: vec2
    yy: vec2
    xxx: vec3
    xxy: vec3
    xyx: vec3
    xyy: vec3
    yxx: vec3
    yxy: vec3
    yyx: vec3
    yyy: vec3
    xxxx: vec4
    xxxy: vec4
    xxyx: vec4
    xxyy: vec4
    xyxx: vec4
    xyxy: vec4
    xyyx: vec4
    xyyy: vec4
    yxxx: vec4
    yxxy: vec4
    yxyx: vec4
    yxyy: vec4
    yyxx: vec4
    yyxy: vec4
    yyyx: vec4
    yyyy: vec4
    r: float
    g: float
    rr: vec2
    rg: vec2
    gr: vec2
    gg: vec2
    rrr: vec3
    rrg: vec3
    rgr: vec3
    rgg: vec3
    grr: vec3
    grg: vec3
    ggr: vec3
    ggg: vec3
    rrrr: vec4
    rrrg: vec4
    rrgr: vec4
    rrgg: vec4
    rgrr: vec4
    rgrg: vec4
    rggr: vec4
    rggg: vec4
    grrr: vec4
    grrg: vec4
    grgr: vec4
    grgg: vec4
    ggrr: vec4
    ggrg: vec4
    gggr: vec4
    gggg: vec4

class vec3(Composite):
    shading_type: ClassVar[VectorType]
    @overload
    def __init__(self, a: float, /) -> None: ...
    @overload
    def __init__(self, a: vec3 | ivec3 | uvec3 | bvec3, /) -> None: ...
    @overload
    def __init__(self, a: float, b: float, c: float, /) -> None: ...
    @overload
    def __init__(self, a: float, b: vec2, /) -> None: ...
    @overload
    def __init__(self, a: vec2, b: float, /) -> None: ...
    def __get__(self, instance: object, owner: Any = None) -> vec3: ...
    def __set__(self, instance: object, value: vec3 | tuple[float, float, float] | list[float] | npt.NDArray[Any]) -> None: ...
    def __getitem__(self, index: int | uint) -> float: ...
    def __setitem__(self, index: int | uint, value: float) -> None: ...
    def __iter__(self) -> Iterator[float]: ...
    def __add__(self, other: vec3 | float) -> vec3: ...
    def __radd__(self, other: float) -> vec3: ...
    def __sub__(self, other: vec3 | float) -> vec3: ...
    def __rsub__(self, other: float) -> vec3: ...
    def __mul__(self, other: vec3 | float) -> vec3: ...
    def __rmul__(self, other: float) -> vec3: ...
    def __floordiv__(self, other: vec3 | float) -> vec3: ...
    def __rfloordiv__(self, other: float) -> vec3: ...
    def __mod__(self, other: vec3 | float) -> vec3: ...
    def __rmod__(self, other: float) -> vec3: ...
    def __truediv__(self, other: vec3 | float) -> vec3: ...
    def __rtruediv__(self, other: float) -> vec3: ...
    def __pow__(self, other: vec3 | float) -> vec3: ...
    def __matmul__(self, other: mat3) -> vec3: ...
    def __neg__(self) -> vec3: ...
    def __pos__(self) -> vec3: ...
    x: float
    y: float
    z: float
    xx: vec2
    xy: vec2
    xz: vec2
    yx: vec2
    yy: vec2
    yz: vec2
    zx: vec2
    zy: vec2
    zz: vec2
    xxx: vec3
    xxy: vec3
    xxz: vec3
    xyx: vec3
    xyy: vec3
    xyz: vec3
    xzx: vec3
    xzy: vec3
    xzz: vec3
    yxx: vec3
    yxy: vec3
    yxz: vec3
    yyx: vec3
    yyy: vec3
    yyz: vec3
    yzx: vec3
    yzy: vec3
    yzz: vec3
    zxx: vec3
    zxy: vec3
    zxz: vec3
    zyx: vec3
    zyy: vec3
    zyz: vec3
    zzx: vec3
    zzy: vec3
    zzz: vec3
    xxxx: vec4
    xxxy: vec4
    xxxz: vec4
    xxyx: vec4
    xxyy: vec4
    xxyz: vec4
    xxzx: vec4
    xxzy: vec4
    xxzz: vec4
    xyxx: vec4
    xyxy: vec4
    xyxz: vec4
    xyyx: vec4
    xyyy: vec4
    xyyz: vec4
    xyzx: vec4
    xyzy: vec4
    xyzz: vec4
    xzxx: vec4
    xzxy: vec4
    xzxz: vec4
    xzyx: vec4
    xzyy: vec4
    xzyz: vec4
    xzzx: vec4
    xzzy: vec4
    xzzz: vec4
    yxxx: vec4
    yxxy: vec4
    yxxz: vec4
    yxyx: vec4
    yxyy: vec4
    yxyz: vec4
    yxzx: vec4
    yxzy: vec4
    yxzz: vec4
    yyxx: vec4
    yyxy: vec4
    yyxz: vec4
    yyyx: vec4
    yyyy: vec4
    yyyz: vec4
    yyzx: vec4
    yyzy: vec4
    yyzz: vec4
    yzxx: vec4
    yzxy: vec4
    yzxz: vec4
    yzyx: vec4
    yzyy: vec4
    yzyz: vec4
    yzzx: vec4
    yzzy: vec4
    yzzz: vec4
    zxxx: vec4
    zxxy: vec4
    zxxz: vec4
    zxyx: vec4
    zxyy: vec4
    zxyz: vec4
    zxzx: vec4
    zxzy: vec4
    zxzz: vec4
    zyxx: vec4
    zyxy: vec4
    zyxz: vec4
    zyyx: vec4
    zyyy: vec4
    zyyz: vec4
    zyzx: vec4
    zyzy: vec4
    zyzz: vec4
    zzxx: vec4
    zzxy: vec4
    zzxz: vec4
    zzyx: vec4
    zzyy: vec4
    zzyz: vec4
    zzzx: vec4
    zzzy: vec4
    zzzz: vec4
    r: float
    g: float
    b: float
    rr: vec2
    rg: vec2
    rb: vec2
    gr: vec2
    gg: vec2
    gb: vec2
    br: vec2
    bg: vec2
    bb: vec2
    rrr: vec3
    rrg: vec3
    rrb: vec3
    rgr: vec3
    rgg: vec3
    rgb: vec3
    rbr: vec3
    rbg: vec3
    rbb: vec3
    grr: vec3
    grg: vec3
    grb: vec3
    ggr: vec3
    ggg: vec3
    ggb: vec3
    gbr: vec3
    gbg: vec3
    gbb: vec3
    brr: vec3
    brg: vec3
    brb: vec3
    bgr: vec3
    bgg: vec3
    bgb: vec3
    bbr: vec3
    bbg: vec3
    bbb: vec3
    rrrr: vec4
    rrrg: vec4
    rrrb: vec4
    rrgr: vec4
    rrgg: vec4
    rrgb: vec4
    rrbr: vec4
    rrbg: vec4
    rrbb: vec4
    rgrr: vec4
    rgrg: vec4
    rgrb: vec4
    rggr: vec4
    rggg: vec4
    rggb: vec4
    rgbr: vec4
    rgbg: vec4
    rgbb: vec4
    rbrr: vec4
    rbrg: vec4
    rbrb: vec4
    rbgr: vec4
    rbgg: vec4
    rbgb: vec4
    rbbr: vec4
    rbbg: vec4
    rbbb: vec4
    grrr: vec4
    grrg: vec4
    grrb: vec4
    grgr: vec4
    grgg: vec4
    grgb: vec4
    grbr: vec4
    grbg: vec4
    grbb: vec4
    ggrr: vec4
    ggrg: vec4
    ggrb: vec4
    gggr: vec4
    gggg: vec4
    gggb: vec4
    ggbr: vec4
    ggbg: vec4
    ggbb: vec4
    gbrr: vec4
    gbrg: vec4
    gbrb: vec4
    gbgr: vec4
    gbgg: vec4
    gbgb: vec4
    gbbr: vec4
    gbbg: vec4
    gbbb: vec4
    brrr: vec4
    brrg: vec4
    brrb: vec4
    brgr: vec4
    brgg: vec4
    brgb: vec4
    brbr: vec4
    brbg: vec4
    brbb: vec4
    bgrr: vec4
    bgrg: vec4
    bgrb: vec4
    bggr: vec4
    bggg: vec4
    bggb: vec4
    bgbr: vec4
    bgbg: vec4
    bgbb: vec4
    bbrr: vec4
    bbrg: vec4
    bbrb: vec4
    bbgr: vec4
    bbgg: vec4
    bbgb: vec4
    bbbr: vec4
    bbbg: vec4
    bbbb: vec4

class vec4(Composite):
    shading_type: ClassVar[VectorType]
    @overload
    def __init__(self, a: float, /) -> None: ...
    @overload
    def __init__(self, a: vec4 | ivec4 | uvec4 | bvec4, /) -> None: ...
    @overload
    def __init__(self, a: float, b: float, c: float, d: float, /) -> None: ...
    @overload
    def __init__(self, a: float, b: float, c: vec2, /) -> None: ...
    @overload
    def __init__(self, a: float, b: vec2, c: float, /) -> None: ...
    @overload
    def __init__(self, a: float, b: vec3, /) -> None: ...
    @overload
    def __init__(self, a: vec2, b: float, c: float, /) -> None: ...
    @overload
    def __init__(self, a: vec2, b: vec2, /) -> None: ...
    @overload
    def __init__(self, a: vec3, b: float, /) -> None: ...
    def __get__(self, instance: object, owner: Any = None) -> vec4: ...
    def __set__(self, instance: object, value: vec4 | tuple[float, float, float, float] | list[float] | npt.NDArray[Any]) -> None: ...
    def __getitem__(self, index: int | uint) -> float: ...
    def __setitem__(self, index: int | uint, value: float) -> None: ...
    def __iter__(self) -> Iterator[float]: ...
    def __add__(self, other: vec4 | float) -> vec4: ...
    def __radd__(self, other: float) -> vec4: ...
    def __sub__(self, other: vec4 | float) -> vec4: ...
    def __rsub__(self, other: float) -> vec4: ...
    def __mul__(self, other: vec4 | float) -> vec4: ...
    def __rmul__(self, other: float) -> vec4: ...
    def __floordiv__(self, other: vec4 | float) -> vec4: ...
    def __rfloordiv__(self, other: float) -> vec4: ...
    def __mod__(self, other: vec4 | float) -> vec4: ...
    def __rmod__(self, other: float) -> vec4: ...
    def __truediv__(self, other: vec4 | float) -> vec4: ...
    def __rtruediv__(self, other: float) -> vec4: ...
    def __pow__(self, other: vec4 | float) -> vec4: ...
    def __matmul__(self, other: mat4) -> vec4: ...
    def __neg__(self) -> vec4: ...
    def __pos__(self) -> vec4: ...
    x: float
    y: float
    z: float
    w: float
    xx: vec2
    xy: vec2
    xz: vec2
    xw: vec2
    yx: vec2
    yy: vec2
    yz: vec2
    yw: vec2
    zx: vec2
    zy: vec2
    zz: vec2
    zw: vec2
    wx: vec2
    wy: vec2
    wz: vec2
    ww: vec2
    xxx: vec3
    xxy: vec3
    xxz: vec3
    xxw: vec3
    xyx: vec3
    xyy: vec3
    xyz: vec3
    xyw: vec3
    xzx: vec3
    xzy: vec3
    xzz: vec3
    xzw: vec3
    xwx: vec3
    xwy: vec3
    xwz: vec3
    xww: vec3
    yxx: vec3
    yxy: vec3
    yxz: vec3
    yxw: vec3
    yyx: vec3
    yyy: vec3
    yyz: vec3
    yyw: vec3
    yzx: vec3
    yzy: vec3
    yzz: vec3
    yzw: vec3
    ywx: vec3
    ywy: vec3
    ywz: vec3
    yww: vec3
    zxx: vec3
    zxy: vec3
    zxz: vec3
    zxw: vec3
    zyx: vec3
    zyy: vec3
    zyz: vec3
    zyw: vec3
    zzx: vec3
    zzy: vec3
    zzz: vec3
    zzw: vec3
    zwx: vec3
    zwy: vec3
    zwz: vec3
    zww: vec3
    wxx: vec3
    wxy: vec3
    wxz: vec3
    wxw: vec3
    wyx: vec3
    wyy: vec3
    wyz: vec3
    wyw: vec3
    wzx: vec3
    wzy: vec3
    wzz: vec3
    wzw: vec3
    wwx: vec3
    wwy: vec3
    wwz: vec3
    www: vec3
    xxxx: vec4
    xxxy: vec4
    xxxz: vec4
    xxxw: vec4
    xxyx: vec4
    xxyy: vec4
    xxyz: vec4
    xxyw: vec4
    xxzx: vec4
    xxzy: vec4
    xxzz: vec4
    xxzw: vec4
    xxwx: vec4
    xxwy: vec4
    xxwz: vec4
    xxww: vec4
    xyxx: vec4
    xyxy: vec4
    xyxz: vec4
    xyxw: vec4
    xyyx: vec4
    xyyy: vec4
    xyyz: vec4
    xyyw: vec4
    xyzx: vec4
    xyzy: vec4
    xyzz: vec4
    xyzw: vec4
    xywx: vec4
    xywy: vec4
    xywz: vec4
    xyww: vec4
    xzxx: vec4
    xzxy: vec4
    xzxz: vec4
    xzxw: vec4
    xzyx: vec4
    xzyy: vec4
    xzyz: vec4
    xzyw: vec4
    xzzx: vec4
    xzzy: vec4
    xzzz: vec4
    xzzw: vec4
    xzwx: vec4
    xzwy: vec4
    xzwz: vec4
    xzww: vec4
    xwxx: vec4
    xwxy: vec4
    xwxz: vec4
    xwxw: vec4
    xwyx: vec4
    xwyy: vec4
    xwyz: vec4
    xwyw: vec4
    xwzx: vec4
    xwzy: vec4
    xwzz: vec4
    xwzw: vec4
    xwwx: vec4
    xwwy: vec4
    xwwz: vec4
    xwww: vec4
    yxxx: vec4
    yxxy: vec4
    yxxz: vec4
    yxxw: vec4
    yxyx: vec4
    yxyy: vec4
    yxyz: vec4
    yxyw: vec4
    yxzx: vec4
    yxzy: vec4
    yxzz: vec4
    yxzw: vec4
    yxwx: vec4
    yxwy: vec4
    yxwz: vec4
    yxww: vec4
    yyxx: vec4
    yyxy: vec4
    yyxz: vec4
    yyxw: vec4
    yyyx: vec4
    yyyy: vec4
    yyyz: vec4
    yyyw: vec4
    yyzx: vec4
    yyzy: vec4
    yyzz: vec4
    yyzw: vec4
    yywx: vec4
    yywy: vec4
    yywz: vec4
    yyww: vec4
    yzxx: vec4
    yzxy: vec4
    yzxz: vec4
    yzxw: vec4
    yzyx: vec4
    yzyy: vec4
    yzyz: vec4
    yzyw: vec4
    yzzx: vec4
    yzzy: vec4
    yzzz: vec4
    yzzw: vec4
    yzwx: vec4
    yzwy: vec4
    yzwz: vec4
    yzww: vec4
    ywxx: vec4
    ywxy: vec4
    ywxz: vec4
    ywxw: vec4
    ywyx: vec4
    ywyy: vec4
    ywyz: vec4
    ywyw: vec4
    ywzx: vec4
    ywzy: vec4
    ywzz: vec4
    ywzw: vec4
    ywwx: vec4
    ywwy: vec4
    ywwz: vec4
    ywww: vec4
    zxxx: vec4
    zxxy: vec4
    zxxz: vec4
    zxxw: vec4
    zxyx: vec4
    zxyy: vec4
    zxyz: vec4
    zxyw: vec4
    zxzx: vec4
    zxzy: vec4
    zxzz: vec4
    zxzw: vec4
    zxwx: vec4
    zxwy: vec4
    zxwz: vec4
    zxww: vec4
    zyxx: vec4
    zyxy: vec4
    zyxz: vec4
    zyxw: vec4
    zyyx: vec4
    zyyy: vec4
    zyyz: vec4
    zyyw: vec4
    zyzx: vec4
    zyzy: vec4
    zyzz: vec4
    zyzw: vec4
    zywx: vec4
    zywy: vec4
    zywz: vec4
    zyww: vec4
    zzxx: vec4
    zzxy: vec4
    zzxz: vec4
    zzxw: vec4
    zzyx: vec4
    zzyy: vec4
    zzyz: vec4
    zzyw: vec4
    zzzx: vec4
    zzzy: vec4
    zzzz: vec4
    zzzw: vec4
    zzwx: vec4
    zzwy: vec4
    zzwz: vec4
    zzww: vec4
    zwxx: vec4
    zwxy: vec4
    zwxz: vec4
    zwxw: vec4
    zwyx: vec4
    zwyy: vec4
    zwyz: vec4
    zwyw: vec4
    zwzx: vec4
    zwzy: vec4
    zwzz: vec4
    zwzw: vec4
    zwwx: vec4
    zwwy: vec4
    zwwz: vec4
    zwww: vec4
    wxxx: vec4
    wxxy: vec4
    wxxz: vec4
    wxxw: vec4
    wxyx: vec4
    wxyy: vec4
    wxyz: vec4
    wxyw: vec4
    wxzx: vec4
    wxzy: vec4
    wxzz: vec4
    wxzw: vec4
    wxwx: vec4
    wxwy: vec4
    wxwz: vec4
    wxww: vec4
    wyxx: vec4
    wyxy: vec4
    wyxz: vec4
    wyxw: vec4
    wyyx: vec4
    wyyy: vec4
    wyyz: vec4
    wyyw: vec4
    wyzx: vec4
    wyzy: vec4
    wyzz: vec4
    wyzw: vec4
    wywx: vec4
    wywy: vec4
    wywz: vec4
    wyww: vec4
    wzxx: vec4
    wzxy: vec4
    wzxz: vec4
    wzxw: vec4
    wzyx: vec4
    wzyy: vec4
    wzyz: vec4
    wzyw: vec4
    wzzx: vec4
    wzzy: vec4
    wzzz: vec4
    wzzw: vec4
    wzwx: vec4
    wzwy: vec4
    wzwz: vec4
    wzww: vec4
    wwxx: vec4
    wwxy: vec4
    wwxz: vec4
    wwxw: vec4
    wwyx: vec4
    wwyy: vec4
    wwyz: vec4
    wwyw: vec4
    wwzx: vec4
    wwzy: vec4
    wwzz: vec4
    wwzw: vec4
    wwwx: vec4
    wwwy: vec4
    wwwz: vec4
    wwww: vec4
    r: float
    g: float
    b: float
    a: float
    rr: vec2
    rg: vec2
    rb: vec2
    ra: vec2
    gr: vec2
    gg: vec2
    gb: vec2
    ga: vec2
    br: vec2
    bg: vec2
    bb: vec2
    ba: vec2
    ar: vec2
    ag: vec2
    ab: vec2
    aa: vec2
    rrr: vec3
    rrg: vec3
    rrb: vec3
    rra: vec3
    rgr: vec3
    rgg: vec3
    rgb: vec3
    rga: vec3
    rbr: vec3
    rbg: vec3
    rbb: vec3
    rba: vec3
    rar: vec3
    rag: vec3
    rab: vec3
    raa: vec3
    grr: vec3
    grg: vec3
    grb: vec3
    gra: vec3
    ggr: vec3
    ggg: vec3
    ggb: vec3
    gga: vec3
    gbr: vec3
    gbg: vec3
    gbb: vec3
    gba: vec3
    gar: vec3
    gag: vec3
    gab: vec3
    gaa: vec3
    brr: vec3
    brg: vec3
    brb: vec3
    bra: vec3
    bgr: vec3
    bgg: vec3
    bgb: vec3
    bga: vec3
    bbr: vec3
    bbg: vec3
    bbb: vec3
    bba: vec3
    bar: vec3
    bag: vec3
    bab: vec3
    baa: vec3
    arr: vec3
    arg: vec3
    arb: vec3
    ara: vec3
    agr: vec3
    agg: vec3
    agb: vec3
    aga: vec3
    abr: vec3
    abg: vec3
    abb: vec3
    aba: vec3
    aar: vec3
    aag: vec3
    aab: vec3
    aaa: vec3
    rrrr: vec4
    rrrg: vec4
    rrrb: vec4
    rrra: vec4
    rrgr: vec4
    rrgg: vec4
    rrgb: vec4
    rrga: vec4
    rrbr: vec4
    rrbg: vec4
    rrbb: vec4
    rrba: vec4
    rrar: vec4
    rrag: vec4
    rrab: vec4
    rraa: vec4
    rgrr: vec4
    rgrg: vec4
    rgrb: vec4
    rgra: vec4
    rggr: vec4
    rggg: vec4
    rggb: vec4
    rgga: vec4
    rgbr: vec4
    rgbg: vec4
    rgbb: vec4
    rgba: vec4
    rgar: vec4
    rgag: vec4
    rgab: vec4
    rgaa: vec4
    rbrr: vec4
    rbrg: vec4
    rbrb: vec4
    rbra: vec4
    rbgr: vec4
    rbgg: vec4
    rbgb: vec4
    rbga: vec4
    rbbr: vec4
    rbbg: vec4
    rbbb: vec4
    rbba: vec4
    rbar: vec4
    rbag: vec4
    rbab: vec4
    rbaa: vec4
    rarr: vec4
    rarg: vec4
    rarb: vec4
    rara: vec4
    ragr: vec4
    ragg: vec4
    ragb: vec4
    raga: vec4
    rabr: vec4
    rabg: vec4
    rabb: vec4
    raba: vec4
    raar: vec4
    raag: vec4
    raab: vec4
    raaa: vec4
    grrr: vec4
    grrg: vec4
    grrb: vec4
    grra: vec4
    grgr: vec4
    grgg: vec4
    grgb: vec4
    grga: vec4
    grbr: vec4
    grbg: vec4
    grbb: vec4
    grba: vec4
    grar: vec4
    grag: vec4
    grab: vec4
    graa: vec4
    ggrr: vec4
    ggrg: vec4
    ggrb: vec4
    ggra: vec4
    gggr: vec4
    gggg: vec4
    gggb: vec4
    ggga: vec4
    ggbr: vec4
    ggbg: vec4
    ggbb: vec4
    ggba: vec4
    ggar: vec4
    ggag: vec4
    ggab: vec4
    ggaa: vec4
    gbrr: vec4
    gbrg: vec4
    gbrb: vec4
    gbra: vec4
    gbgr: vec4
    gbgg: vec4
    gbgb: vec4
    gbga: vec4
    gbbr: vec4
    gbbg: vec4
    gbbb: vec4
    gbba: vec4
    gbar: vec4
    gbag: vec4
    gbab: vec4
    gbaa: vec4
    garr: vec4
    garg: vec4
    garb: vec4
    gara: vec4
    gagr: vec4
    gagg: vec4
    gagb: vec4
    gaga: vec4
    gabr: vec4
    gabg: vec4
    gabb: vec4
    gaba: vec4
    gaar: vec4
    gaag: vec4
    gaab: vec4
    gaaa: vec4
    brrr: vec4
    brrg: vec4
    brrb: vec4
    brra: vec4
    brgr: vec4
    brgg: vec4
    brgb: vec4
    brga: vec4
    brbr: vec4
    brbg: vec4
    brbb: vec4
    brba: vec4
    brar: vec4
    brag: vec4
    brab: vec4
    braa: vec4
    bgrr: vec4
    bgrg: vec4
    bgrb: vec4
    bgra: vec4
    bggr: vec4
    bggg: vec4
    bggb: vec4
    bgga: vec4
    bgbr: vec4
    bgbg: vec4
    bgbb: vec4
    bgba: vec4
    bgar: vec4
    bgag: vec4
    bgab: vec4
    bgaa: vec4
    bbrr: vec4
    bbrg: vec4
    bbrb: vec4
    bbra: vec4
    bbgr: vec4
    bbgg: vec4
    bbgb: vec4
    bbga: vec4
    bbbr: vec4
    bbbg: vec4
    bbbb: vec4
    bbba: vec4
    bbar: vec4
    bbag: vec4
    bbab: vec4
    bbaa: vec4
    barr: vec4
    barg: vec4
    barb: vec4
    bara: vec4
    bagr: vec4
    bagg: vec4
    bagb: vec4
    baga: vec4
    babr: vec4
    babg: vec4
    babb: vec4
    baba: vec4
    baar: vec4
    baag: vec4
    baab: vec4
    baaa: vec4
    arrr: vec4
    arrg: vec4
    arrb: vec4
    arra: vec4
    argr: vec4
    argg: vec4
    argb: vec4
    arga: vec4
    arbr: vec4
    arbg: vec4
    arbb: vec4
    arba: vec4
    arar: vec4
    arag: vec4
    arab: vec4
    araa: vec4
    agrr: vec4
    agrg: vec4
    agrb: vec4
    agra: vec4
    aggr: vec4
    aggg: vec4
    aggb: vec4
    agga: vec4
    agbr: vec4
    agbg: vec4
    agbb: vec4
    agba: vec4
    agar: vec4
    agag: vec4
    agab: vec4
    agaa: vec4
    abrr: vec4
    abrg: vec4
    abrb: vec4
    abra: vec4
    abgr: vec4
    abgg: vec4
    abgb: vec4
    abga: vec4
    abbr: vec4
    abbg: vec4
    abbb: vec4
    abba: vec4
    abar: vec4
    abag: vec4
    abab: vec4
    abaa: vec4
    aarr: vec4
    aarg: vec4
    aarb: vec4
    aara: vec4
    aagr: vec4
    aagg: vec4
    aagb: vec4
    aaga: vec4
    aabr: vec4
    aabg: vec4
    aabb: vec4
    aaba: vec4
    aaar: vec4
    aaag: vec4
    aaab: vec4
    aaaa: vec4

class ivec2(Composite):
    shading_type: ClassVar[VectorType]
    @overload
    def __init__(self, a: int, /) -> None: ...
    @overload
    def __init__(self, a: vec2 | ivec2 | uvec2 | bvec2, /) -> None: ...
    @overload
    def __init__(self, a: int, b: int, /) -> None: ...
    def __get__(self, instance: object, owner: Any = None) -> ivec2: ...
    def __set__(self, instance: object, value: ivec2 | tuple[int, int] | list[int] | npt.NDArray[Any]) -> None: ...
    def __getitem__(self, index: int | uint) -> int: ...
    def __setitem__(self, index: int | uint, value: int) -> None: ...
    def __iter__(self) -> Iterator[int]: ...
    def __add__(self, other: ivec2 | int) -> ivec2: ...
    def __radd__(self, other: int) -> ivec2: ...
    def __sub__(self, other: ivec2 | int) -> ivec2: ...
    def __rsub__(self, other: int) -> ivec2: ...
    def __mul__(self, other: ivec2 | int) -> ivec2: ...
    def __rmul__(self, other: int) -> ivec2: ...
    def __floordiv__(self, other: ivec2 | int) -> ivec2: ...
    def __rfloordiv__(self, other: int) -> ivec2: ...
    def __mod__(self, other: ivec2 | int) -> ivec2: ...
    def __rmod__(self, other: int) -> ivec2: ...
    def __and__(self, other: ivec2 | int) -> ivec2: ...
    def __rand__(self, other: int) -> ivec2: ...
    def __or__(self, other: ivec2 | int) -> ivec2: ...
    def __ror__(self, other: int) -> ivec2: ...
    def __xor__(self, other: ivec2 | int) -> ivec2: ...
    def __rxor__(self, other: int) -> ivec2: ...
    def __truediv__(self, other: ivec2 | int | float) -> vec2: ...
    def __rtruediv__(self, other: float) -> vec2: ...
    def __pow__(self, other: int) -> ivec2: ...
    def __lshift__(self, other: ivec2 | uvec2 | int | uint) -> ivec2: ...
    def __rshift__(self, other: ivec2 | uvec2 | int | uint) -> ivec2: ...
    def __invert__(self) -> ivec2: ...
    def __neg__(self) -> ivec2: ...
    def __pos__(self) -> ivec2: ...
    x: int
    y: int
    xx: ivec2
    xy: ivec2
    yx: ivec2
    yy: ivec2
    xxx: ivec3
    xxy: ivec3
    xyx: ivec3
    xyy: ivec3
    yxx: ivec3
    yxy: ivec3
    yyx: ivec3
    yyy: ivec3
    xxxx: ivec4
    xxxy: ivec4
    xxyx: ivec4
    xxyy: ivec4
    xyxx: ivec4
    xyxy: ivec4
    xyyx: ivec4
    xyyy: ivec4
    yxxx: ivec4
    yxxy: ivec4
    yxyx: ivec4
    yxyy: ivec4
    yyxx: ivec4
    yyxy: ivec4
    yyyx: ivec4
    yyyy: ivec4
    r: int
    g: int
    rr: ivec2
    rg: ivec2
    gr: ivec2
    gg: ivec2
    rrr: ivec3
    rrg: ivec3
    rgr: ivec3
    rgg: ivec3
    grr: ivec3
    grg: ivec3
    ggr: ivec3
    ggg: ivec3
    rrrr: ivec4
    rrrg: ivec4
    rrgr: ivec4
    rrgg: ivec4
    rgrr: ivec4
    rgrg: ivec4
    rggr: ivec4
    rggg: ivec4
    grrr: ivec4
    grrg: ivec4
    grgr: ivec4
    grgg: ivec4
    ggrr: ivec4
    ggrg: ivec4
    gggr: ivec4
    gggg: ivec4

class ivec3(Composite):
    shading_type: ClassVar[VectorType]
    @overload
    def __init__(self, a: int, /) -> None: ...
    @overload
    def __init__(self, a: vec3 | ivec3 | uvec3 | bvec3, /) -> None: ...
    @overload
    def __init__(self, a: int, b: int, c: int, /) -> None: ...
    @overload
    def __init__(self, a: int, b: ivec2, /) -> None: ...
    @overload
    def __init__(self, a: ivec2, b: int, /) -> None: ...
    def __get__(self, instance: object, owner: Any = None) -> ivec3: ...
    def __set__(self, instance: object, value: ivec3 | tuple[int, int, int] | list[int] | npt.NDArray[Any]) -> None: ...
    def __getitem__(self, index: int | uint) -> int: ...
    def __setitem__(self, index: int | uint, value: int) -> None: ...
    def __iter__(self) -> Iterator[int]: ...
    def __add__(self, other: ivec3 | int) -> ivec3: ...
    def __radd__(self, other: int) -> ivec3: ...
    def __sub__(self, other: ivec3 | int) -> ivec3: ...
    def __rsub__(self, other: int) -> ivec3: ...
    def __mul__(self, other: ivec3 | int) -> ivec3: ...
    def __rmul__(self, other: int) -> ivec3: ...
    def __floordiv__(self, other: ivec3 | int) -> ivec3: ...
    def __rfloordiv__(self, other: int) -> ivec3: ...
    def __mod__(self, other: ivec3 | int) -> ivec3: ...
    def __rmod__(self, other: int) -> ivec3: ...
    def __and__(self, other: ivec3 | int) -> ivec3: ...
    def __rand__(self, other: int) -> ivec3: ...
    def __or__(self, other: ivec3 | int) -> ivec3: ...
    def __ror__(self, other: int) -> ivec3: ...
    def __xor__(self, other: ivec3 | int) -> ivec3: ...
    def __rxor__(self, other: int) -> ivec3: ...
    def __truediv__(self, other: ivec3 | int | float) -> vec3: ...
    def __rtruediv__(self, other: float) -> vec3: ...
    def __pow__(self, other: int) -> ivec3: ...
    def __lshift__(self, other: ivec3 | uvec3 | int | uint) -> ivec3: ...
    def __rshift__(self, other: ivec3 | uvec3 | int | uint) -> ivec3: ...
    def __invert__(self) -> ivec3: ...
    def __neg__(self) -> ivec3: ...
    def __pos__(self) -> ivec3: ...
    x: int
    y: int
    z: int
    xx: ivec2
    xy: ivec2
    xz: ivec2
    yx: ivec2
    yy: ivec2
    yz: ivec2
    zx: ivec2
    zy: ivec2
    zz: ivec2
    xxx: ivec3
    xxy: ivec3
    xxz: ivec3
    xyx: ivec3
    xyy: ivec3
    xyz: ivec3
    xzx: ivec3
    xzy: ivec3
    xzz: ivec3
    yxx: ivec3
    yxy: ivec3
    yxz: ivec3
    yyx: ivec3
    yyy: ivec3
    yyz: ivec3
    yzx: ivec3
    yzy: ivec3
    yzz: ivec3
    zxx: ivec3
    zxy: ivec3
    zxz: ivec3
    zyx: ivec3
    zyy: ivec3
    zyz: ivec3
    zzx: ivec3
    zzy: ivec3
    zzz: ivec3
    xxxx: ivec4
    xxxy: ivec4
    xxxz: ivec4
    xxyx: ivec4
    xxyy: ivec4
    xxyz: ivec4
    xxzx: ivec4
    xxzy: ivec4
    xxzz: ivec4
    xyxx: ivec4
    xyxy: ivec4
    xyxz: ivec4
    xyyx: ivec4
    xyyy: ivec4
    xyyz: ivec4
    xyzx: ivec4
    xyzy: ivec4
    xyzz: ivec4
    xzxx: ivec4
    xzxy: ivec4
    xzxz: ivec4
    xzyx: ivec4
    xzyy: ivec4
    xzyz: ivec4
    xzzx: ivec4
    xzzy: ivec4
    xzzz: ivec4
    yxxx: ivec4
    yxxy: ivec4
    yxxz: ivec4
    yxyx: ivec4
    yxyy: ivec4
    yxyz: ivec4
    yxzx: ivec4
    yxzy: ivec4
    yxzz: ivec4
    yyxx: ivec4
    yyxy: ivec4
    yyxz: ivec4
    yyyx: ivec4
    yyyy: ivec4
    yyyz: ivec4
    yyzx: ivec4
    yyzy: ivec4
    yyzz: ivec4
    yzxx: ivec4
    yzxy: ivec4
    yzxz: ivec4
    yzyx: ivec4
    yzyy: ivec4
    yzyz: ivec4
    yzzx: ivec4
    yzzy: ivec4
    yzzz: ivec4
    zxxx: ivec4
    zxxy: ivec4
    zxxz: ivec4
    zxyx: ivec4
    zxyy: ivec4
    zxyz: ivec4
    zxzx: ivec4
    zxzy: ivec4
    zxzz: ivec4
    zyxx: ivec4
    zyxy: ivec4
    zyxz: ivec4
    zyyx: ivec4
    zyyy: ivec4
    zyyz: ivec4
    zyzx: ivec4
    zyzy: ivec4
    zyzz: ivec4
    zzxx: ivec4
    zzxy: ivec4
    zzxz: ivec4
    zzyx: ivec4
    zzyy: ivec4
    zzyz: ivec4
    zzzx: ivec4
    zzzy: ivec4
    zzzz: ivec4
    r: int
    g: int
    b: int
    rr: ivec2
    rg: ivec2
    rb: ivec2
    gr: ivec2
    gg: ivec2
    gb: ivec2
    br: ivec2
    bg: ivec2
    bb: ivec2
    rrr: ivec3
    rrg: ivec3
    rrb: ivec3
    rgr: ivec3
    rgg: ivec3
    rgb: ivec3
    rbr: ivec3
    rbg: ivec3
    rbb: ivec3
    grr: ivec3
    grg: ivec3
    grb: ivec3
    ggr: ivec3
    ggg: ivec3
    ggb: ivec3
    gbr: ivec3
    gbg: ivec3
    gbb: ivec3
    brr: ivec3
    brg: ivec3
    brb: ivec3
    bgr: ivec3
    bgg: ivec3
    bgb: ivec3
    bbr: ivec3
    bbg: ivec3
    bbb: ivec3
    rrrr: ivec4
    rrrg: ivec4
    rrrb: ivec4
    rrgr: ivec4
    rrgg: ivec4
    rrgb: ivec4
    rrbr: ivec4
    rrbg: ivec4
    rrbb: ivec4
    rgrr: ivec4
    rgrg: ivec4
    rgrb: ivec4
    rggr: ivec4
    rggg: ivec4
    rggb: ivec4
    rgbr: ivec4
    rgbg: ivec4
    rgbb: ivec4
    rbrr: ivec4
    rbrg: ivec4
    rbrb: ivec4
    rbgr: ivec4
    rbgg: ivec4
    rbgb: ivec4
    rbbr: ivec4
    rbbg: ivec4
    rbbb: ivec4
    grrr: ivec4
    grrg: ivec4
    grrb: ivec4
    grgr: ivec4
    grgg: ivec4
    grgb: ivec4
    grbr: ivec4
    grbg: ivec4
    grbb: ivec4
    ggrr: ivec4
    ggrg: ivec4
    ggrb: ivec4
    gggr: ivec4
    gggg: ivec4
    gggb: ivec4
    ggbr: ivec4
    ggbg: ivec4
    ggbb: ivec4
    gbrr: ivec4
    gbrg: ivec4
    gbrb: ivec4
    gbgr: ivec4
    gbgg: ivec4
    gbgb: ivec4
    gbbr: ivec4
    gbbg: ivec4
    gbbb: ivec4
    brrr: ivec4
    brrg: ivec4
    brrb: ivec4
    brgr: ivec4
    brgg: ivec4
    brgb: ivec4
    brbr: ivec4
    brbg: ivec4
    brbb: ivec4
    bgrr: ivec4
    bgrg: ivec4
    bgrb: ivec4
    bggr: ivec4
    bggg: ivec4
    bggb: ivec4
    bgbr: ivec4
    bgbg: ivec4
    bgbb: ivec4
    bbrr: ivec4
    bbrg: ivec4
    bbrb: ivec4
    bbgr: ivec4
    bbgg: ivec4
    bbgb: ivec4
    bbbr: ivec4
    bbbg: ivec4
    bbbb: ivec4

class ivec4(Composite):
    shading_type: ClassVar[VectorType]
    @overload
    def __init__(self, a: int, /) -> None: ...
    @overload
    def __init__(self, a: vec4 | ivec4 | uvec4 | bvec4, /) -> None: ...
    @overload
    def __init__(self, a: int, b: int, c: int, d: int, /) -> None: ...
    @overload
    def __init__(self, a: int, b: int, c: ivec2, /) -> None: ...
    @overload
    def __init__(self, a: int, b: ivec2, c: int, /) -> None: ...
    @overload
    def __init__(self, a: int, b: ivec3, /) -> None: ...
    @overload
    def __init__(self, a: ivec2, b: int, c: int, /) -> None: ...
    @overload
    def __init__(self, a: ivec2, b: ivec2, /) -> None: ...
    @overload
    def __init__(self, a: ivec3, b: int, /) -> None: ...
    def __get__(self, instance: object, owner: Any = None) -> ivec4: ...
    def __set__(self, instance: object, value: ivec4 | tuple[int, int, int, int] | list[int] | npt.NDArray[Any]) -> None: ...
    def __getitem__(self, index: int | uint) -> int: ...
    def __setitem__(self, index: int | uint, value: int) -> None: ...
    def __iter__(self) -> Iterator[int]: ...
    def __add__(self, other: ivec4 | int) -> ivec4: ...
    def __radd__(self, other: int) -> ivec4: ...
    def __sub__(self, other: ivec4 | int) -> ivec4: ...
    def __rsub__(self, other: int) -> ivec4: ...
    def __mul__(self, other: ivec4 | int) -> ivec4: ...
    def __rmul__(self, other: int) -> ivec4: ...
    def __floordiv__(self, other: ivec4 | int) -> ivec4: ...
    def __rfloordiv__(self, other: int) -> ivec4: ...
    def __mod__(self, other: ivec4 | int) -> ivec4: ...
    def __rmod__(self, other: int) -> ivec4: ...
    def __and__(self, other: ivec4 | int) -> ivec4: ...
    def __rand__(self, other: int) -> ivec4: ...
    def __or__(self, other: ivec4 | int) -> ivec4: ...
    def __ror__(self, other: int) -> ivec4: ...
    def __xor__(self, other: ivec4 | int) -> ivec4: ...
    def __rxor__(self, other: int) -> ivec4: ...
    def __truediv__(self, other: ivec4 | int | float) -> vec4: ...
    def __rtruediv__(self, other: float) -> vec4: ...
    def __pow__(self, other: int) -> ivec4: ...
    def __lshift__(self, other: ivec4 | uvec4 | int | uint) -> ivec4: ...
    def __rshift__(self, other: ivec4 | uvec4 | int | uint) -> ivec4: ...
    def __invert__(self) -> ivec4: ...
    def __neg__(self) -> ivec4: ...
    def __pos__(self) -> ivec4: ...
    x: int
    y: int
    z: int
    w: int
    xx: ivec2
    xy: ivec2
    xz: ivec2
    xw: ivec2
    yx: ivec2
    yy: ivec2
    yz: ivec2
    yw: ivec2
    zx: ivec2
    zy: ivec2
    zz: ivec2
    zw: ivec2
    wx: ivec2
    wy: ivec2
    wz: ivec2
    ww: ivec2
    xxx: ivec3
    xxy: ivec3
    xxz: ivec3
    xxw: ivec3
    xyx: ivec3
    xyy: ivec3
    xyz: ivec3
    xyw: ivec3
    xzx: ivec3
    xzy: ivec3
    xzz: ivec3
    xzw: ivec3
    xwx: ivec3
    xwy: ivec3
    xwz: ivec3
    xww: ivec3
    yxx: ivec3
    yxy: ivec3
    yxz: ivec3
    yxw: ivec3
    yyx: ivec3
    yyy: ivec3
    yyz: ivec3
    yyw: ivec3
    yzx: ivec3
    yzy: ivec3
    yzz: ivec3
    yzw: ivec3
    ywx: ivec3
    ywy: ivec3
    ywz: ivec3
    yww: ivec3
    zxx: ivec3
    zxy: ivec3
    zxz: ivec3
    zxw: ivec3
    zyx: ivec3
    zyy: ivec3
    zyz: ivec3
    zyw: ivec3
    zzx: ivec3
    zzy: ivec3
    zzz: ivec3
    zzw: ivec3
    zwx: ivec3
    zwy: ivec3
    zwz: ivec3
    zww: ivec3
    wxx: ivec3
    wxy: ivec3
    wxz: ivec3
    wxw: ivec3
    wyx: ivec3
    wyy: ivec3
    wyz: ivec3
    wyw: ivec3
    wzx: ivec3
    wzy: ivec3
    wzz: ivec3
    wzw: ivec3
    wwx: ivec3
    wwy: ivec3
    wwz: ivec3
    www: ivec3
    xxxx: ivec4
    xxxy: ivec4
    xxxz: ivec4
    xxxw: ivec4
    xxyx: ivec4
    xxyy: ivec4
    xxyz: ivec4
    xxyw: ivec4
    xxzx: ivec4
    xxzy: ivec4
    xxzz: ivec4
    xxzw: ivec4
    xxwx: ivec4
    xxwy: ivec4
    xxwz: ivec4
    xxww: ivec4
    xyxx: ivec4
    xyxy: ivec4
    xyxz: ivec4
    xyxw: ivec4
    xyyx: ivec4
    xyyy: ivec4
    xyyz: ivec4
    xyyw: ivec4
    xyzx: ivec4
    xyzy: ivec4
    xyzz: ivec4
    xyzw: ivec4
    xywx: ivec4
    xywy: ivec4
    xywz: ivec4
    xyww: ivec4
    xzxx: ivec4
    xzxy: ivec4
    xzxz: ivec4
    xzxw: ivec4
    xzyx: ivec4
    xzyy: ivec4
    xzyz: ivec4
    xzyw: ivec4
    xzzx: ivec4
    xzzy: ivec4
    xzzz: ivec4
    xzzw: ivec4
    xzwx: ivec4
    xzwy: ivec4
    xzwz: ivec4
    xzww: ivec4
    xwxx: ivec4
    xwxy: ivec4
    xwxz: ivec4
    xwxw: ivec4
    xwyx: ivec4
    xwyy: ivec4
    xwyz: ivec4
    xwyw: ivec4
    xwzx: ivec4
    xwzy: ivec4
    xwzz: ivec4
    xwzw: ivec4
    xwwx: ivec4
    xwwy: ivec4
    xwwz: ivec4
    xwww: ivec4
    yxxx: ivec4
    yxxy: ivec4
    yxxz: ivec4
    yxxw: ivec4
    yxyx: ivec4
    yxyy: ivec4
    yxyz: ivec4
    yxyw: ivec4
    yxzx: ivec4
    yxzy: ivec4
    yxzz: ivec4
    yxzw: ivec4
    yxwx: ivec4
    yxwy: ivec4
    yxwz: ivec4
    yxww: ivec4
    yyxx: ivec4
    yyxy: ivec4
    yyxz: ivec4
    yyxw: ivec4
    yyyx: ivec4
    yyyy: ivec4
    yyyz: ivec4
    yyyw: ivec4
    yyzx: ivec4
    yyzy: ivec4
    yyzz: ivec4
    yyzw: ivec4
    yywx: ivec4
    yywy: ivec4
    yywz: ivec4
    yyww: ivec4
    yzxx: ivec4
    yzxy: ivec4
    yzxz: ivec4
    yzxw: ivec4
    yzyx: ivec4
    yzyy: ivec4
    yzyz: ivec4
    yzyw: ivec4
    yzzx: ivec4
    yzzy: ivec4
    yzzz: ivec4
    yzzw: ivec4
    yzwx: ivec4
    yzwy: ivec4
    yzwz: ivec4
    yzww: ivec4
    ywxx: ivec4
    ywxy: ivec4
    ywxz: ivec4
    ywxw: ivec4
    ywyx: ivec4
    ywyy: ivec4
    ywyz: ivec4
    ywyw: ivec4
    ywzx: ivec4
    ywzy: ivec4
    ywzz: ivec4
    ywzw: ivec4
    ywwx: ivec4
    ywwy: ivec4
    ywwz: ivec4
    ywww: ivec4
    zxxx: ivec4
    zxxy: ivec4
    zxxz: ivec4
    zxxw: ivec4
    zxyx: ivec4
    zxyy: ivec4
    zxyz: ivec4
    zxyw: ivec4
    zxzx: ivec4
    zxzy: ivec4
    zxzz: ivec4
    zxzw: ivec4
    zxwx: ivec4
    zxwy: ivec4
    zxwz: ivec4
    zxww: ivec4
    zyxx: ivec4
    zyxy: ivec4
    zyxz: ivec4
    zyxw: ivec4
    zyyx: ivec4
    zyyy: ivec4
    zyyz: ivec4
    zyyw: ivec4
    zyzx: ivec4
    zyzy: ivec4
    zyzz: ivec4
    zyzw: ivec4
    zywx: ivec4
    zywy: ivec4
    zywz: ivec4
    zyww: ivec4
    zzxx: ivec4
    zzxy: ivec4
    zzxz: ivec4
    zzxw: ivec4
    zzyx: ivec4
    zzyy: ivec4
    zzyz: ivec4
    zzyw: ivec4
    zzzx: ivec4
    zzzy: ivec4
    zzzz: ivec4
    zzzw: ivec4
    zzwx: ivec4
    zzwy: ivec4
    zzwz: ivec4
    zzww: ivec4
    zwxx: ivec4
    zwxy: ivec4
    zwxz: ivec4
    zwxw: ivec4
    zwyx: ivec4
    zwyy: ivec4
    zwyz: ivec4
    zwyw: ivec4
    zwzx: ivec4
    zwzy: ivec4
    zwzz: ivec4
    zwzw: ivec4
    zwwx: ivec4
    zwwy: ivec4
    zwwz: ivec4
    zwww: ivec4
    wxxx: ivec4
    wxxy: ivec4
    wxxz: ivec4
    wxxw: ivec4
    wxyx: ivec4
    wxyy: ivec4
    wxyz: ivec4
    wxyw: ivec4
    wxzx: ivec4
    wxzy: ivec4
    wxzz: ivec4
    wxzw: ivec4
    wxwx: ivec4
    wxwy: ivec4
    wxwz: ivec4
    wxww: ivec4
    wyxx: ivec4
    wyxy: ivec4
    wyxz: ivec4
    wyxw: ivec4
    wyyx: ivec4
    wyyy: ivec4
    wyyz: ivec4
    wyyw: ivec4
    wyzx: ivec4
    wyzy: ivec4
    wyzz: ivec4
    wyzw: ivec4
    wywx: ivec4
    wywy: ivec4
    wywz: ivec4
    wyww: ivec4
    wzxx: ivec4
    wzxy: ivec4
    wzxz: ivec4
    wzxw: ivec4
    wzyx: ivec4
    wzyy: ivec4
    wzyz: ivec4
    wzyw: ivec4
    wzzx: ivec4
    wzzy: ivec4
    wzzz: ivec4
    wzzw: ivec4
    wzwx: ivec4
    wzwy: ivec4
    wzwz: ivec4
    wzww: ivec4
    wwxx: ivec4
    wwxy: ivec4
    wwxz: ivec4
    wwxw: ivec4
    wwyx: ivec4
    wwyy: ivec4
    wwyz: ivec4
    wwyw: ivec4
    wwzx: ivec4
    wwzy: ivec4
    wwzz: ivec4
    wwzw: ivec4
    wwwx: ivec4
    wwwy: ivec4
    wwwz: ivec4
    wwww: ivec4
    r: int
    g: int
    b: int
    a: int
    rr: ivec2
    rg: ivec2
    rb: ivec2
    ra: ivec2
    gr: ivec2
    gg: ivec2
    gb: ivec2
    ga: ivec2
    br: ivec2
    bg: ivec2
    bb: ivec2
    ba: ivec2
    ar: ivec2
    ag: ivec2
    ab: ivec2
    aa: ivec2
    rrr: ivec3
    rrg: ivec3
    rrb: ivec3
    rra: ivec3
    rgr: ivec3
    rgg: ivec3
    rgb: ivec3
    rga: ivec3
    rbr: ivec3
    rbg: ivec3
    rbb: ivec3
    rba: ivec3
    rar: ivec3
    rag: ivec3
    rab: ivec3
    raa: ivec3
    grr: ivec3
    grg: ivec3
    grb: ivec3
    gra: ivec3
    ggr: ivec3
    ggg: ivec3
    ggb: ivec3
    gga: ivec3
    gbr: ivec3
    gbg: ivec3
    gbb: ivec3
    gba: ivec3
    gar: ivec3
    gag: ivec3
    gab: ivec3
    gaa: ivec3
    brr: ivec3
    brg: ivec3
    brb: ivec3
    bra: ivec3
    bgr: ivec3
    bgg: ivec3
    bgb: ivec3
    bga: ivec3
    bbr: ivec3
    bbg: ivec3
    bbb: ivec3
    bba: ivec3
    bar: ivec3
    bag: ivec3
    bab: ivec3
    baa: ivec3
    arr: ivec3
    arg: ivec3
    arb: ivec3
    ara: ivec3
    agr: ivec3
    agg: ivec3
    agb: ivec3
    aga: ivec3
    abr: ivec3
    abg: ivec3
    abb: ivec3
    aba: ivec3
    aar: ivec3
    aag: ivec3
    aab: ivec3
    aaa: ivec3
    rrrr: ivec4
    rrrg: ivec4
    rrrb: ivec4
    rrra: ivec4
    rrgr: ivec4
    rrgg: ivec4
    rrgb: ivec4
    rrga: ivec4
    rrbr: ivec4
    rrbg: ivec4
    rrbb: ivec4
    rrba: ivec4
    rrar: ivec4
    rrag: ivec4
    rrab: ivec4
    rraa: ivec4
    rgrr: ivec4
    rgrg: ivec4
    rgrb: ivec4
    rgra: ivec4
    rggr: ivec4
    rggg: ivec4
    rggb: ivec4
    rgga: ivec4
    rgbr: ivec4
    rgbg: ivec4
    rgbb: ivec4
    rgba: ivec4
    rgar: ivec4
    rgag: ivec4
    rgab: ivec4
    rgaa: ivec4
    rbrr: ivec4
    rbrg: ivec4
    rbrb: ivec4
    rbra: ivec4
    rbgr: ivec4
    rbgg: ivec4
    rbgb: ivec4
    rbga: ivec4
    rbbr: ivec4
    rbbg: ivec4
    rbbb: ivec4
    rbba: ivec4
    rbar: ivec4
    rbag: ivec4
    rbab: ivec4
    rbaa: ivec4
    rarr: ivec4
    rarg: ivec4
    rarb: ivec4
    rara: ivec4
    ragr: ivec4
    ragg: ivec4
    ragb: ivec4
    raga: ivec4
    rabr: ivec4
    rabg: ivec4
    rabb: ivec4
    raba: ivec4
    raar: ivec4
    raag: ivec4
    raab: ivec4
    raaa: ivec4
    grrr: ivec4
    grrg: ivec4
    grrb: ivec4
    grra: ivec4
    grgr: ivec4
    grgg: ivec4
    grgb: ivec4
    grga: ivec4
    grbr: ivec4
    grbg: ivec4
    grbb: ivec4
    grba: ivec4
    grar: ivec4
    grag: ivec4
    grab: ivec4
    graa: ivec4
    ggrr: ivec4
    ggrg: ivec4
    ggrb: ivec4
    ggra: ivec4
    gggr: ivec4
    gggg: ivec4
    gggb: ivec4
    ggga: ivec4
    ggbr: ivec4
    ggbg: ivec4
    ggbb: ivec4
    ggba: ivec4
    ggar: ivec4
    ggag: ivec4
    ggab: ivec4
    ggaa: ivec4
    gbrr: ivec4
    gbrg: ivec4
    gbrb: ivec4
    gbra: ivec4
    gbgr: ivec4
    gbgg: ivec4
    gbgb: ivec4
    gbga: ivec4
    gbbr: ivec4
    gbbg: ivec4
    gbbb: ivec4
    gbba: ivec4
    gbar: ivec4
    gbag: ivec4
    gbab: ivec4
    gbaa: ivec4
    garr: ivec4
    garg: ivec4
    garb: ivec4
    gara: ivec4
    gagr: ivec4
    gagg: ivec4
    gagb: ivec4
    gaga: ivec4
    gabr: ivec4
    gabg: ivec4
    gabb: ivec4
    gaba: ivec4
    gaar: ivec4
    gaag: ivec4
    gaab: ivec4
    gaaa: ivec4
    brrr: ivec4
    brrg: ivec4
    brrb: ivec4
    brra: ivec4
    brgr: ivec4
    brgg: ivec4
    brgb: ivec4
    brga: ivec4
    brbr: ivec4
    brbg: ivec4
    brbb: ivec4
    brba: ivec4
    brar: ivec4
    brag: ivec4
    brab: ivec4
    braa: ivec4
    bgrr: ivec4
    bgrg: ivec4
    bgrb: ivec4
    bgra: ivec4
    bggr: ivec4
    bggg: ivec4
    bggb: ivec4
    bgga: ivec4
    bgbr: ivec4
    bgbg: ivec4
    bgbb: ivec4
    bgba: ivec4
    bgar: ivec4
    bgag: ivec4
    bgab: ivec4
    bgaa: ivec4
    bbrr: ivec4
    bbrg: ivec4
    bbrb: ivec4
    bbra: ivec4
    bbgr: ivec4
    bbgg: ivec4
    bbgb: ivec4
    bbga: ivec4
    bbbr: ivec4
    bbbg: ivec4
    bbbb: ivec4
    bbba: ivec4
    bbar: ivec4
    bbag: ivec4
    bbab: ivec4
    bbaa: ivec4
    barr: ivec4
    barg: ivec4
    barb: ivec4
    bara: ivec4
    bagr: ivec4
    bagg: ivec4
    bagb: ivec4
    baga: ivec4
    babr: ivec4
    babg: ivec4
    babb: ivec4
    baba: ivec4
    baar: ivec4
    baag: ivec4
    baab: ivec4
    baaa: ivec4
    arrr: ivec4
    arrg: ivec4
    arrb: ivec4
    arra: ivec4
    argr: ivec4
    argg: ivec4
    argb: ivec4
    arga: ivec4
    arbr: ivec4
    arbg: ivec4
    arbb: ivec4
    arba: ivec4
    arar: ivec4
    arag: ivec4
    arab: ivec4
    araa: ivec4
    agrr: ivec4
    agrg: ivec4
    agrb: ivec4
    agra: ivec4
    aggr: ivec4
    aggg: ivec4
    aggb: ivec4
    agga: ivec4
    agbr: ivec4
    agbg: ivec4
    agbb: ivec4
    agba: ivec4
    agar: ivec4
    agag: ivec4
    agab: ivec4
    agaa: ivec4
    abrr: ivec4
    abrg: ivec4
    abrb: ivec4
    abra: ivec4
    abgr: ivec4
    abgg: ivec4
    abgb: ivec4
    abga: ivec4
    abbr: ivec4
    abbg: ivec4
    abbb: ivec4
    abba: ivec4
    abar: ivec4
    abag: ivec4
    abab: ivec4
    abaa: ivec4
    aarr: ivec4
    aarg: ivec4
    aarb: ivec4
    aara: ivec4
    aagr: ivec4
    aagg: ivec4
    aagb: ivec4
    aaga: ivec4
    aabr: ivec4
    aabg: ivec4
    aabb: ivec4
    aaba: ivec4
    aaar: ivec4
    aaag: ivec4
    aaab: ivec4
    aaaa: ivec4

class uvec2(Composite):
    shading_type: ClassVar[VectorType]
    @overload
    def __init__(self, a: uint | int, /) -> None: ...
    @overload
    def __init__(self, a: vec2 | ivec2 | uvec2 | bvec2, /) -> None: ...
    @overload
    def __init__(self, a: uint | int, b: uint | int, /) -> None: ...
    def __get__(self, instance: object, owner: Any = None) -> uvec2: ...
    def __set__(self, instance: object, value: uvec2 | tuple[uint | int, uint | int] | list[uint] | npt.NDArray[Any]) -> None: ...
    def __getitem__(self, index: int | uint) -> uint: ...
    def __setitem__(self, index: int | uint, value: uint | int) -> None: ...
    def __iter__(self) -> Iterator[uint]: ...
    def __add__(self, other: uvec2 | uint | int) -> uvec2: ...
    def __radd__(self, other: uint | int) -> uvec2: ...
    def __sub__(self, other: uvec2 | uint | int) -> uvec2: ...
    def __rsub__(self, other: uint | int) -> uvec2: ...
    def __mul__(self, other: uvec2 | uint | int) -> uvec2: ...
    def __rmul__(self, other: uint | int) -> uvec2: ...
    def __floordiv__(self, other: uvec2 | uint | int) -> uvec2: ...
    def __rfloordiv__(self, other: uint | int) -> uvec2: ...
    def __mod__(self, other: uvec2 | uint | int) -> uvec2: ...
    def __rmod__(self, other: uint | int) -> uvec2: ...
    def __and__(self, other: uvec2 | uint | int) -> uvec2: ...
    def __rand__(self, other: uint | int) -> uvec2: ...
    def __or__(self, other: uvec2 | uint | int) -> uvec2: ...
    def __ror__(self, other: uint | int) -> uvec2: ...
    def __xor__(self, other: uvec2 | uint | int) -> uvec2: ...
    def __rxor__(self, other: uint | int) -> uvec2: ...
    def __truediv__(self, other: uvec2 | uint | int | float) -> vec2: ...
    def __rtruediv__(self, other: uint | float) -> vec2: ...
    def __pow__(self, other: int) -> uvec2: ...
    def __lshift__(self, other: ivec2 | uvec2 | int | uint) -> uvec2: ...
    def __rshift__(self, other: ivec2 | uvec2 | int | uint) -> uvec2: ...
    def __invert__(self) -> uvec2: ...
    def __neg__(self) -> uvec2: ...
    def __pos__(self) -> uvec2: ...
    x: uint
    y: uint
    xx: uvec2
    xy: uvec2
    yx: uvec2
    yy: uvec2
    xxx: uvec3
    xxy: uvec3
    xyx: uvec3
    xyy: uvec3
    yxx: uvec3
    yxy: uvec3
    yyx: uvec3
    yyy: uvec3
    xxxx: uvec4
    xxxy: uvec4
    xxyx: uvec4
    xxyy: uvec4
    xyxx: uvec4
    xyxy: uvec4
    xyyx: uvec4
    xyyy: uvec4
    yxxx: uvec4
    yxxy: uvec4
    yxyx: uvec4
    yxyy: uvec4
    yyxx: uvec4
    yyxy: uvec4
    yyyx: uvec4
    yyyy: uvec4
    r: uint
    g: uint
    rr: uvec2
    rg: uvec2
    gr: uvec2
    gg: uvec2
    rrr: uvec3
    rrg: uvec3
    rgr: uvec3
    rgg: uvec3
    grr: uvec3
    grg: uvec3
    ggr: uvec3
    ggg: uvec3
    rrrr: uvec4
    rrrg: uvec4
    rrgr: uvec4
    rrgg: uvec4
    rgrr: uvec4
    rgrg: uvec4
    rggr: uvec4
    rggg: uvec4
    grrr: uvec4
    grrg: uvec4
    grgr: uvec4
    grgg: uvec4
    ggrr: uvec4
    ggrg: uvec4
    gggr: uvec4
    gggg: uvec4

class uvec3(Composite):
    shading_type: ClassVar[VectorType]
    @overload
    def __init__(self, a: uint | int, /) -> None: ...
    @overload
    def __init__(self, a: vec3 | ivec3 | uvec3 | bvec3, /) -> None: ...
    @overload
    def __init__(self, a: uint | int, b: uint | int, c: uint | int, /) -> None: ...
    @overload
    def __init__(self, a: uint | int, b: uvec2, /) -> None: ...
    @overload
    def __init__(self, a: uvec2, b: uint | int, /) -> None: ...
    def __get__(self, instance: object, owner: Any = None) -> uvec3: ...
    def __set__(self, instance: object, value: uvec3 | tuple[uint | int, uint | int, uint | int] | list[uint] | npt.NDArray[Any]) -> None: ...
    def __getitem__(self, index: int | uint) -> uint: ...
    def __setitem__(self, index: int | uint, value: uint | int) -> None: ...
    def __iter__(self) -> Iterator[uint]: ...
    def __add__(self, other: uvec3 | uint | int) -> uvec3: ...
    def __radd__(self, other: uint | int) -> uvec3: ...
    def __sub__(self, other: uvec3 | uint | int) -> uvec3: ...
    def __rsub__(self, other: uint | int) -> uvec3: ...
    def __mul__(self, other: uvec3 | uint | int) -> uvec3: ...
    def __rmul__(self, other: uint | int) -> uvec3: ...
    def __floordiv__(self, other: uvec3 | uint | int) -> uvec3: ...
    def __rfloordiv__(self, other: uint | int) -> uvec3: ...
    def __mod__(self, other: uvec3 | uint | int) -> uvec3: ...
    def __rmod__(self, other: uint | int) -> uvec3: ...
    def __and__(self, other: uvec3 | uint | int) -> uvec3: ...
    def __rand__(self, other: uint | int) -> uvec3: ...
    def __or__(self, other: uvec3 | uint | int) -> uvec3: ...
    def __ror__(self, other: uint | int) -> uvec3: ...
    def __xor__(self, other: uvec3 | uint | int) -> uvec3: ...
    def __rxor__(self, other: uint | int) -> uvec3: ...
    def __truediv__(self, other: uvec3 | uint | int | float) -> vec3: ...
    def __rtruediv__(self, other: uint | float) -> vec3: ...
    def __pow__(self, other: int) -> uvec3: ...
    def __lshift__(self, other: ivec3 | uvec3 | int | uint) -> uvec3: ...
    def __rshift__(self, other: ivec3 | uvec3 | int | uint) -> uvec3: ...
    def __invert__(self) -> uvec3: ...
    def __neg__(self) -> uvec3: ...
    def __pos__(self) -> uvec3: ...
    x: uint
    y: uint
    z: uint
    xx: uvec2
    xy: uvec2
    xz: uvec2
    yx: uvec2
    yy: uvec2
    yz: uvec2
    zx: uvec2
    zy: uvec2
    zz: uvec2
    xxx: uvec3
    xxy: uvec3
    xxz: uvec3
    xyx: uvec3
    xyy: uvec3
    xyz: uvec3
    xzx: uvec3
    xzy: uvec3
    xzz: uvec3
    yxx: uvec3
    yxy: uvec3
    yxz: uvec3
    yyx: uvec3
    yyy: uvec3
    yyz: uvec3
    yzx: uvec3
    yzy: uvec3
    yzz: uvec3
    zxx: uvec3
    zxy: uvec3
    zxz: uvec3
    zyx: uvec3
    zyy: uvec3
    zyz: uvec3
    zzx: uvec3
    zzy: uvec3
    zzz: uvec3
    xxxx: uvec4
    xxxy: uvec4
    xxxz: uvec4
    xxyx: uvec4
    xxyy: uvec4
    xxyz: uvec4
    xxzx: uvec4
    xxzy: uvec4
    xxzz: uvec4
    xyxx: uvec4
    xyxy: uvec4
    xyxz: uvec4
    xyyx: uvec4
    xyyy: uvec4
    xyyz: uvec4
    xyzx: uvec4
    xyzy: uvec4
    xyzz: uvec4
    xzxx: uvec4
    xzxy: uvec4
    xzxz: uvec4
    xzyx: uvec4
    xzyy: uvec4
    xzyz: uvec4
    xzzx: uvec4
    xzzy: uvec4
    xzzz: uvec4
    yxxx: uvec4
    yxxy: uvec4
    yxxz: uvec4
    yxyx: uvec4
    yxyy: uvec4
    yxyz: uvec4
    yxzx: uvec4
    yxzy: uvec4
    yxzz: uvec4
    yyxx: uvec4
    yyxy: uvec4
    yyxz: uvec4
    yyyx: uvec4
    yyyy: uvec4
    yyyz: uvec4
    yyzx: uvec4
    yyzy: uvec4
    yyzz: uvec4
    yzxx: uvec4
    yzxy: uvec4
    yzxz: uvec4
    yzyx: uvec4
    yzyy: uvec4
    yzyz: uvec4
    yzzx: uvec4
    yzzy: uvec4
    yzzz: uvec4
    zxxx: uvec4
    zxxy: uvec4
    zxxz: uvec4
    zxyx: uvec4
    zxyy: uvec4
    zxyz: uvec4
    zxzx: uvec4
    zxzy: uvec4
    zxzz: uvec4
    zyxx: uvec4
    zyxy: uvec4
    zyxz: uvec4
    zyyx: uvec4
    zyyy: uvec4
    zyyz: uvec4
    zyzx: uvec4
    zyzy: uvec4
    zyzz: uvec4
    zzxx: uvec4
    zzxy: uvec4
    zzxz: uvec4
    zzyx: uvec4
    zzyy: uvec4
    zzyz: uvec4
    zzzx: uvec4
    zzzy: uvec4
    zzzz: uvec4
    r: uint
    g: uint
    b: uint
    rr: uvec2
    rg: uvec2
    rb: uvec2
    gr: uvec2
    gg: uvec2
    gb: uvec2
    br: uvec2
    bg: uvec2
    bb: uvec2
    rrr: uvec3
    rrg: uvec3
    rrb: uvec3
    rgr: uvec3
    rgg: uvec3
    rgb: uvec3
    rbr: uvec3
    rbg: uvec3
    rbb: uvec3
    grr: uvec3
    grg: uvec3
    grb: uvec3
    ggr: uvec3
    ggg: uvec3
    ggb: uvec3
    gbr: uvec3
    gbg: uvec3
    gbb: uvec3
    brr: uvec3
    brg: uvec3
    brb: uvec3
    bgr: uvec3
    bgg: uvec3
    bgb: uvec3
    bbr: uvec3
    bbg: uvec3
    bbb: uvec3
    rrrr: uvec4
    rrrg: uvec4
    rrrb: uvec4
    rrgr: uvec4
    rrgg: uvec4
    rrgb: uvec4
    rrbr: uvec4
    rrbg: uvec4
    rrbb: uvec4
    rgrr: uvec4
    rgrg: uvec4
    rgrb: uvec4
    rggr: uvec4
    rggg: uvec4
    rggb: uvec4
    rgbr: uvec4
    rgbg: uvec4
    rgbb: uvec4
    rbrr: uvec4
    rbrg: uvec4
    rbrb: uvec4
    rbgr: uvec4
    rbgg: uvec4
    rbgb: uvec4
    rbbr: uvec4
    rbbg: uvec4
    rbbb: uvec4
    grrr: uvec4
    grrg: uvec4
    grrb: uvec4
    grgr: uvec4
    grgg: uvec4
    grgb: uvec4
    grbr: uvec4
    grbg: uvec4
    grbb: uvec4
    ggrr: uvec4
    ggrg: uvec4
    ggrb: uvec4
    gggr: uvec4
    gggg: uvec4
    gggb: uvec4
    ggbr: uvec4
    ggbg: uvec4
    ggbb: uvec4
    gbrr: uvec4
    gbrg: uvec4
    gbrb: uvec4
    gbgr: uvec4
    gbgg: uvec4
    gbgb: uvec4
    gbbr: uvec4
    gbbg: uvec4
    gbbb: uvec4
    brrr: uvec4
    brrg: uvec4
    brrb: uvec4
    brgr: uvec4
    brgg: uvec4
    brgb: uvec4
    brbr: uvec4
    brbg: uvec4
    brbb: uvec4
    bgrr: uvec4
    bgrg: uvec4
    bgrb: uvec4
    bggr: uvec4
    bggg: uvec4
    bggb: uvec4
    bgbr: uvec4
    bgbg: uvec4
    bgbb: uvec4
    bbrr: uvec4
    bbrg: uvec4
    bbrb: uvec4
    bbgr: uvec4
    bbgg: uvec4
    bbgb: uvec4
    bbbr: uvec4
    bbbg: uvec4
    bbbb: uvec4

class uvec4(Composite):
    shading_type: ClassVar[VectorType]
    @overload
    def __init__(self, a: uint | int, /) -> None: ...
    @overload
    def __init__(self, a: vec4 | ivec4 | uvec4 | bvec4, /) -> None: ...
    @overload
    def __init__(self, a: uint | int, b: uint | int, c: uint | int, d: uint | int, /) -> None: ...
    @overload
    def __init__(self, a: uint | int, b: uint | int, c: uvec2, /) -> None: ...
    @overload
    def __init__(self, a: uint | int, b: uvec2, c: uint | int, /) -> None: ...
    @overload
    def __init__(self, a: uint | int, b: uvec3, /) -> None: ...
    @overload
    def __init__(self, a: uvec2, b: uint | int, c: uint | int, /) -> None: ...
    @overload
    def __init__(self, a: uvec2, b: uvec2, /) -> None: ...
    @overload
    def __init__(self, a: uvec3, b: uint | int, /) -> None: ...
    def __get__(self, instance: object, owner: Any = None) -> uvec4: ...
    def __set__(self, instance: object, value: uvec4 | tuple[uint | int, uint | int, uint | int, uint | int] | list[uint] | npt.NDArray[Any]) -> None: ...
    def __getitem__(self, index: int | uint) -> uint: ...
    def __setitem__(self, index: int | uint, value: uint | int) -> None: ...
    def __iter__(self) -> Iterator[uint]: ...
    def __add__(self, other: uvec4 | uint | int) -> uvec4: ...
    def __radd__(self, other: uint | int) -> uvec4: ...
    def __sub__(self, other: uvec4 | uint | int) -> uvec4: ...
    def __rsub__(self, other: uint | int) -> uvec4: ...
    def __mul__(self, other: uvec4 | uint | int) -> uvec4: ...
    def __rmul__(self, other: uint | int) -> uvec4: ...
    def __floordiv__(self, other: uvec4 | uint | int) -> uvec4: ...
    def __rfloordiv__(self, other: uint | int) -> uvec4: ...
    def __mod__(self, other: uvec4 | uint | int) -> uvec4: ...
    def __rmod__(self, other: uint | int) -> uvec4: ...
    def __and__(self, other: uvec4 | uint | int) -> uvec4: ...
    def __rand__(self, other: uint | int) -> uvec4: ...
    def __or__(self, other: uvec4 | uint | int) -> uvec4: ...
    def __ror__(self, other: uint | int) -> uvec4: ...
    def __xor__(self, other: uvec4 | uint | int) -> uvec4: ...
    def __rxor__(self, other: uint | int) -> uvec4: ...
    def __truediv__(self, other: uvec4 | uint | int | float) -> vec4: ...
    def __rtruediv__(self, other: uint | float) -> vec4: ...
    def __pow__(self, other: int) -> uvec4: ...
    def __lshift__(self, other: ivec4 | uvec4 | int | uint) -> uvec4: ...
    def __rshift__(self, other: ivec4 | uvec4 | int | uint) -> uvec4: ...
    def __invert__(self) -> uvec4: ...
    def __neg__(self) -> uvec4: ...
    def __pos__(self) -> uvec4: ...
    x: uint
    y: uint
    z: uint
    w: uint
    xx: uvec2
    xy: uvec2
    xz: uvec2
    xw: uvec2
    yx: uvec2
    yy: uvec2
    yz: uvec2
    yw: uvec2
    zx: uvec2
    zy: uvec2
    zz: uvec2
    zw: uvec2
    wx: uvec2
    wy: uvec2
    wz: uvec2
    ww: uvec2
    xxx: uvec3
    xxy: uvec3
    xxz: uvec3
    xxw: uvec3
    xyx: uvec3
    xyy: uvec3
    xyz: uvec3
    xyw: uvec3
    xzx: uvec3
    xzy: uvec3
    xzz: uvec3
    xzw: uvec3
    xwx: uvec3
    xwy: uvec3
    xwz: uvec3
    xww: uvec3
    yxx: uvec3
    yxy: uvec3
    yxz: uvec3
    yxw: uvec3
    yyx: uvec3
    yyy: uvec3
    yyz: uvec3
    yyw: uvec3
    yzx: uvec3
    yzy: uvec3
    yzz: uvec3
    yzw: uvec3
    ywx: uvec3
    ywy: uvec3
    ywz: uvec3
    yww: uvec3
    zxx: uvec3
    zxy: uvec3
    zxz: uvec3
    zxw: uvec3
    zyx: uvec3
    zyy: uvec3
    zyz: uvec3
    zyw: uvec3
    zzx: uvec3
    zzy: uvec3
    zzz: uvec3
    zzw: uvec3
    zwx: uvec3
    zwy: uvec3
    zwz: uvec3
    zww: uvec3
    wxx: uvec3
    wxy: uvec3
    wxz: uvec3
    wxw: uvec3
    wyx: uvec3
    wyy: uvec3
    wyz: uvec3
    wyw: uvec3
    wzx: uvec3
    wzy: uvec3
    wzz: uvec3
    wzw: uvec3
    wwx: uvec3
    wwy: uvec3
    wwz: uvec3
    www: uvec3
    xxxx: uvec4
    xxxy: uvec4
    xxxz: uvec4
    xxxw: uvec4
    xxyx: uvec4
    xxyy: uvec4
    xxyz: uvec4
    xxyw: uvec4
    xxzx: uvec4
    xxzy: uvec4
    xxzz: uvec4
    xxzw: uvec4
    xxwx: uvec4
    xxwy: uvec4
    xxwz: uvec4
    xxww: uvec4
    xyxx: uvec4
    xyxy: uvec4
    xyxz: uvec4
    xyxw: uvec4
    xyyx: uvec4
    xyyy: uvec4
    xyyz: uvec4
    xyyw: uvec4
    xyzx: uvec4
    xyzy: uvec4
    xyzz: uvec4
    xyzw: uvec4
    xywx: uvec4
    xywy: uvec4
    xywz: uvec4
    xyww: uvec4
    xzxx: uvec4
    xzxy: uvec4
    xzxz: uvec4
    xzxw: uvec4
    xzyx: uvec4
    xzyy: uvec4
    xzyz: uvec4
    xzyw: uvec4
    xzzx: uvec4
    xzzy: uvec4
    xzzz: uvec4
    xzzw: uvec4
    xzwx: uvec4
    xzwy: uvec4
    xzwz: uvec4
    xzww: uvec4
    xwxx: uvec4
    xwxy: uvec4
    xwxz: uvec4
    xwxw: uvec4
    xwyx: uvec4
    xwyy: uvec4
    xwyz: uvec4
    xwyw: uvec4
    xwzx: uvec4
    xwzy: uvec4
    xwzz: uvec4
    xwzw: uvec4
    xwwx: uvec4
    xwwy: uvec4
    xwwz: uvec4
    xwww: uvec4
    yxxx: uvec4
    yxxy: uvec4
    yxxz: uvec4
    yxxw: uvec4
    yxyx: uvec4
    yxyy: uvec4
    yxyz: uvec4
    yxyw: uvec4
    yxzx: uvec4
    yxzy: uvec4
    yxzz: uvec4
    yxzw: uvec4
    yxwx: uvec4
    yxwy: uvec4
    yxwz: uvec4
    yxww: uvec4
    yyxx: uvec4
    yyxy: uvec4
    yyxz: uvec4
    yyxw: uvec4
    yyyx: uvec4
    yyyy: uvec4
    yyyz: uvec4
    yyyw: uvec4
    yyzx: uvec4
    yyzy: uvec4
    yyzz: uvec4
    yyzw: uvec4
    yywx: uvec4
    yywy: uvec4
    yywz: uvec4
    yyww: uvec4
    yzxx: uvec4
    yzxy: uvec4
    yzxz: uvec4
    yzxw: uvec4
    yzyx: uvec4
    yzyy: uvec4
    yzyz: uvec4
    yzyw: uvec4
    yzzx: uvec4
    yzzy: uvec4
    yzzz: uvec4
    yzzw: uvec4
    yzwx: uvec4
    yzwy: uvec4
    yzwz: uvec4
    yzww: uvec4
    ywxx: uvec4
    ywxy: uvec4
    ywxz: uvec4
    ywxw: uvec4
    ywyx: uvec4
    ywyy: uvec4
    ywyz: uvec4
    ywyw: uvec4
    ywzx: uvec4
    ywzy: uvec4
    ywzz: uvec4
    ywzw: uvec4
    ywwx: uvec4
    ywwy: uvec4
    ywwz: uvec4
    ywww: uvec4
    zxxx: uvec4
    zxxy: uvec4
    zxxz: uvec4
    zxxw: uvec4
    zxyx: uvec4
    zxyy: uvec4
    zxyz: uvec4
    zxyw: uvec4
    zxzx: uvec4
    zxzy: uvec4
    zxzz: uvec4
    zxzw: uvec4
    zxwx: uvec4
    zxwy: uvec4
    zxwz: uvec4
    zxww: uvec4
    zyxx: uvec4
    zyxy: uvec4
    zyxz: uvec4
    zyxw: uvec4
    zyyx: uvec4
    zyyy: uvec4
    zyyz: uvec4
    zyyw: uvec4
    zyzx: uvec4
    zyzy: uvec4
    zyzz: uvec4
    zyzw: uvec4
    zywx: uvec4
    zywy: uvec4
    zywz: uvec4
    zyww: uvec4
    zzxx: uvec4
    zzxy: uvec4
    zzxz: uvec4
    zzxw: uvec4
    zzyx: uvec4
    zzyy: uvec4
    zzyz: uvec4
    zzyw: uvec4
    zzzx: uvec4
    zzzy: uvec4
    zzzz: uvec4
    zzzw: uvec4
    zzwx: uvec4
    zzwy: uvec4
    zzwz: uvec4
    zzww: uvec4
    zwxx: uvec4
    zwxy: uvec4
    zwxz: uvec4
    zwxw: uvec4
    zwyx: uvec4
    zwyy: uvec4
    zwyz: uvec4
    zwyw: uvec4
    zwzx: uvec4
    zwzy: uvec4
    zwzz: uvec4
    zwzw: uvec4
    zwwx: uvec4
    zwwy: uvec4
    zwwz: uvec4
    zwww: uvec4
    wxxx: uvec4
    wxxy: uvec4
    wxxz: uvec4
    wxxw: uvec4
    wxyx: uvec4
    wxyy: uvec4
    wxyz: uvec4
    wxyw: uvec4
    wxzx: uvec4
    wxzy: uvec4
    wxzz: uvec4
    wxzw: uvec4
    wxwx: uvec4
    wxwy: uvec4
    wxwz: uvec4
    wxww: uvec4
    wyxx: uvec4
    wyxy: uvec4
    wyxz: uvec4
    wyxw: uvec4
    wyyx: uvec4
    wyyy: uvec4
    wyyz: uvec4
    wyyw: uvec4
    wyzx: uvec4
    wyzy: uvec4
    wyzz: uvec4
    wyzw: uvec4
    wywx: uvec4
    wywy: uvec4
    wywz: uvec4
    wyww: uvec4
    wzxx: uvec4
    wzxy: uvec4
    wzxz: uvec4
    wzxw: uvec4
    wzyx: uvec4
    wzyy: uvec4
    wzyz: uvec4
    wzyw: uvec4
    wzzx: uvec4
    wzzy: uvec4
    wzzz: uvec4
    wzzw: uvec4
    wzwx: uvec4
    wzwy: uvec4
    wzwz: uvec4
    wzww: uvec4
    wwxx: uvec4
    wwxy: uvec4
    wwxz: uvec4
    wwxw: uvec4
    wwyx: uvec4
    wwyy: uvec4
    wwyz: uvec4
    wwyw: uvec4
    wwzx: uvec4
    wwzy: uvec4
    wwzz: uvec4
    wwzw: uvec4
    wwwx: uvec4
    wwwy: uvec4
    wwwz: uvec4
    wwww: uvec4
    r: uint
    g: uint
    b: uint
    a: uint
    rr: uvec2
    rg: uvec2
    rb: uvec2
    ra: uvec2
    gr: uvec2
    gg: uvec2
    gb: uvec2
    ga: uvec2
    br: uvec2
    bg: uvec2
    bb: uvec2
    ba: uvec2
    ar: uvec2
    ag: uvec2
    ab: uvec2
    aa: uvec2
    rrr: uvec3
    rrg: uvec3
    rrb: uvec3
    rra: uvec3
    rgr: uvec3
    rgg: uvec3
    rgb: uvec3
    rga: uvec3
    rbr: uvec3
    rbg: uvec3
    rbb: uvec3
    rba: uvec3
    rar: uvec3
    rag: uvec3
    rab: uvec3
    raa: uvec3
    grr: uvec3
    grg: uvec3
    grb: uvec3
    gra: uvec3
    ggr: uvec3
    ggg: uvec3
    ggb: uvec3
    gga: uvec3
    gbr: uvec3
    gbg: uvec3
    gbb: uvec3
    gba: uvec3
    gar: uvec3
    gag: uvec3
    gab: uvec3
    gaa: uvec3
    brr: uvec3
    brg: uvec3
    brb: uvec3
    bra: uvec3
    bgr: uvec3
    bgg: uvec3
    bgb: uvec3
    bga: uvec3
    bbr: uvec3
    bbg: uvec3
    bbb: uvec3
    bba: uvec3
    bar: uvec3
    bag: uvec3
    bab: uvec3
    baa: uvec3
    arr: uvec3
    arg: uvec3
    arb: uvec3
    ara: uvec3
    agr: uvec3
    agg: uvec3
    agb: uvec3
    aga: uvec3
    abr: uvec3
    abg: uvec3
    abb: uvec3
    aba: uvec3
    aar: uvec3
    aag: uvec3
    aab: uvec3
    aaa: uvec3
    rrrr: uvec4
    rrrg: uvec4
    rrrb: uvec4
    rrra: uvec4
    rrgr: uvec4
    rrgg: uvec4
    rrgb: uvec4
    rrga: uvec4
    rrbr: uvec4
    rrbg: uvec4
    rrbb: uvec4
    rrba: uvec4
    rrar: uvec4
    rrag: uvec4
    rrab: uvec4
    rraa: uvec4
    rgrr: uvec4
    rgrg: uvec4
    rgrb: uvec4
    rgra: uvec4
    rggr: uvec4
    rggg: uvec4
    rggb: uvec4
    rgga: uvec4
    rgbr: uvec4
    rgbg: uvec4
    rgbb: uvec4
    rgba: uvec4
    rgar: uvec4
    rgag: uvec4
    rgab: uvec4
    rgaa: uvec4
    rbrr: uvec4
    rbrg: uvec4
    rbrb: uvec4
    rbra: uvec4
    rbgr: uvec4
    rbgg: uvec4
    rbgb: uvec4
    rbga: uvec4
    rbbr: uvec4
    rbbg: uvec4
    rbbb: uvec4
    rbba: uvec4
    rbar: uvec4
    rbag: uvec4
    rbab: uvec4
    rbaa: uvec4
    rarr: uvec4
    rarg: uvec4
    rarb: uvec4
    rara: uvec4
    ragr: uvec4
    ragg: uvec4
    ragb: uvec4
    raga: uvec4
    rabr: uvec4
    rabg: uvec4
    rabb: uvec4
    raba: uvec4
    raar: uvec4
    raag: uvec4
    raab: uvec4
    raaa: uvec4
    grrr: uvec4
    grrg: uvec4
    grrb: uvec4
    grra: uvec4
    grgr: uvec4
    grgg: uvec4
    grgb: uvec4
    grga: uvec4
    grbr: uvec4
    grbg: uvec4
    grbb: uvec4
    grba: uvec4
    grar: uvec4
    grag: uvec4
    grab: uvec4
    graa: uvec4
    ggrr: uvec4
    ggrg: uvec4
    ggrb: uvec4
    ggra: uvec4
    gggr: uvec4
    gggg: uvec4
    gggb: uvec4
    ggga: uvec4
    ggbr: uvec4
    ggbg: uvec4
    ggbb: uvec4
    ggba: uvec4
    ggar: uvec4
    ggag: uvec4
    ggab: uvec4
    ggaa: uvec4
    gbrr: uvec4
    gbrg: uvec4
    gbrb: uvec4
    gbra: uvec4
    gbgr: uvec4
    gbgg: uvec4
    gbgb: uvec4
    gbga: uvec4
    gbbr: uvec4
    gbbg: uvec4
    gbbb: uvec4
    gbba: uvec4
    gbar: uvec4
    gbag: uvec4
    gbab: uvec4
    gbaa: uvec4
    garr: uvec4
    garg: uvec4
    garb: uvec4
    gara: uvec4
    gagr: uvec4
    gagg: uvec4
    gagb: uvec4
    gaga: uvec4
    gabr: uvec4
    gabg: uvec4
    gabb: uvec4
    gaba: uvec4
    gaar: uvec4
    gaag: uvec4
    gaab: uvec4
    gaaa: uvec4
    brrr: uvec4
    brrg: uvec4
    brrb: uvec4
    brra: uvec4
    brgr: uvec4
    brgg: uvec4
    brgb: uvec4
    brga: uvec4
    brbr: uvec4
    brbg: uvec4
    brbb: uvec4
    brba: uvec4
    brar: uvec4
    brag: uvec4
    brab: uvec4
    braa: uvec4
    bgrr: uvec4
    bgrg: uvec4
    bgrb: uvec4
    bgra: uvec4
    bggr: uvec4
    bggg: uvec4
    bggb: uvec4
    bgga: uvec4
    bgbr: uvec4
    bgbg: uvec4
    bgbb: uvec4
    bgba: uvec4
    bgar: uvec4
    bgag: uvec4
    bgab: uvec4
    bgaa: uvec4
    bbrr: uvec4
    bbrg: uvec4
    bbrb: uvec4
    bbra: uvec4
    bbgr: uvec4
    bbgg: uvec4
    bbgb: uvec4
    bbga: uvec4
    bbbr: uvec4
    bbbg: uvec4
    bbbb: uvec4
    bbba: uvec4
    bbar: uvec4
    bbag: uvec4
    bbab: uvec4
    bbaa: uvec4
    barr: uvec4
    barg: uvec4
    barb: uvec4
    bara: uvec4
    bagr: uvec4
    bagg: uvec4
    bagb: uvec4
    baga: uvec4
    babr: uvec4
    babg: uvec4
    babb: uvec4
    baba: uvec4
    baar: uvec4
    baag: uvec4
    baab: uvec4
    baaa: uvec4
    arrr: uvec4
    arrg: uvec4
    arrb: uvec4
    arra: uvec4
    argr: uvec4
    argg: uvec4
    argb: uvec4
    arga: uvec4
    arbr: uvec4
    arbg: uvec4
    arbb: uvec4
    arba: uvec4
    arar: uvec4
    arag: uvec4
    arab: uvec4
    araa: uvec4
    agrr: uvec4
    agrg: uvec4
    agrb: uvec4
    agra: uvec4
    aggr: uvec4
    aggg: uvec4
    aggb: uvec4
    agga: uvec4
    agbr: uvec4
    agbg: uvec4
    agbb: uvec4
    agba: uvec4
    agar: uvec4
    agag: uvec4
    agab: uvec4
    agaa: uvec4
    abrr: uvec4
    abrg: uvec4
    abrb: uvec4
    abra: uvec4
    abgr: uvec4
    abgg: uvec4
    abgb: uvec4
    abga: uvec4
    abbr: uvec4
    abbg: uvec4
    abbb: uvec4
    abba: uvec4
    abar: uvec4
    abag: uvec4
    abab: uvec4
    abaa: uvec4
    aarr: uvec4
    aarg: uvec4
    aarb: uvec4
    aara: uvec4
    aagr: uvec4
    aagg: uvec4
    aagb: uvec4
    aaga: uvec4
    aabr: uvec4
    aabg: uvec4
    aabb: uvec4
    aaba: uvec4
    aaar: uvec4
    aaag: uvec4
    aaab: uvec4
    aaaa: uvec4

class bvec2(Composite):
    shading_type: ClassVar[VectorType]
    @overload
    def __init__(self, a: float | uint | bool, /) -> None: ...
    @overload
    def __init__(self, a: vec2 | ivec2 | uvec2 | bvec2, /) -> None: ...
    @overload
    def __init__(self, a: bool, b: bool, /) -> None: ...
    def __get__(self, instance: object, owner: Any = None) -> bvec2: ...
    def __set__(self, instance: object, value: bvec2 | tuple[bool, bool] | list[bool] | npt.NDArray[Any]) -> None: ...
    def __getitem__(self, index: int | uint) -> bool: ...
    def __setitem__(self, index: int | uint, value: bool) -> None: ...
    def __iter__(self) -> Iterator[bool]: ...
    x: bool
    y: bool
    xx: bvec2
    xy: bvec2
    yx: bvec2
    yy: bvec2
    xxx: bvec3
    xxy: bvec3
    xyx: bvec3
    xyy: bvec3
    yxx: bvec3
    yxy: bvec3
    yyx: bvec3
    yyy: bvec3
    xxxx: bvec4
    xxxy: bvec4
    xxyx: bvec4
    xxyy: bvec4
    xyxx: bvec4
    xyxy: bvec4
    xyyx: bvec4
    xyyy: bvec4
    yxxx: bvec4
    yxxy: bvec4
    yxyx: bvec4
    yxyy: bvec4
    yyxx: bvec4
    yyxy: bvec4
    yyyx: bvec4
    yyyy: bvec4
    r: bool
    g: bool
    rr: bvec2
    rg: bvec2
    gr: bvec2
    gg: bvec2
    rrr: bvec3
    rrg: bvec3
    rgr: bvec3
    rgg: bvec3
    grr: bvec3
    grg: bvec3
    ggr: bvec3
    ggg: bvec3
    rrrr: bvec4
    rrrg: bvec4
    rrgr: bvec4
    rrgg: bvec4
    rgrr: bvec4
    rgrg: bvec4
    rggr: bvec4
    rggg: bvec4
    grrr: bvec4
    grrg: bvec4
    grgr: bvec4
    grgg: bvec4
    ggrr: bvec4
    ggrg: bvec4
    gggr: bvec4
    gggg: bvec4

class bvec3(Composite):
    shading_type: ClassVar[VectorType]
    @overload
    def __init__(self, a: float | uint | bool, /) -> None: ...
    @overload
    def __init__(self, a: vec3 | ivec3 | uvec3 | bvec3, /) -> None: ...
    @overload
    def __init__(self, a: bool, b: bool, c: bool, /) -> None: ...
    @overload
    def __init__(self, a: bool, b: bvec2, /) -> None: ...
    @overload
    def __init__(self, a: bvec2, b: bool, /) -> None: ...
    def __get__(self, instance: object, owner: Any = None) -> bvec3: ...
    def __set__(self, instance: object, value: bvec3 | tuple[bool, bool, bool] | list[bool] | npt.NDArray[Any]) -> None: ...
    def __getitem__(self, index: int | uint) -> bool: ...
    def __setitem__(self, index: int | uint, value: bool) -> None: ...
    def __iter__(self) -> Iterator[bool]: ...
    x: bool
    y: bool
    z: bool
    xx: bvec2
    xy: bvec2
    xz: bvec2
    yx: bvec2
    yy: bvec2
    yz: bvec2
    zx: bvec2
    zy: bvec2
    zz: bvec2
    xxx: bvec3
    xxy: bvec3
    xxz: bvec3
    xyx: bvec3
    xyy: bvec3
    xyz: bvec3
    xzx: bvec3
    xzy: bvec3
    xzz: bvec3
    yxx: bvec3
    yxy: bvec3
    yxz: bvec3
    yyx: bvec3
    yyy: bvec3
    yyz: bvec3
    yzx: bvec3
    yzy: bvec3
    yzz: bvec3
    zxx: bvec3
    zxy: bvec3
    zxz: bvec3
    zyx: bvec3
    zyy: bvec3
    zyz: bvec3
    zzx: bvec3
    zzy: bvec3
    zzz: bvec3
    xxxx: bvec4
    xxxy: bvec4
    xxxz: bvec4
    xxyx: bvec4
    xxyy: bvec4
    xxyz: bvec4
    xxzx: bvec4
    xxzy: bvec4
    xxzz: bvec4
    xyxx: bvec4
    xyxy: bvec4
    xyxz: bvec4
    xyyx: bvec4
    xyyy: bvec4
    xyyz: bvec4
    xyzx: bvec4
    xyzy: bvec4
    xyzz: bvec4
    xzxx: bvec4
    xzxy: bvec4
    xzxz: bvec4
    xzyx: bvec4
    xzyy: bvec4
    xzyz: bvec4
    xzzx: bvec4
    xzzy: bvec4
    xzzz: bvec4
    yxxx: bvec4
    yxxy: bvec4
    yxxz: bvec4
    yxyx: bvec4
    yxyy: bvec4
    yxyz: bvec4
    yxzx: bvec4
    yxzy: bvec4
    yxzz: bvec4
    yyxx: bvec4
    yyxy: bvec4
    yyxz: bvec4
    yyyx: bvec4
    yyyy: bvec4
    yyyz: bvec4
    yyzx: bvec4
    yyzy: bvec4
    yyzz: bvec4
    yzxx: bvec4
    yzxy: bvec4
    yzxz: bvec4
    yzyx: bvec4
    yzyy: bvec4
    yzyz: bvec4
    yzzx: bvec4
    yzzy: bvec4
    yzzz: bvec4
    zxxx: bvec4
    zxxy: bvec4
    zxxz: bvec4
    zxyx: bvec4
    zxyy: bvec4
    zxyz: bvec4
    zxzx: bvec4
    zxzy: bvec4
    zxzz: bvec4
    zyxx: bvec4
    zyxy: bvec4
    zyxz: bvec4
    zyyx: bvec4
    zyyy: bvec4
    zyyz: bvec4
    zyzx: bvec4
    zyzy: bvec4
    zyzz: bvec4
    zzxx: bvec4
    zzxy: bvec4
    zzxz: bvec4
    zzyx: bvec4
    zzyy: bvec4
    zzyz: bvec4
    zzzx: bvec4
    zzzy: bvec4
    zzzz: bvec4
    r: bool
    g: bool
    b: bool
    rr: bvec2
    rg: bvec2
    rb: bvec2
    gr: bvec2
    gg: bvec2
    gb: bvec2
    br: bvec2
    bg: bvec2
    bb: bvec2
    rrr: bvec3
    rrg: bvec3
    rrb: bvec3
    rgr: bvec3
    rgg: bvec3
    rgb: bvec3
    rbr: bvec3
    rbg: bvec3
    rbb: bvec3
    grr: bvec3
    grg: bvec3
    grb: bvec3
    ggr: bvec3
    ggg: bvec3
    ggb: bvec3
    gbr: bvec3
    gbg: bvec3
    gbb: bvec3
    brr: bvec3
    brg: bvec3
    brb: bvec3
    bgr: bvec3
    bgg: bvec3
    bgb: bvec3
    bbr: bvec3
    bbg: bvec3
    bbb: bvec3
    rrrr: bvec4
    rrrg: bvec4
    rrrb: bvec4
    rrgr: bvec4
    rrgg: bvec4
    rrgb: bvec4
    rrbr: bvec4
    rrbg: bvec4
    rrbb: bvec4
    rgrr: bvec4
    rgrg: bvec4
    rgrb: bvec4
    rggr: bvec4
    rggg: bvec4
    rggb: bvec4
    rgbr: bvec4
    rgbg: bvec4
    rgbb: bvec4
    rbrr: bvec4
    rbrg: bvec4
    rbrb: bvec4
    rbgr: bvec4
    rbgg: bvec4
    rbgb: bvec4
    rbbr: bvec4
    rbbg: bvec4
    rbbb: bvec4
    grrr: bvec4
    grrg: bvec4
    grrb: bvec4
    grgr: bvec4
    grgg: bvec4
    grgb: bvec4
    grbr: bvec4
    grbg: bvec4
    grbb: bvec4
    ggrr: bvec4
    ggrg: bvec4
    ggrb: bvec4
    gggr: bvec4
    gggg: bvec4
    gggb: bvec4
    ggbr: bvec4
    ggbg: bvec4
    ggbb: bvec4
    gbrr: bvec4
    gbrg: bvec4
    gbrb: bvec4
    gbgr: bvec4
    gbgg: bvec4
    gbgb: bvec4
    gbbr: bvec4
    gbbg: bvec4
    gbbb: bvec4
    brrr: bvec4
    brrg: bvec4
    brrb: bvec4
    brgr: bvec4
    brgg: bvec4
    brgb: bvec4
    brbr: bvec4
    brbg: bvec4
    brbb: bvec4
    bgrr: bvec4
    bgrg: bvec4
    bgrb: bvec4
    bggr: bvec4
    bggg: bvec4
    bggb: bvec4
    bgbr: bvec4
    bgbg: bvec4
    bgbb: bvec4
    bbrr: bvec4
    bbrg: bvec4
    bbrb: bvec4
    bbgr: bvec4
    bbgg: bvec4
    bbgb: bvec4
    bbbr: bvec4
    bbbg: bvec4
    bbbb: bvec4

class bvec4(Composite):
    shading_type: ClassVar[VectorType]
    @overload
    def __init__(self, a: float | uint | bool, /) -> None: ...
    @overload
    def __init__(self, a: vec4 | ivec4 | uvec4 | bvec4, /) -> None: ...
    @overload
    def __init__(self, a: bool, b: bool, c: bool, d: bool, /) -> None: ...
    @overload
    def __init__(self, a: bool, b: bool, c: bvec2, /) -> None: ...
    @overload
    def __init__(self, a: bool, b: bvec2, c: bool, /) -> None: ...
    @overload
    def __init__(self, a: bool, b: bvec3, /) -> None: ...
    @overload
    def __init__(self, a: bvec2, b: bool, c: bool, /) -> None: ...
    @overload
    def __init__(self, a: bvec2, b: bvec2, /) -> None: ...
    @overload
    def __init__(self, a: bvec3, b: bool, /) -> None: ...
    def __get__(self, instance: object, owner: Any = None) -> bvec4: ...
    def __set__(self, instance: object, value: bvec4 | tuple[bool, bool, bool, bool] | list[bool] | npt.NDArray[Any]) -> None: ...
    def __getitem__(self, index: int | uint) -> bool: ...
    def __setitem__(self, index: int | uint, value: bool) -> None: ...
    def __iter__(self) -> Iterator[bool]: ...
    x: bool
    y: bool
    z: bool
    w: bool
    xx: bvec2
    xy: bvec2
    xz: bvec2
    xw: bvec2
    yx: bvec2
    yy: bvec2
    yz: bvec2
    yw: bvec2
    zx: bvec2
    zy: bvec2
    zz: bvec2
    zw: bvec2
    wx: bvec2
    wy: bvec2
    wz: bvec2
    ww: bvec2
    xxx: bvec3
    xxy: bvec3
    xxz: bvec3
    xxw: bvec3
    xyx: bvec3
    xyy: bvec3
    xyz: bvec3
    xyw: bvec3
    xzx: bvec3
    xzy: bvec3
    xzz: bvec3
    xzw: bvec3
    xwx: bvec3
    xwy: bvec3
    xwz: bvec3
    xww: bvec3
    yxx: bvec3
    yxy: bvec3
    yxz: bvec3
    yxw: bvec3
    yyx: bvec3
    yyy: bvec3
    yyz: bvec3
    yyw: bvec3
    yzx: bvec3
    yzy: bvec3
    yzz: bvec3
    yzw: bvec3
    ywx: bvec3
    ywy: bvec3
    ywz: bvec3
    yww: bvec3
    zxx: bvec3
    zxy: bvec3
    zxz: bvec3
    zxw: bvec3
    zyx: bvec3
    zyy: bvec3
    zyz: bvec3
    zyw: bvec3
    zzx: bvec3
    zzy: bvec3
    zzz: bvec3
    zzw: bvec3
    zwx: bvec3
    zwy: bvec3
    zwz: bvec3
    zww: bvec3
    wxx: bvec3
    wxy: bvec3
    wxz: bvec3
    wxw: bvec3
    wyx: bvec3
    wyy: bvec3
    wyz: bvec3
    wyw: bvec3
    wzx: bvec3
    wzy: bvec3
    wzz: bvec3
    wzw: bvec3
    wwx: bvec3
    wwy: bvec3
    wwz: bvec3
    www: bvec3
    xxxx: bvec4
    xxxy: bvec4
    xxxz: bvec4
    xxxw: bvec4
    xxyx: bvec4
    xxyy: bvec4
    xxyz: bvec4
    xxyw: bvec4
    xxzx: bvec4
    xxzy: bvec4
    xxzz: bvec4
    xxzw: bvec4
    xxwx: bvec4
    xxwy: bvec4
    xxwz: bvec4
    xxww: bvec4
    xyxx: bvec4
    xyxy: bvec4
    xyxz: bvec4
    xyxw: bvec4
    xyyx: bvec4
    xyyy: bvec4
    xyyz: bvec4
    xyyw: bvec4
    xyzx: bvec4
    xyzy: bvec4
    xyzz: bvec4
    xyzw: bvec4
    xywx: bvec4
    xywy: bvec4
    xywz: bvec4
    xyww: bvec4
    xzxx: bvec4
    xzxy: bvec4
    xzxz: bvec4
    xzxw: bvec4
    xzyx: bvec4
    xzyy: bvec4
    xzyz: bvec4
    xzyw: bvec4
    xzzx: bvec4
    xzzy: bvec4
    xzzz: bvec4
    xzzw: bvec4
    xzwx: bvec4
    xzwy: bvec4
    xzwz: bvec4
    xzww: bvec4
    xwxx: bvec4
    xwxy: bvec4
    xwxz: bvec4
    xwxw: bvec4
    xwyx: bvec4
    xwyy: bvec4
    xwyz: bvec4
    xwyw: bvec4
    xwzx: bvec4
    xwzy: bvec4
    xwzz: bvec4
    xwzw: bvec4
    xwwx: bvec4
    xwwy: bvec4
    xwwz: bvec4
    xwww: bvec4
    yxxx: bvec4
    yxxy: bvec4
    yxxz: bvec4
    yxxw: bvec4
    yxyx: bvec4
    yxyy: bvec4
    yxyz: bvec4
    yxyw: bvec4
    yxzx: bvec4
    yxzy: bvec4
    yxzz: bvec4
    yxzw: bvec4
    yxwx: bvec4
    yxwy: bvec4
    yxwz: bvec4
    yxww: bvec4
    yyxx: bvec4
    yyxy: bvec4
    yyxz: bvec4
    yyxw: bvec4
    yyyx: bvec4
    yyyy: bvec4
    yyyz: bvec4
    yyyw: bvec4
    yyzx: bvec4
    yyzy: bvec4
    yyzz: bvec4
    yyzw: bvec4
    yywx: bvec4
    yywy: bvec4
    yywz: bvec4
    yyww: bvec4
    yzxx: bvec4
    yzxy: bvec4
    yzxz: bvec4
    yzxw: bvec4
    yzyx: bvec4
    yzyy: bvec4
    yzyz: bvec4
    yzyw: bvec4
    yzzx: bvec4
    yzzy: bvec4
    yzzz: bvec4
    yzzw: bvec4
    yzwx: bvec4
    yzwy: bvec4
    yzwz: bvec4
    yzww: bvec4
    ywxx: bvec4
    ywxy: bvec4
    ywxz: bvec4
    ywxw: bvec4
    ywyx: bvec4
    ywyy: bvec4
    ywyz: bvec4
    ywyw: bvec4
    ywzx: bvec4
    ywzy: bvec4
    ywzz: bvec4
    ywzw: bvec4
    ywwx: bvec4
    ywwy: bvec4
    ywwz: bvec4
    ywww: bvec4
    zxxx: bvec4
    zxxy: bvec4
    zxxz: bvec4
    zxxw: bvec4
    zxyx: bvec4
    zxyy: bvec4
    zxyz: bvec4
    zxyw: bvec4
    zxzx: bvec4
    zxzy: bvec4
    zxzz: bvec4
    zxzw: bvec4
    zxwx: bvec4
    zxwy: bvec4
    zxwz: bvec4
    zxww: bvec4
    zyxx: bvec4
    zyxy: bvec4
    zyxz: bvec4
    zyxw: bvec4
    zyyx: bvec4
    zyyy: bvec4
    zyyz: bvec4
    zyyw: bvec4
    zyzx: bvec4
    zyzy: bvec4
    zyzz: bvec4
    zyzw: bvec4
    zywx: bvec4
    zywy: bvec4
    zywz: bvec4
    zyww: bvec4
    zzxx: bvec4
    zzxy: bvec4
    zzxz: bvec4
    zzxw: bvec4
    zzyx: bvec4
    zzyy: bvec4
    zzyz: bvec4
    zzyw: bvec4
    zzzx: bvec4
    zzzy: bvec4
    zzzz: bvec4
    zzzw: bvec4
    zzwx: bvec4
    zzwy: bvec4
    zzwz: bvec4
    zzww: bvec4
    zwxx: bvec4
    zwxy: bvec4
    zwxz: bvec4
    zwxw: bvec4
    zwyx: bvec4
    zwyy: bvec4
    zwyz: bvec4
    zwyw: bvec4
    zwzx: bvec4
    zwzy: bvec4
    zwzz: bvec4
    zwzw: bvec4
    zwwx: bvec4
    zwwy: bvec4
    zwwz: bvec4
    zwww: bvec4
    wxxx: bvec4
    wxxy: bvec4
    wxxz: bvec4
    wxxw: bvec4
    wxyx: bvec4
    wxyy: bvec4
    wxyz: bvec4
    wxyw: bvec4
    wxzx: bvec4
    wxzy: bvec4
    wxzz: bvec4
    wxzw: bvec4
    wxwx: bvec4
    wxwy: bvec4
    wxwz: bvec4
    wxww: bvec4
    wyxx: bvec4
    wyxy: bvec4
    wyxz: bvec4
    wyxw: bvec4
    wyyx: bvec4
    wyyy: bvec4
    wyyz: bvec4
    wyyw: bvec4
    wyzx: bvec4
    wyzy: bvec4
    wyzz: bvec4
    wyzw: bvec4
    wywx: bvec4
    wywy: bvec4
    wywz: bvec4
    wyww: bvec4
    wzxx: bvec4
    wzxy: bvec4
    wzxz: bvec4
    wzxw: bvec4
    wzyx: bvec4
    wzyy: bvec4
    wzyz: bvec4
    wzyw: bvec4
    wzzx: bvec4
    wzzy: bvec4
    wzzz: bvec4
    wzzw: bvec4
    wzwx: bvec4
    wzwy: bvec4
    wzwz: bvec4
    wzww: bvec4
    wwxx: bvec4
    wwxy: bvec4
    wwxz: bvec4
    wwxw: bvec4
    wwyx: bvec4
    wwyy: bvec4
    wwyz: bvec4
    wwyw: bvec4
    wwzx: bvec4
    wwzy: bvec4
    wwzz: bvec4
    wwzw: bvec4
    wwwx: bvec4
    wwwy: bvec4
    wwwz: bvec4
    wwww: bvec4
    r: bool
    g: bool
    b: bool
    a: bool
    rr: bvec2
    rg: bvec2
    rb: bvec2
    ra: bvec2
    gr: bvec2
    gg: bvec2
    gb: bvec2
    ga: bvec2
    br: bvec2
    bg: bvec2
    bb: bvec2
    ba: bvec2
    ar: bvec2
    ag: bvec2
    ab: bvec2
    aa: bvec2
    rrr: bvec3
    rrg: bvec3
    rrb: bvec3
    rra: bvec3
    rgr: bvec3
    rgg: bvec3
    rgb: bvec3
    rga: bvec3
    rbr: bvec3
    rbg: bvec3
    rbb: bvec3
    rba: bvec3
    rar: bvec3
    rag: bvec3
    rab: bvec3
    raa: bvec3
    grr: bvec3
    grg: bvec3
    grb: bvec3
    gra: bvec3
    ggr: bvec3
    ggg: bvec3
    ggb: bvec3
    gga: bvec3
    gbr: bvec3
    gbg: bvec3
    gbb: bvec3
    gba: bvec3
    gar: bvec3
    gag: bvec3
    gab: bvec3
    gaa: bvec3
    brr: bvec3
    brg: bvec3
    brb: bvec3
    bra: bvec3
    bgr: bvec3
    bgg: bvec3
    bgb: bvec3
    bga: bvec3
    bbr: bvec3
    bbg: bvec3
    bbb: bvec3
    bba: bvec3
    bar: bvec3
    bag: bvec3
    bab: bvec3
    baa: bvec3
    arr: bvec3
    arg: bvec3
    arb: bvec3
    ara: bvec3
    agr: bvec3
    agg: bvec3
    agb: bvec3
    aga: bvec3
    abr: bvec3
    abg: bvec3
    abb: bvec3
    aba: bvec3
    aar: bvec3
    aag: bvec3
    aab: bvec3
    aaa: bvec3
    rrrr: bvec4
    rrrg: bvec4
    rrrb: bvec4
    rrra: bvec4
    rrgr: bvec4
    rrgg: bvec4
    rrgb: bvec4
    rrga: bvec4
    rrbr: bvec4
    rrbg: bvec4
    rrbb: bvec4
    rrba: bvec4
    rrar: bvec4
    rrag: bvec4
    rrab: bvec4
    rraa: bvec4
    rgrr: bvec4
    rgrg: bvec4
    rgrb: bvec4
    rgra: bvec4
    rggr: bvec4
    rggg: bvec4
    rggb: bvec4
    rgga: bvec4
    rgbr: bvec4
    rgbg: bvec4
    rgbb: bvec4
    rgba: bvec4
    rgar: bvec4
    rgag: bvec4
    rgab: bvec4
    rgaa: bvec4
    rbrr: bvec4
    rbrg: bvec4
    rbrb: bvec4
    rbra: bvec4
    rbgr: bvec4
    rbgg: bvec4
    rbgb: bvec4
    rbga: bvec4
    rbbr: bvec4
    rbbg: bvec4
    rbbb: bvec4
    rbba: bvec4
    rbar: bvec4
    rbag: bvec4
    rbab: bvec4
    rbaa: bvec4
    rarr: bvec4
    rarg: bvec4
    rarb: bvec4
    rara: bvec4
    ragr: bvec4
    ragg: bvec4
    ragb: bvec4
    raga: bvec4
    rabr: bvec4
    rabg: bvec4
    rabb: bvec4
    raba: bvec4
    raar: bvec4
    raag: bvec4
    raab: bvec4
    raaa: bvec4
    grrr: bvec4
    grrg: bvec4
    grrb: bvec4
    grra: bvec4
    grgr: bvec4
    grgg: bvec4
    grgb: bvec4
    grga: bvec4
    grbr: bvec4
    grbg: bvec4
    grbb: bvec4
    grba: bvec4
    grar: bvec4
    grag: bvec4
    grab: bvec4
    graa: bvec4
    ggrr: bvec4
    ggrg: bvec4
    ggrb: bvec4
    ggra: bvec4
    gggr: bvec4
    gggg: bvec4
    gggb: bvec4
    ggga: bvec4
    ggbr: bvec4
    ggbg: bvec4
    ggbb: bvec4
    ggba: bvec4
    ggar: bvec4
    ggag: bvec4
    ggab: bvec4
    ggaa: bvec4
    gbrr: bvec4
    gbrg: bvec4
    gbrb: bvec4
    gbra: bvec4
    gbgr: bvec4
    gbgg: bvec4
    gbgb: bvec4
    gbga: bvec4
    gbbr: bvec4
    gbbg: bvec4
    gbbb: bvec4
    gbba: bvec4
    gbar: bvec4
    gbag: bvec4
    gbab: bvec4
    gbaa: bvec4
    garr: bvec4
    garg: bvec4
    garb: bvec4
    gara: bvec4
    gagr: bvec4
    gagg: bvec4
    gagb: bvec4
    gaga: bvec4
    gabr: bvec4
    gabg: bvec4
    gabb: bvec4
    gaba: bvec4
    gaar: bvec4
    gaag: bvec4
    gaab: bvec4
    gaaa: bvec4
    brrr: bvec4
    brrg: bvec4
    brrb: bvec4
    brra: bvec4
    brgr: bvec4
    brgg: bvec4
    brgb: bvec4
    brga: bvec4
    brbr: bvec4
    brbg: bvec4
    brbb: bvec4
    brba: bvec4
    brar: bvec4
    brag: bvec4
    brab: bvec4
    braa: bvec4
    bgrr: bvec4
    bgrg: bvec4
    bgrb: bvec4
    bgra: bvec4
    bggr: bvec4
    bggg: bvec4
    bggb: bvec4
    bgga: bvec4
    bgbr: bvec4
    bgbg: bvec4
    bgbb: bvec4
    bgba: bvec4
    bgar: bvec4
    bgag: bvec4
    bgab: bvec4
    bgaa: bvec4
    bbrr: bvec4
    bbrg: bvec4
    bbrb: bvec4
    bbra: bvec4
    bbgr: bvec4
    bbgg: bvec4
    bbgb: bvec4
    bbga: bvec4
    bbbr: bvec4
    bbbg: bvec4
    bbbb: bvec4
    bbba: bvec4
    bbar: bvec4
    bbag: bvec4
    bbab: bvec4
    bbaa: bvec4
    barr: bvec4
    barg: bvec4
    barb: bvec4
    bara: bvec4
    bagr: bvec4
    bagg: bvec4
    bagb: bvec4
    baga: bvec4
    babr: bvec4
    babg: bvec4
    babb: bvec4
    baba: bvec4
    baar: bvec4
    baag: bvec4
    baab: bvec4
    baaa: bvec4
    arrr: bvec4
    arrg: bvec4
    arrb: bvec4
    arra: bvec4
    argr: bvec4
    argg: bvec4
    argb: bvec4
    arga: bvec4
    arbr: bvec4
    arbg: bvec4
    arbb: bvec4
    arba: bvec4
    arar: bvec4
    arag: bvec4
    arab: bvec4
    araa: bvec4
    agrr: bvec4
    agrg: bvec4
    agrb: bvec4
    agra: bvec4
    aggr: bvec4
    aggg: bvec4
    aggb: bvec4
    agga: bvec4
    agbr: bvec4
    agbg: bvec4
    agbb: bvec4
    agba: bvec4
    agar: bvec4
    agag: bvec4
    agab: bvec4
    agaa: bvec4
    abrr: bvec4
    abrg: bvec4
    abrb: bvec4
    abra: bvec4
    abgr: bvec4
    abgg: bvec4
    abgb: bvec4
    abga: bvec4
    abbr: bvec4
    abbg: bvec4
    abbb: bvec4
    abba: bvec4
    abar: bvec4
    abag: bvec4
    abab: bvec4
    abaa: bvec4
    aarr: bvec4
    aarg: bvec4
    aarb: bvec4
    aara: bvec4
    aagr: bvec4
    aagg: bvec4
    aagb: bvec4
    aaga: bvec4
    aabr: bvec4
    aabg: bvec4
    aabb: bvec4
    aaba: bvec4
    aaar: bvec4
    aaag: bvec4
    aaab: bvec4
    aaaa: bvec4

class mat2(Composite):
    shading_type: ClassVar[MatrixType]
    @overload
    def __init__(self, a0: float, /) -> None: ...
    @overload
    def __init__(self, a0: mat2 | mat3 | mat4, /) -> None: ...
    @overload
    def __init__(self, a0: vec2, a1: vec2, /) -> None: ...
    @overload
    def __init__(self, a0: float, a1: float, a2: float, a3: float, /) -> None: ...
    def __get__(self, instance: object, owner: Any = None) -> mat2: ...
    def __set__(self, instance: object, value: mat2 | npt.NDArray[Any] | Sequence[Sequence[float]]) -> None: ...
    def __getitem__(self, index: int | uint) -> vec2: ...
    def __add__(self, other: mat2) -> mat2: ...
    def __sub__(self, other: mat2) -> mat2: ...
    def __mul__(self, other: mat2 | float) -> mat2: ...
    def __rmul__(self, other: float) -> mat2: ...
    def __truediv__(self, other: float) -> mat2: ...
    def __neg__(self) -> mat2: ...
    @overload
    def __matmul__(self, other: mat2) -> mat2: ...
    @overload
    def __matmul__(self, other: vec2) -> vec2: ...

class mat3(Composite):
    shading_type: ClassVar[MatrixType]
    @overload
    def __init__(self, a0: float, /) -> None: ...
    @overload
    def __init__(self, a0: mat2 | mat3 | mat4, /) -> None: ...
    @overload
    def __init__(self, a0: vec3, a1: vec3, a2: vec3, /) -> None: ...
    @overload
    def __init__(self, a0: float, a1: float, a2: float, a3: float, a4: float, a5: float, a6: float, a7: float, a8: float, /) -> None: ...
    def __get__(self, instance: object, owner: Any = None) -> mat3: ...
    def __set__(self, instance: object, value: mat3 | npt.NDArray[Any] | Sequence[Sequence[float]]) -> None: ...
    def __getitem__(self, index: int | uint) -> vec3: ...
    def __add__(self, other: mat3) -> mat3: ...
    def __sub__(self, other: mat3) -> mat3: ...
    def __mul__(self, other: mat3 | float) -> mat3: ...
    def __rmul__(self, other: float) -> mat3: ...
    def __truediv__(self, other: float) -> mat3: ...
    def __neg__(self) -> mat3: ...
    @overload
    def __matmul__(self, other: mat3) -> mat3: ...
    @overload
    def __matmul__(self, other: vec3) -> vec3: ...

class mat4(Composite):
    shading_type: ClassVar[MatrixType]
    @overload
    def __init__(self, a0: float, /) -> None: ...
    @overload
    def __init__(self, a0: mat2 | mat3 | mat4, /) -> None: ...
    @overload
    def __init__(self, a0: vec4, a1: vec4, a2: vec4, a3: vec4, /) -> None: ...
    @overload
    def __init__(self, a0: float, a1: float, a2: float, a3: float, a4: float, a5: float, a6: float, a7: float, a8: float, a9: float, a10: float, a11: float, a12: float, a13: float, a14: float, a15: float, /) -> None: ...
    def __get__(self, instance: object, owner: Any = None) -> mat4: ...
    def __set__(self, instance: object, value: mat4 | npt.NDArray[Any] | Sequence[Sequence[float]]) -> None: ...
    def __getitem__(self, index: int | uint) -> vec4: ...
    def __add__(self, other: mat4) -> mat4: ...
    def __sub__(self, other: mat4) -> mat4: ...
    def __mul__(self, other: mat4 | float) -> mat4: ...
    def __rmul__(self, other: float) -> mat4: ...
    def __truediv__(self, other: float) -> mat4: ...
    def __neg__(self) -> mat4: ...
    @overload
    def __matmul__(self, other: mat4) -> mat4: ...
    @overload
    def __matmul__(self, other: vec4) -> vec4: ...

