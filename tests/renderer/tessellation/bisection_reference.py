"""Height fields, the keys of their triangles, and which keys a view calls for: with NumPy, apart from the
shaders."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from renderer.scene import (
    Camera,
    HeightField,
    Orthographic,
    Perspective,
    Scene,
    SceneBuilder,
    make_height_field,
)
from renderer.tessellation.kernels import SurfaceView

HEIGHT = 96
"""Height of the images that views are chosen for, in pixels; they are twice as wide."""


def make_hills(cells: int = 32, size: float = 256.0, seed: int = 1, limit: int = 1 << 18) -> HeightField:
    """Make a rough field with slopes in all directions."""
    along = np.linspace(0.0, 9.0, cells + 1)
    waves = np.sin(along)[:, None] * np.cos(1.3 * along)[None, :]
    rough = np.random.default_rng(seed).random((cells + 1, cells + 1))
    return make_height_field(size * (0.08 * waves + 0.03 * rough), size, limit=limit)


def make_scene(field: HeightField, local: Any = None) -> Scene:
    """Make a scene of one field under a sun."""
    builder = SceneBuilder("field")
    builder.add_objects(builder.add_node(local), builder.add_height_field(field), builder.add_material())
    builder.lights.add_directional((-0.5, -0.8, -0.3))
    return builder.build()


def list_cameras() -> dict[str, Camera]:
    """Return cameras in and around a field of 256 m at the origin: random ones, and hard cases."""
    rng = np.random.default_rng(7)
    projection = Perspective(fov=0.9, aspect=2.0, near=0.5)
    cameras = {
        f"random {number}": Camera.look_at(
            rng.uniform((-160, 0, -160), (160, 90, 160)),
            rng.uniform((-128, -20, -128), (128, 20, 128)),
            projection=projection,
        )
        for number in range(8)
    }
    high = Orthographic(120.0, aspect=2.0, far=900.0)
    return cameras | {
        "below the ground": Camera.look_at((3.0, -60.0, 5.0), (20.0, 0.0, 30.0), projection=projection),
        "far away": Camera.look_at(
            (1e5, 3e4, -1e5), (0.0, 0.0, 0.0), projection=Perspective(fov=0.002, aspect=2.0)
        ),
        "straight down": Camera.look_at((1.0, 200.0, 1.0), (1.0, 0.0, 1.0), projection=projection),
        "off the edge": Camera.look_at((140.0, 4.0, 0.0), (300.0, 0.0, 0.0), projection=projection),
        "parallel": Camera.look_at((200.0, 200.0, 200.0), (0.0, 0.0, 0.0), projection=high),
    }


def decode(keys: NDArray[np.int64], width: int) -> NDArray[np.int64]:
    """Return the triangles (k, 3) of keys (k,): 2 and 3 are the halves of the field, and the bits after the
    second are the children from the root down, 0 the one at the left end of the longest edge."""
    last = width * width - 1
    roots = np.array([(0, last - width + 1, last), (last, width - 1, 0)])
    depth = np.floor(np.log2(keys)).astype(np.int64) - 1
    triangles = roots[keys >> depth & 1]
    for level in range(int(depth.max(initial=0))):
        deeper = depth > level
        goes_right = keys >> np.maximum(depth - level - 1, 0) & 1 == 1
        left, apex, right = triangles.T
        middle = (left + right) // 2
        children = np.stack(
            [np.where(goes_right, right, apex), middle, np.where(goes_right, apex, left)], axis=1
        )
        triangles = np.where(deeper[:, None], children, triangles)
    return triangles


def compute_keys(field: HeightField, view: SurfaceView) -> tuple[NDArray[np.int64], bool]:
    """Return the keys of the triangles that a view calls for, and whether there would be more than the
    limit."""
    width = len(field.heights)
    splitting = should_split(field, view)
    keys, leaf_keys = np.array([2, 3]), [np.zeros(0, np.int64)]
    for _ in range(field.levels):
        triangles = decode(keys, width)
        middle = (triangles[:, 0] + triangles[:, 2]) // 2
        splits = splitting[middle]
        if sum(map(len, leaf_keys)) + len(keys) + int(splits.sum()) > field.limit:
            return np.concatenate([*leaf_keys, keys]), True
        leaf_keys.append(keys[~splits])
        keys = (2 * keys[splits, None] + (0, 1)).reshape(-1)
    return np.concatenate([*leaf_keys, keys]), False


def should_split(field: HeightField, view: SurfaceView) -> NDArray[np.bool_]:
    """Return for each vertex whether the edges that it is the middle of are split, in float32 step by
    step."""
    f32 = np.float32
    length, reach = (np.nextafter(bound.reshape(-1).astype(f32), f32(np.inf)) for bound in field.bounds)
    p = field.positions().reshape(-1, 3).astype(f32).T

    def along(n: Any) -> NDArray[np.float32]:
        return f32(n[0]) * p[0] + f32(n[1]) * p[1] + f32(n[2]) * p[2]

    perspective, far = f32(view.is_perspective), np.asarray(view.depth, f32)
    is_large = along(far) - perspective * reach - length * f32(view.scale) <= far[3]
    for plane in np.asarray(view.planes, f32):
        is_large &= along(plane) + reach >= plane[3]
    eye = np.asarray(view.eye, f32)
    away = [coordinate - centre for coordinate, centre in zip(p, eye, strict=True)]
    near = length * f32(view.out_of_view_scale) + perspective * reach
    square = away[0] * away[0] + away[1] * away[1] + away[2] * away[2]
    result: NDArray[np.bool_] = is_large | (
        perspective * f32(view.squared_axis_ratio) * square + (f32(1) - perspective) <= near * near
    )
    return result


def check_conforming(triangles: NDArray[np.int64], width: int) -> None:
    """Assert that triangles cover a field of `width` × `width` vertices once, without a crack: that every
    edge inside belongs to exactly two of them, which run along it in opposite directions."""
    rows, columns = np.divmod(triangles, width)
    (x, y, z), (u, v, w) = columns.T, rows.T
    areas = (y - x) * (w - u) - (z - x) * (v - u)
    assert (areas < 0).all()  # counter-clockwise from above, where rows run downwards
    assert -areas.sum() == 2 * (width - 1) ** 2
    edges = np.concatenate([triangles[:, [0, 1]], triangles[:, [1, 2]], triangles[:, [2, 0]]])
    forward = edges[:, 0] * width * width + edges[:, 1]
    backward = edges[:, 1] * width * width + edges[:, 0]
    assert len(np.unique(forward)) == len(forward)
    alone = edges[~np.isin(forward, backward)]
    rows, columns = np.divmod(alone, width)
    last = width - 1
    at_border = [(part == end).all(1) for part in (rows, columns) for end in (0, last)]
    assert np.any(at_border, axis=0).all()
