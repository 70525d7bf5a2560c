"""Values that NumPy would convert without a word: each call takes what it means, or refuses it by a rule.

Every kind of value is given to every call that takes values. NumPy's warnings are off, as in programs that
have silenced them.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pytest

import rhi
import rhi.math as rm
from rhi import Format, RhiError
from rhi.shading import (
    Array,
    Shader,
    Struct,
    Uniform,
    array,
    ivec3,
    mat2,
    mat3,
    mat4,
    uint,
    uvec2,
    vec2,
    vec3,
    vec4,
)

Values = dict[str, Callable[[tuple[int, ...]], Any]]


class Inner(Struct):
    s: float


class Fields(Struct):
    f: float = 0.0
    i: int = 0
    u: uint = uint(0)
    v2: vec2 = vec2(0.0)
    v3: vec3 = vec3(0.0)
    iv: ivec3 = ivec3(0)
    uv: uvec2 = uvec2(0)
    m2: mat2 = mat2(1.0)
    m3: mat3 = mat3(1.0)
    m4: mat4 = mat4(1.0)


class Arrays(Struct):
    floats: Array[float] = array(float, 4)
    matrices: Array[mat2] = array(mat2, 2)
    uints: Array[uint] = array(uint, 4)


class Structs(Struct):
    inner: Array[Inner] = array(Inner, 2)


class Tinted(Shader):
    tint: Uniform[vec4]

    def vertex(self, v: Inner) -> vec4:
        return vec4(v.s)

    def fragment(self) -> vec4:
        return self.tint


def nested(value: Any, shape: tuple[int, ...]) -> Any:
    """Lists of this shape with the same value everywhere."""
    return [nested(value, shape[1:]) for _ in range(shape[0])] if shape else value


def nest_in_itself() -> list[Any]:
    items: list[Any] = []
    items.append(items)
    return items


HOSTILE: Values = {
    "complex array": lambda shape: np.full(shape, 1.0 + 0.0j),
    "complex lists": lambda shape: nested(1.0 + 2.0j, shape),
    "complex scalars of NumPy in lists": lambda shape: nested(np.complex64(2.0), shape),
    "masked array": lambda shape: np.ma.masked_array(np.ones(shape), mask=np.ones(shape, bool)),
    "masked array of integers": lambda shape: np.ma.masked_array(np.ones(shape, np.int32), mask=True),
    "masked array without masked elements": lambda shape: np.ma.masked_array(np.ones(shape, np.float32)),
    "masked elements in lists": lambda shape: nested(np.ma.masked, shape),
    "masked rows in lists": lambda shape: (
        [np.ma.masked_array(np.ones(shape[1:]), mask=True)] * (shape or (1,))[0]
    ),
    "set": lambda shape: set(range((shape or (1,))[0])),
    "frozen set": lambda shape: frozenset(map(float, range((shape or (1,))[0]))),
    "keys of a dict": lambda shape: dict.fromkeys(range((shape or (1,))[0]), 1.0).keys(),
    "dict by index": lambda shape: dict.fromkeys(range((shape or (1,))[0]), 1.0),
    "generator": lambda shape: (1.0 for _ in range((shape or (1,))[0])),
    "map": lambda shape: map(float, range((shape or (1,))[0])),
    "texts": lambda shape: np.full(shape, "1"),
    "bytes": lambda shape: b"1" * (shape or (1,))[0],
    "bytes that can be written": lambda shape: bytearray(np.ones(shape, np.float32).tobytes()),
    "dates": lambda shape: np.full(shape, np.datetime64("2020-01-01")),
    "time spans": lambda shape: np.full(shape, np.timedelta64(1, "s")),
    "nothing in objects": lambda shape: np.full(shape, None),
    "large integers": lambda shape: nested(10**400, shape),
    "integers without a text": lambda shape: nested(10**5000, shape),
    "ragged lists": lambda shape: [[1.0, 2.0], [3.0]],
    "uneven lists": lambda shape: [[1.0], 2.0, "x"],
    "a list in itself": lambda shape: nest_in_itself(),
    "a class": lambda shape: float,
    "a function": lambda shape: nested,
    "struct array": lambda shape: np.zeros(shape, [("unknown", "f4")]),
}
TOO_LARGE: Values = {
    "float64 beyond float32": lambda shape: np.full(shape, 1e39),
    "floats beyond float32": lambda shape: nested(1e39, shape),
    "negative ones": lambda shape: np.full(shape, -3.5e38),
    "a single one": lambda shape: np.where(np.arange(int(np.prod(shape))).reshape(shape) == 0, 1e200, 1.0),
}
WELCOME: Values = {
    "float64": lambda shape: np.ones(shape),
    "float32": lambda shape: np.ones(shape, np.float32),
    "lists": lambda shape: nested(1.0, shape),
    "a view backwards": lambda shape: np.ones(shape)[tuple(slice(None, None, -1) for _ in shape)],
}


def draw(device: rhi.Device, **values: Any) -> None:
    image = device.texture((4, 4), Format.RGBA8)
    mesh = device.mesh({"s": np.zeros(3, np.float32)})
    with device.render_pass(image):
        device.draw(device.program(Tinted), mesh, **values)


def clear(device: rhi.Device, color: Any) -> None:
    with device.render_pass(device.texture((4, 4), Format.RGBA32F), clear=color):
        pass


def assign(value: Any, name: str) -> None:
    fields = Fields()
    setattr(fields, name, value)


_POSITIONS = np.zeros((6, 2), np.float32)
_FIELDS = {name: np.shape(getattr(Fields(), name)) for name in ("f", "v2", "v3", "m2", "m3", "m4")}
_INTEGERS = {"i": (), "u": (), "iv": (3,), "uv": (2,)}
CALLS: dict[str, tuple[tuple[int, ...], Callable[[rhi.Device, Any], object]]] = {
    **{f"field {n}": (s, lambda d, v, n=n: Fields(**{n: v})) for n, s in {**_FIELDS, **_INTEGERS}.items()},
    **{f"assigned {n}": (s, lambda d, v, n=n: assign(v, n)) for n, s in {**_FIELDS, **_INTEGERS}.items()},
    "array of floats": ((4,), lambda d, v: Arrays(floats=v, matrices=np.zeros((2, 2, 2)), uints=[0] * 4)),
    "array of matrices": ((2, 2, 2), lambda d, v: Arrays(floats=[0.0] * 4, matrices=v, uints=[0] * 4)),
    "array of uints": ((4,), lambda d, v: Arrays(floats=[0.0] * 4, matrices=np.zeros((2, 2, 2)), uints=v)),
    "vector": ((3,), lambda d, v: vec3(v)),
    "matrix": ((3, 3), lambda d, v: mat3(v)),
    "uniform vector": ((4,), lambda d, v: d.uniform(v if isinstance(v, np.ndarray) else vec4(v))),
    "uniform matrix": ((4, 4), lambda d, v: d.uniform(v if isinstance(v, np.ndarray) else mat4(v))),
    "transient uniform": (
        (4,),
        lambda d, v: d.transient.uniform(v if isinstance(v, np.ndarray) else vec4(v)),
    ),
    "storage": ((5,), lambda d, v: d.storage(float, v)),
    "storage of vectors": ((5, 4), lambda d, v: d.storage(vec4, v)),
    "storage.write": ((5,), lambda d, v: d.storage(float, 5).write(v)),
    "transient storage": ((5,), lambda d, v: d.transient.storage(float, v)),
    "mesh": ((6, 2), lambda d, v: d.mesh({"position": v})),
    "mesh of two": ((6, 2), lambda d, v: d.mesh({"position": _POSITIONS, "uv": v})),
    "mesh instances": ((6,), lambda d, v: d.mesh({"position": _POSITIONS}, instances={"size": v})),
    "transient mesh": ((6,), lambda d, v: d.transient.mesh(d.program(Tinted), {"s": v})),
    "draw": ((4,), lambda d, v: draw(d, tint=v)),
    "clear": ((4,), lambda d, v: clear(d, v)),
    "translation": ((3,), lambda d, v: rm.translation(v)),
    "scaling": ((3,), lambda d, v: rm.scaling(v)),
    "rotation": ((), lambda d, v: rm.rotation((0, 0, 1), v)),
    "multiply": ((4, 4), lambda d, v: rm.multiply(v, np.eye(4))),
    "look at": ((3,), lambda d, v: rm.look_at((0, 0, 9), v)),
    "orbit": ((3,), lambda d, v: rm.orbit(v, 1.0)),
    "orbit distance": ((), lambda d, v: rm.orbit((0, 0, 0), v)),
    "perspective": ((), lambda d, v: rm.perspective(v, 1.0)),
    "orthographic": ((), lambda d, v: rm.orthographic(0.0, v, 0.0, 2.0)),
}
"""By name, the shape of the values that a call takes, and the call."""

WITHOUT_LIMIT = {
    "translation", "scaling", "rotation", "multiply", "look at", "orbit", "orbit distance", "perspective",
    "orthographic",
}  # fmt: skip
"""Calls that compute in float64."""


@pytest.fixture(scope="module")
def device() -> Iterator[rhi.Device]:
    with rhi.create_device("null") as opened:
        yield opened


@pytest.fixture(autouse=True)
def silent_warnings() -> Iterator[None]:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        yield


def refusal(device: rhi.Device, name: str, value: Any) -> str:
    """The rule by which a call refuses a value, "" if it takes it."""
    try:
        CALLS[name][1](device, value)
    except RhiError as error:
        return error.rule.id
    return ""


@pytest.mark.parametrize("name", CALLS)
def test_a_call_refuses_arguments_without_numbers_an_order_or_values(device: rhi.Device, name: str) -> None:
    shape = CALLS[name][0]
    taken = [kind for kind, make in HOSTILE.items() if not refusal(device, name, make(shape))]
    if shape == ():
        taken = [kind for kind in taken if kind != "texts"]  # float("1") reads a text
    if name == "clear":  # its parts are looked at one by one
        taken = [kind for kind in taken if kind != "masked array without masked elements"]
    assert taken == []


@pytest.mark.parametrize("name", sorted(set(CALLS) - WITHOUT_LIMIT))
def test_a_call_refuses_numbers_beyond_32_bits(device: rhi.Device, name: str) -> None:
    shape = CALLS[name][0]
    assert [kind for kind, make in TOO_LARGE.items() if not refusal(device, name, make(shape))] == []


@pytest.mark.parametrize("name", CALLS)
def test_a_call_takes_numbers(device: rhi.Device, name: str) -> None:
    shape = CALLS[name][0]
    assert {kind: refusal(device, name, make(shape)) for kind, make in WELCOME.items()} == dict.fromkeys(
        WELCOME, ""
    )


@pytest.mark.parametrize(
    "make",
    [
        lambda: mat2(1e39),
        lambda: vec2(0.0, -1e39),
        lambda: vec3(1j),
        lambda: vec3(np.ma.masked),
        lambda: vec2(()),
    ],
)
def test_vectors_are_refused_as_the_fields_they_fill(make: Callable[[], object]) -> None:
    with pytest.raises(RhiError, match=r"^\[shading-vector-value\]"):
        make()


def test_a_mesh_attribute_is_an_array(device: rhi.Device) -> None:
    with pytest.raises(RhiError, match=r"(?s)^\[mesh-data\].*position=5.*for each vertex"):
        device.mesh({"position": 5})


def test_a_masked_image_is_no_texture(device: rhi.Device) -> None:
    texels = np.zeros((4, 4, 4), np.uint8)
    device.texture(texels, Format.RGBA8)
    with pytest.raises(RhiError, match=r"(?s)^\[device-argument\].*array\.filled"):
        device.texture(np.ma.masked_array(texels, mask=False), Format.RGBA8)


@pytest.mark.parametrize("size", [2, 3, 4])
@pytest.mark.parametrize("dtype", ["f2", "f4", ">f4", "f8", ">f8", "i1", "i4", "u8", "?", "g"])
@pytest.mark.parametrize("order", ["C", "F"])
def test_a_matrix_is_converted_as_numpy_rounds_it(size: int, dtype: str, order: Any) -> None:
    """A generated constructor packs matrices by `struct`, which must round and lay out as NumPy does."""

    class Matrix(Struct):
        m: {2: mat2, 3: mat3, 4: mat4}[size]  # type: ignore[valid-type]

    rng = np.random.default_rng(size)
    Matrix(m=np.eye(size))  # the first value makes the constructor
    for _ in range(20):
        matrix = np.asarray(rng.normal(size=(size, size)) * 10.0 ** rng.integers(-44, 5), order=order).astype(
            dtype
        )
        rows = np.zeros((size, 4), np.float32)
        rows[:, :size] = matrix.astype(np.float32)
        assert Matrix(m=matrix).to_bytes() == rows.tobytes()
