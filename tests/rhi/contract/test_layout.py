"""Layouts against a brute-force statement of the std140 and std430 rules, written from the specification."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from rhi.contract.layout import (
    BOOL,
    FLOAT,
    INT,
    UINT,
    ArrayType,
    Field,
    Layout,
    MatrixType,
    StructType,
    VectorType,
    compare_layouts,
    describe_layout,
    dtype_of,
    element_dtype,
    is_host_shareable,
    memory_layout,
    scalar_offsets,
    shape_of,
    stride_of,
)

leaves = st.one_of(
    st.sampled_from([FLOAT, INT, UINT]),
    st.builds(VectorType, st.sampled_from([FLOAT, INT, UINT]), st.integers(2, 4)),
    st.builds(MatrixType, st.integers(2, 4)),
)


def structs(parts):
    return st.lists(parts, min_size=1, max_size=5).map(
        lambda types: StructType("S", tuple(Field(f"f{i}", t) for i, t in enumerate(types)))
    )


types = st.recursive(
    leaves,
    lambda parts: st.one_of(st.builds(ArrayType, parts, st.integers(1, 4)), structs(parts)),
    max_leaves=8,
)


def rules_of_the_specification(type, std140):
    """(base alignment, bytes with trailing padding, byte offset of each scalar in order), rules 1 to 10 of
    OpenGL 4.3's section 7.6.2.2, done one scalar at a time."""
    if type in (FLOAT, INT, UINT):
        return 4, 4, [0]  # rule 1
    if isinstance(type, VectorType):
        align = {2: 8, 3: 16, 4: 16}[type.size]  # rules 2 and 3
        return align, 4 * type.size, [4 * i for i in range(type.size)]
    if isinstance(type, MatrixType):  # rules 5 to 8: an array of rows
        return rules_of_the_specification(ArrayType(VectorType(FLOAT, type.size), type.size), std140)
    if isinstance(type, ArrayType):  # rules 4 and 10
        align, size, inside = rules_of_the_specification(type.element, std140)
        while std140 and align % 16:
            align += 1
        while size % align:
            size += 1
        return align, size * type.length, [i * size + at for i in range(type.length) for at in inside]
    align, cursor, scalars = 16 if std140 else 0, 0, []  # rule 9
    for field in type.fields:
        field_align, size, inside = rules_of_the_specification(field.type, std140)
        align = max(align, field_align)
        while cursor % field_align:
            cursor += 1
        scalars += [cursor + at for at in inside]
        cursor += size
    while cursor % align:
        cursor += 1
    return align, cursor, scalars


def scalars_of_dtype(type, dtype, start=0):
    """Byte offsets of the scalars in a dtype, as NumPy sees them, padding left out."""
    if isinstance(type, StructType):
        for field in type.fields:
            part, offset = dtype.fields[field.name][:2]
            yield from scalars_of_dtype(field.type, part, start + offset)
        return
    if isinstance(type, ArrayType):
        whole = np.zeros(1, dtype)
        stride = whole.strides[1]
        part = np.dtype((dtype.subdtype[0], dtype.subdtype[1][1:]))
        for index in range(type.length):
            yield from scalars_of_dtype(type.element, part, start + index * stride)
        return
    shape = shape_of(type)
    strides = np.zeros(1, dtype).strides[1:]
    for index in np.ndindex(shape):
        yield start + sum(i * s for i, s in zip(index, strides, strict=False))


@given(types, st.sampled_from([Layout.STD140, Layout.STD430]))
def test_offsets_are_those_of_the_specification(type, layout):
    align, size, _ = rules_of_the_specification(type, layout is Layout.STD140)
    placement = memory_layout(type, layout)
    assert (placement.alignment, placement.size) == (align, size)


@given(types, st.sampled_from([Layout.STD140, Layout.STD430]))
def test_dtypes_have_every_scalar_where_the_specification_has_it(type, layout):
    _, size, scalars = rules_of_the_specification(type, layout is Layout.STD140)
    dtype = dtype_of(type, layout)
    assert dtype.itemsize == size
    assert list(scalars_of_dtype(type, dtype)) == scalars
    assert [offset for offset, _ in scalar_offsets(type, layout)] == scalars


@given(types, st.sampled_from([Layout.STD140, Layout.STD430]))
def test_an_element_fills_its_stride(type, layout):
    assert element_dtype(type, layout).itemsize == stride_of(type, layout)


@given(types)
def test_a_packed_layout_has_no_padding(type):
    def count(t):
        if isinstance(t, StructType):
            return sum(count(field.type) for field in t.fields)
        if isinstance(t, ArrayType):
            return t.length * count(t.element)
        return int(np.prod(shape_of(t), dtype=int))

    assert dtype_of(type, Layout.PACKED).itemsize == 4 * count(type)


LIGHT = StructType(
    "Light", (Field("range", FLOAT), Field("position", VectorType(FLOAT, 3)), Field("turn", MatrixType(3)))
)


def test_a_mat3_is_three_padded_rows():
    assert dtype_of(MatrixType(3), Layout.STD430).shape == (3, 4)
    assert dtype_of(MatrixType(2), Layout.STD430).shape == (2, 2)
    assert dtype_of(MatrixType(2), Layout.STD140).shape == (2, 4)
    assert dtype_of(MatrixType(4), Layout.STD140).shape == (4, 4)


def test_a_bool_has_no_layout_and_a_uint_has():
    for type in (BOOL, VectorType(BOOL, 2), ArrayType(BOOL, 2), StructType("S", (Field("a", BOOL),))):
        assert not is_host_shareable(type)
        with pytest.raises(TypeError, match="uint"):
            memory_layout(type, Layout.STD430)
    assert is_host_shareable(StructType("S", (Field("a", UINT),)))


def test_a_comparison_shows_both_layouts_and_marks_the_differences():
    expected = dtype_of(LIGHT, Layout.STD430)
    actual = np.dtype([("range", "f8"), ("position", "f4", 3), ("extra", "f4")])
    lines = compare_layouts(expected, actual).splitlines()
    rows = {line.split()[0]: line for line in lines}
    assert rows["range"].split()[1:5] == ["0", "float32", "0", "float64"]
    assert rows["range"].endswith("<- type")
    assert rows["position"].endswith("<- offset")
    assert rows["turn"].endswith("<- missing")
    assert rows["extra"].endswith("<- not expected")
    assert rows["(bytes)"].endswith("<- size")
    assert "<-" not in compare_layouts(expected, expected)


def test_a_comparison_names_nested_fields_by_their_path():
    outer = StructType("Outer", (Field("lights", ArrayType(LIGHT, 2)), Field("sun", LIGHT)))
    names = [row.name for row in describe_layout(dtype_of(outer, Layout.STD430))]
    assert names[:3] == ["lights[2].range", "lights[2].position", "lights[2].turn"]
    assert names[3:] == ["sun.range", "sun.position", "sun.turn"]
