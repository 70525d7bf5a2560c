"""Typed buffers: arrays whose layout fits are accepted as they are, others are refused."""

from __future__ import annotations

import numpy as np
import pytest
from null_kit import Kit

import rhi
from rhi.shading import Struct, vec2, vec4


class Light(Struct):
    place: vec2
    color: vec4


def test_an_array_that_names_its_padding_is_accepted_without_a_copy(kit: Kit) -> None:
    rows = np.zeros(2, [("place", "f4", 2), ("pad", "f4", 2), ("color", "f4", 4)])
    rows["color"] = 1
    assert kit.device.storage(Light, rows).read()["color"].tolist() == [[1] * 4] * 2


def test_an_array_without_the_padding_is_refused_with_both_layouts(kit: Kit) -> None:
    rows = np.zeros(2, [("place", "f4", 2), ("color", "f4", 4)])
    with pytest.raises(rhi.ValidationError, match=r"offset\s+wanted\s+offset\s+given[\s\S]*<- offset") as caught:
        kit.device.storage(Light, rows)
    assert caught.value.rule.id == "layout-mismatch"


def test_fields_of_other_names_are_refused(kit: Kit) -> None:
    rows = np.zeros(2, [("spot", "f4", 2), ("pad", "f4", 2), ("color", "f4", 4)])
    with pytest.raises(rhi.ValidationError) as caught:
        kit.device.storage(Light, rows)
    assert caught.value.rule.id == "layout-mismatch"


def test_vectors_are_rows_of_a_plain_array(kit: Kit) -> None:
    storage = kit.device.storage(vec4, np.arange(8, dtype=np.float32).reshape(2, 4))
    assert storage.count == 2
    assert storage.read().tolist() == [[0, 1, 2, 3], [4, 5, 6, 7]]


def test_a_refused_write_changes_nothing(kit: Kit) -> None:
    storage = kit.device.storage(Light, 2)
    before = len(kit.device.stream)
    with pytest.raises(rhi.ValidationError):
        storage.write(np.zeros(1, np.float32))
    assert len(kit.device.stream) == before
