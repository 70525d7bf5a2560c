"""Structs as CPU values and as classes; that their layouts are those of devices, the kit's test_compute.py
asks."""

import math

import numpy as np
import pytest

import rhi.shading as sl
from rhi.contract.descriptors import Stage
from rhi.contract.layout import Layout
from rhi.errors import ShaderError, ValidationError


class Part(sl.Struct):
    axis: sl.vec3
    size: float
    flag: sl.uint


class Plain(sl.Struct):
    scale: float
    view: sl.mat4
    turn: sl.mat3
    basis: sl.mat2
    offset: sl.vec3
    count: int
    bits: sl.uint
    cell: sl.ivec2


class Defaulted(Plain):
    color: sl.vec4 = sl.vec4(1, 2, 3, 4)


GOOD = {
    "scale": [0.1, 3, True, np.float32(0.1), np.int64(2), math.inf, math.nan, "1.5"],
    "view": [
        np.arange(16.0).reshape(4, 4),
        np.eye(4, dtype="f4").T,
        np.arange(16).reshape(4, 4),
        np.eye(4).tolist(),
        sl.mat4(2),
    ],
    "turn": [np.arange(9.0).reshape(3, 3), np.eye(3, dtype="f4").T, np.eye(3).tolist(), sl.mat3(2)],
    "basis": [np.arange(4.0).reshape(2, 2), np.arange(4).reshape(2, 2).T, sl.mat2(2)],
    "offset": [(1, 2, 3), [0.1, 0.2, 0.3], np.array([1, 2, 3]), sl.vec3(5), np.array([0.1, 2, 3], "f4")],
    "count": [-5, 3.0, np.int16(7), 2**31 - 1],
    "bits": [5, 2**32 - 1, sl.uint(3), 4.0],
    "cell": [(1, -2), np.array([3, 4]), sl.ivec2(7), (1.0, 2.0)],
}
BAD = {
    "scale": [1e39, "x", None, (1,), [1, 2], 1j, object(), np.zeros(2)],
    "view": [np.eye(3), 1.0, (1, 2), None, np.zeros((4, 4), "U1"), np.zeros(16)],
    "turn": [np.eye(4), np.eye(2), 1.0, None, np.zeros((3, 3), "U1"), np.zeros(9)],
    "basis": [np.eye(3), np.zeros((1, 2)), None],
    "offset": [(1, 2), (1, 2, 3, 4), 1.0, "xyz", None, (1, 2, 1e39), ((1,), (2,), (3,)), np.zeros((3, 1))],
    "count": [0.5, 2**31, "x", None, (1,)],
    "bits": [-1, 2**32, 0.5, None],
    "cell": [(1, 0.5), (1, 2, 3), 5, (1, 2**31)],
}


def field_by_field(cls, values):
    value = cls.__new__(cls)
    value._set_fields(values)
    return value


@pytest.mark.parametrize("cls", [Plain, Defaulted])
@pytest.mark.parametrize(("name", "value"), [(name, value) for name in GOOD for value in GOOD[name]])
def test_a_generated_constructor_stores_the_same_values_as_checks_field_by_field(cls, name, value):
    values = {field_name: GOOD[field_name][0] for field_name in GOOD} | {name: value}
    created, expected = cls(**values), field_by_field(cls, values)
    for layout in Layout:
        assert cls(**values).to_bytes(layout) == expected.to_bytes(layout)
    assert repr(created) == repr(expected)
    assert created.to_bytes() == expected.to_bytes()  # also after its fields were read
    created.scale = expected.scale = 8
    assert created.to_bytes() == expected.to_bytes() != cls(**values).to_bytes()


@pytest.mark.parametrize("cls", [Plain, Defaulted])
@pytest.mark.parametrize(("name", "value"), [(name, value) for name in BAD for value in BAD[name]])
def test_a_generated_constructor_refuses_the_same_values_as_checks_field_by_field(cls, name, value):
    values = {field_name: GOOD[field_name][0] for field_name in GOOD} | {name: value}
    with pytest.raises(ValidationError) as expected:
        field_by_field(cls, values)
    with pytest.raises(ValidationError) as refused:
        cls(**values)
    assert str(refused.value).splitlines()[:4] == str(expected.value).splitlines()[:4]
    assert refused.value.site.file == __file__


def test_a_constructor_generated_for_a_base_does_not_serve_structs_derived_from_it():
    class Wider(Plain):
        extra: sl.vec2 = sl.vec2(7, 8)

        def __init__(self, **values):
            super().__init__(**values, scale=1.0)

    values = {name: GOOD[name][0] for name in GOOD if name != "scale"}
    Plain(scale=1.0, **values)
    assert Wider(**values).extra == sl.vec2(7, 8)
    assert len(Wider(**values).to_bytes()) == Wider.uniform_dtype.itemsize


def test_a_struct_value_copies_its_arrays():
    view = np.arange(16.0).reshape(4, 4)
    value = Plain(**{name: GOOD[name][0] for name in GOOD} | {"view": view})
    view[:] = 0
    assert np.asarray(value.view).tolist() == np.arange(16.0).reshape(4, 4).tolist()


def test_rows_of_a_structs_dtype_take_plain_tuples():
    class Corner(sl.Struct):
        position: sl.vec2
        color: sl.vec3

    corners = np.array([((1, 2), (3, 4, 5)), ((6, 7), (8, 9, 10))], Corner.dtype)
    assert corners["position"].tolist() == [[1, 2], [6, 7]]
    assert corners["color"][1].tolist() == [8, 9, 10]
    assert Corner.dtype.itemsize == 32


def test_fields_are_converted_and_read_back_as_their_types():
    part = Part(axis=[1, 2, 3], size=np.float32(2), flag=True)
    assert part.axis == sl.vec3(1, 2, 3)
    assert isinstance(part.axis, sl.vec3)
    assert (part.axis.zx, part.size, part.flag) == (sl.vec2(3, 1), 2.0, 1)
    part.axis = sl.vec3(4.0)
    assert np.asarray(part.axis).tolist() == [4, 4, 4]
    assert repr(part) == "Part(axis=vec3(4.0, 4.0, 4.0), size=2.0, flag=1)"


def test_a_struct_inherits_fields_in_front_of_its_own_and_may_have_defaults():
    class Base(sl.Struct):
        clip: sl.vec4 = (0, 0, 0, 1)

    class More(Base):
        uv: sl.vec2

    assert [field.name for field in More.shading_type.fields] == ["clip", "uv"]
    assert More(uv=(1, 2)).clip == sl.vec4(0, 0, 0, 1)

    class Uses(sl.Shader):
        out: sl.StorageRW[More]

        def compute(self) -> None:
            self.out[0] = More(uv=(1, 2))

    text = sl.compile_shader(Uses).emit("glsl", Stage.COMPUTE).text
    assert "More(vec4(0.0, 0.0, 0.0, 1.0), vec2(1.0, 2.0))" in text


def test_a_struct_with_bools_has_no_dtype_but_can_be_used_in_shaders(run):
    class Flags(sl.Struct):
        both: sl.bvec2
        on: bool

    class Uses(sl.Shader):
        out: sl.StorageRW[int]

        def flags(self) -> Flags:
            return Flags(both=sl.bvec2(True, False), on=True)

        def compute(self) -> None:
            flags = self.flags()
            self.out[0] = 1 if flags.both.x and not flags.both.y and flags.on else 0

    assert run(Uses, out=1)["out"].tolist() == [1]
    with pytest.raises(ShaderError, match="uint"):
        _ = Flags.dtype
    with pytest.raises(ShaderError, match="uint"):
        Flags(both=(True, False), on=True).to_bytes()
    assert Part.dtype.itemsize == 32


def test_structs_of_one_name_do_not_collide(run):
    def first():
        class Same(sl.Struct):
            x: float

        return Same

    def second():
        class Same(sl.Struct):
            y: float
            z: float

        return Same

    a, b = first(), second()

    class Uses(sl.Shader):
        left: sl.Storage[a]
        right: sl.Storage[b]
        out: sl.StorageRW[float]

        def compute(self) -> None:
            self.out[0] = self.left[0].x + self.right[0].z

    left = np.ones(1, a.dtype)
    assert run(Uses, left=left, right=np.array([(0, 5)], b.dtype), out=1)["out"].tolist() == [6]


def test_a_struct_without_fields_is_no_element() -> None:
    class Empty(sl.Struct):
        pass

    with pytest.raises(ShaderError, match="shading-binding"):

        class Stores(sl.Shader):
            out: sl.StorageRW[Empty]
