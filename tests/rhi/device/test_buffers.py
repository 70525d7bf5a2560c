"""Typed buffers: arrays whose layout fits are accepted as they are, others are refused."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from null_kit import Kit

import rhi
from rhi.shading import Struct, ivec3, uvec3, vec2, vec3, vec4


class Light(Struct):
    position: vec2
    color: vec4


def test_an_array_that_names_its_padding_is_accepted_without_a_copy(kit: Kit) -> None:
    rows = np.zeros(2, [("position", "f4", 2), ("pad", "f4", 2), ("color", "f4", 4)])
    rows["color"] = 1
    assert kit.device.storage(Light, rows).read()["color"].tolist() == [[1] * 4] * 2


def test_an_array_of_other_types_is_refused_with_both_layouts(kit: Kit) -> None:
    rows = np.zeros(2, [("position", "f4", 2), ("color", "f8", 4)])
    with pytest.raises(
        rhi.ValidationError, match=r"offset\s+expected\s+offset\s+actual[\s\S]*<- offset"
    ) as caught:
        kit.device.storage(Light, rows)
    assert caught.value.rule.id == "layout-mismatch"


def test_fields_of_other_names_are_refused(kit: Kit) -> None:
    rows = np.zeros(2, [("spot", "f4", 2), ("pad", "f4", 2), ("color", "f4", 4)])
    with pytest.raises(rhi.ValidationError, match=r"^\[layout-mismatch\]"):
        kit.device.storage(Light, rows)


def test_vectors_are_rows_of_a_plain_array(kit: Kit) -> None:
    storage = kit.device.storage(vec4, np.arange(8, dtype=np.float32).reshape(2, 4))
    assert storage.count == 2
    assert storage.read().tolist() == [[0, 1, 2, 3], [4, 5, 6, 7]]


# -- vectors of three components -----------------------------------------------------------------------------


@pytest.mark.parametrize(("element", "scalar"), [(vec3, "f4"), (ivec3, "i4"), (uvec3, "u4")])
def test_vectors_of_three_components_are_padded(kit: Kit, element: Any, scalar: str) -> None:
    vectors = np.arange(12).reshape(4, 3).astype(scalar)
    padded = np.concatenate([vectors, np.zeros((4, 1), scalar)], axis=1)
    storage = kit.device.storage(element, vectors)
    assert len(storage) == 4
    assert (storage.read() == padded).all()
    storage.write(vectors[:2], 2)
    assert (storage.read()[2:] == padded[:2]).all()


def test_other_widths_are_refused_with_the_shape_that_is_allowed(kit: Kit) -> None:
    for element, width in ((vec3, 2), (vec4, 3), (vec4, 5)):
        with pytest.raises(rhi.ValidationError, match="layout-mismatch") as error:
            kit.device.storage(element, np.zeros((5, width), "f4"))
        assert error.value.given == f"shape (5, {width}) of float32"
        assert error.value.allowed == "(n, 4) of float32"


def test_reprs_of_typed_buffers_name_their_element_and_count(kit: Kit) -> None:
    assert repr(kit.device.storage(vec3, 5, label="paths")) == "StorageBuffer('paths', 5 × vec3)"
    assert repr(kit.device.uniform(vec4(1.0), label="tint")) == "UniformBuffer('tint', vec4)"
    assert repr(kit.device.uniform_array(Light, 3)) == "UniformArray('Light[]', 3 × Light)"
