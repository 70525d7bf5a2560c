"""The shaders' structs have the layout of the scene's arrays."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from renderer import shaders
from renderer.scene import MATERIAL, PACKED_DIRECTIONAL, RELATIVE_POINT, RELATIVE_SPOT, VERTEX
from rhi.shading import Struct


def fields(dtype: np.dtype[Any]) -> dict[str, tuple[np.dtype[Any], int]]:
    """Return types and offsets by name, without padding."""
    assert dtype.fields is not None
    return {name: (field[0], field[1]) for name, field in dtype.fields.items() if name != "pad"}


@pytest.mark.parametrize(
    ("struct", "dtype"),
    [
        (shaders.Material, MATERIAL),
        (shaders.DirectionalLight, PACKED_DIRECTIONAL),
        (shaders.PointLight, RELATIVE_POINT),
        (shaders.SpotLight, RELATIVE_SPOT),
    ],
)
def test_a_struct_in_a_storage_buffer_lies_as_the_scenes_array(
    struct: type[Struct], dtype: np.dtype[Any]
) -> None:
    assert fields(struct.dtype) == fields(dtype)
    assert struct.dtype.itemsize == dtype.itemsize


def test_a_vertex_has_the_names_that_the_shaders_read() -> None:
    assert struct_names(shaders.Vertex) == VERTEX.names


def struct_names(struct: type[Struct]) -> tuple[str, ...]:
    return tuple(struct.dtype.names or ())
