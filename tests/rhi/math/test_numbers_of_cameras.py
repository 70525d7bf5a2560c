"""Numbers of cameras and projections: what isn't a finite number is refused by a rule, and nothing else is
raised."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from hostile_numbers import list_accepted

import rhi.math as rm

PROJECTION = rm.Perspective()
AXES = np.eye(3)
MATRICES = np.eye(4)[None]
Call = tuple[Callable[..., object], dict[str, Any], frozenset[str]]


def call(function: Callable[..., object], *stacks: str, **good: Any) -> Call:
    """A call, and the parameters that take stacks of arrays, in which NaN may be."""
    return function, good, frozenset(stacks)


CALLS: dict[str, Call] = {
    "Perspective": call(rm.Perspective, fov=1.0, aspect=1.5, near=0.1, far=100.0),
    "Orthographic": call(rm.Orthographic, height=2.0, aspect=1.5, near=0.1, far=100.0),
    "perspective": call(rm.perspective, fov=1.0, aspect=1.5, near=0.1, far=100.0),
    "orthographic": call(rm.orthographic, left=-2.0, right=2.0, bottom=-2.0, top=2.0, near=-1.0, far=1.0),
    "Camera.look_at": call(
        rm.Camera.look_at, position=(3.0, 1.0, 2.0), target=(0.0, 0.0, 0.5), up=(0.0, 1.0, 0.0)
    ),
    "look_at": call(rm.look_at, eye=(3.0, 1.0, 2.0), target=(0.0, 0.0, 0.5), up=(0.0, 1.0, 0.0)),
    "orbit": call(rm.orbit, target=(0.0, 1.0, 2.0), distance=2.0, yaw=0.1, pitch=0.2),
    "yaw_pitch_rotation": call(rm.yaw_pitch_rotation, yaw=0.1, pitch=0.2),
    "distance_at_depth": call(lambda depth: rm.distance_at_depth(PROJECTION.matrix, depth), depth=0.5),
    "make_sphere": call(rm.make_sphere, rings=4),
    "Camera": call(
        lambda position, rotation: rm.Camera(position, rotation, PROJECTION),
        "position",
        "rotation",
        position=(0.0, 1.0, 2.0),
        rotation=AXES,
    ),
    "normal_matrices": call(rm.normal_matrices, "matrices", matrices=MATRICES),
    "is_affine": call(rm.is_affine, "matrices", matrices=MATRICES),
    "transform_bounds": call(
        rm.transform_bounds, "matrices", "lower", "upper", matrices=MATRICES, lower=-AXES[:1], upper=AXES[:1]
    ),
}
IN_STACKS = ("NaN", "NaN in lists", "infinity", "an axis more")
"""Stacks of matrices and boxes compute with NaN as NumPy does; scenes refuse the result. A camera's arrays are
looked at where it is used."""


@pytest.mark.filterwarnings("ignore:invalid value:RuntimeWarning")
@pytest.mark.parametrize("name", CALLS)
def test_a_camera_takes_finite_numbers_only(name: str) -> None:
    function, good, stacks = CALLS[name]
    accepted = (entry.partition(": ") for entry in list_accepted(function, good))
    assert [entry for entry in accepted if not (entry[0] in stacks and entry[2] in IN_STACKS)] == []


@pytest.mark.parametrize("rings", [2, np.int64(3), 180])
def test_a_sphere_has_indices_of_its_vertices(rings: int) -> None:
    positions, indices = rm.make_sphere(rings)
    assert indices.max() == len(positions) - 1
    assert np.isfinite(positions).all()


def test_a_camera_of_lists_is_a_camera_of_arrays() -> None:
    camera = rm.Camera([0, 1, 2], AXES.tolist(), PROJECTION)  # type: ignore[arg-type]
    assert camera.position.dtype == camera.rotation.dtype == np.float64
    assert (camera.view == rm.Camera(np.array([0.0, 1, 2]), AXES, PROJECTION).view).all()
