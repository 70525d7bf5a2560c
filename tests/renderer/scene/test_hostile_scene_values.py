"""Values that a scene is built from: numbers, or a refusal by a rule, whatever NumPy would convert them to."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from renderer.scene import SceneBuilder, make_geometry, make_material
from rhi import RhiError

SQUARE = [(0.0, 0.0, 0.0), (1.0, 0.0, 0.0), (1.0, 1.0, 0.0), (0.0, 1.0, 0.0)]
HOSTILE: dict[str, Callable[[Any], Any]] = {
    "complex": lambda good: np.asarray(good) + 0.5j,
    "masked": lambda good: np.ma.masked_array(good, mask=True),
    "texts": lambda good: np.asarray(good).astype(str),
    "dates": lambda good: np.full(np.shape(good), np.datetime64("2020-01-01")),
    "objects": lambda good: np.full(np.shape(good), None),
    "a set": lambda good: set(np.ravel(good).tolist()),
    "a dict": lambda good: dict.fromkeys(np.ravel(good).tolist()),
    "ragged": lambda good: [[1.0, 2.0], [3.0]],
    "a generator": lambda good: (value for value in np.ravel(good)),
}
CALLS: dict[str, tuple[Any, Callable[[Any], object]]] = {
    "positions": (SQUARE, lambda v: make_geometry(v, [0, 1, 2])),
    "indices": ([0, 1, 2, 0, 2, 3], lambda v: make_geometry(SQUARE, v)),
    "normals": (SQUARE, lambda v: make_geometry(SQUARE, [0, 1, 2], normals=v)),
    "uv": ([(0.0, 0.0)] * 4, lambda v: make_geometry(SQUARE, [0, 1, 2], uv=v)),
    "color": ([(0.0, 0.0, 0.0, 1.0)] * 4, lambda v: make_geometry(SQUARE, [0, 1, 2], color=v)),
    "base color": ((0.5, 0.5, 0.5), lambda v: make_material(base_color=v)),
    "roughness": (0.5, lambda v: make_material(roughness=v)),
    "emission": (0.5, lambda v: make_material(emission=v)),
    "node": (np.eye(4), lambda v: SceneBuilder("test").add_node(v)),
    "nodes": (np.eye(4)[None], lambda v: SceneBuilder("test").add_nodes(v)),
}


@pytest.fixture(autouse=True)
def silent_warnings() -> Any:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        yield


@pytest.mark.parametrize("kind", HOSTILE)
@pytest.mark.parametrize("name", CALLS)
def test_a_scene_refuses_values_that_are_not_numbers(name: str, kind: str) -> None:
    good, call = CALLS[name]
    with pytest.raises(RhiError):
        call(HOSTILE[kind](good))


@pytest.mark.parametrize("name", CALLS)
def test_a_scene_takes_numbers(name: str) -> None:
    good, call = CALLS[name]
    call(good)
    call(np.asarray(good))
