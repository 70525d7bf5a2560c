"""Cells: the parts into which a grid divides a view, and the shapes that lights are tested against.

A cell is what a rectangle of pixels sees between two depths: a tile of the image, or a cluster, which is one
depth slice of a tile. All of it is in *eye space*: x to the right, y up, z ahead, in metres from the eye. So
z is a distance, where view space would have it negative.

Whatever the projection, the four sides of a cell are straight in z: its left side is at `low.x + low_slope.x
· z`. For a perspective projection the offsets are 0, for a parallel one the slopes are; an off-axis eye only
shifts the slopes. So ten numbers are a cell, no projection is a special case, and neighbours share their
sides to the last bit.

The functions run in float32 on every device, and in float64 on NumPy with `evaluate`.
"""

from __future__ import annotations

from typing import Final

import rhi.shading as sl

PADDING: Final = 2.0**-20
"""The share of a test's lengths by which a radius is enlarged, for the rounding of float32."""
DEPTH_SLACK: Final = 2.0**-22
"""The error of a depth in a texture: at most this share of it, and a quarter of that absolutely. Rasterisers
interpolate depth in float32."""
MASK_SLICES: Final = 32
"""Number of depth slices of a tile that its mask tells apart."""


class Cell(sl.Struct):
    """A part of the view in eye space: between the depths `near` and `far`, and in x and y between
    `low + low_slope · z` and `high + high_slope · z`. It is empty if `near` > `far`."""

    low: sl.vec2
    low_slope: sl.vec2
    high: sl.vec2
    high_slope: sl.vec2
    near: float
    far: float


class ClusterGrid(sl.Struct):
    """A view that is divided into cells.

    The side of an image at pixel p, counted from the top left corner, is `offset + offset_step · p` at the
    eye, and changes by `slope + slope_step · p` for each metre of depth. `count` is the number of columns,
    rows and slices, `tile` the side of a tile in pixels; `near` and `far` are the ends of the first and the
    last slice.

    Slice i of n begins at `slice_end · 2^((i - n) · slice_rate)`; if the rate is 0, all slices are equally
    long. A depth d in a texture is a distance of `(depth.x - depth.y · d) / (depth.z - depth.w · d)`;
    `background` is the depth of pixels where nothing is drawn.
    """

    offset: sl.vec2
    offset_step: sl.vec2
    slope: sl.vec2
    slope_step: sl.vec2
    depth: sl.vec4
    count: sl.ivec3
    tile: int
    size: sl.ivec2
    near: float
    far: float
    slice_end: float
    slice_rate: float
    background: float


@sl.function
def block_cell(grid: ClusterGrid, tile: sl.ivec2, across: int, near: float, far: float) -> Cell:
    """Return the cell of a block of `across` × `across` tiles, the first of which is `tile`, between two
    depths. At the image's right and lower edge it ends with the image."""
    first = tile * grid.tile
    last = sl.min(first + across * grid.tile, grid.size)
    lower = sl.vec2(sl.ivec2(first.x, last.y))  # pixel rows count downwards
    upper = sl.vec2(sl.ivec2(last.x, first.y))
    return Cell(
        low=grid.offset + grid.offset_step * lower,
        low_slope=grid.slope + grid.slope_step * lower,
        high=grid.offset + grid.offset_step * upper,
        high_slope=grid.slope + grid.slope_step * upper,
        near=near,
        far=far,
    )


@sl.function
def slice_start(grid: ClusterGrid, index: int) -> float:
    """Return the depth at which a slice begins. The first one begins at the near plane, and where an index is
    the number of slices, that is the end of the grid."""
    if index <= 0:
        return grid.near
    if index >= grid.count.z:
        return grid.far
    if grid.slice_rate > 0.0:
        return grid.slice_end * sl.exp2(float(index - grid.count.z) * grid.slice_rate)
    return grid.near + (grid.slice_end - grid.near) * (float(index) / float(grid.count.z))


@sl.function
def slice_index(grid: ClusterGrid, z: float) -> int:
    """Return the slice that a depth is in; before the first and behind the last slice, that one.

    The formula gives a first guess, `slice_start` decides. So what a shader looks up is what was culled,
    whatever a device's logarithm is.
    """
    count = grid.count.z
    guess = 0.0
    if grid.slice_rate > 0.0:
        guess = sl.log2(sl.max(z, 1e-30) / grid.slice_end) / grid.slice_rate + float(count)
    else:
        guess = (z - grid.near) / (grid.slice_end - grid.near) * float(count)
    index = int(sl.clamp(sl.floor(guess), 0.0, float(count - 1)))
    while index > 0 and z < slice_start(grid, index):
        index -= 1
    while index < count - 1 and z >= slice_start(grid, index + 1):
        index += 1
    return index


@sl.function
def cell_index(grid: ClusterGrid, pixel: sl.ivec2, z: float) -> int:
    """Return the index of the cell that a pixel's surface at depth `z` is in. Cells are counted row by row,
    then slice by slice."""
    tile = pixel // grid.tile
    return (slice_index(grid, z) * grid.count.y + tile.y) * grid.count.x + tile.x


@sl.function
def depth_to_distance(grid: ClusterGrid, depth: float) -> float:
    """Return the distance, along the view, of a depth in a texture; within the grid's ends, also at
    infinity."""
    below = grid.depth.z - grid.depth.w * depth
    if below == 0.0:
        return grid.far
    return sl.clamp((grid.depth.x - grid.depth.y * depth) / below, grid.near, grid.far)


@sl.function
def rounded_distance_range(grid: ClusterGrid, depth: float) -> sl.vec2:
    """Return the least and the greatest distance of a surface whose depth, as the texture holds it, is
    rounded."""
    slack = DEPTH_SLACK * (depth + 0.25)
    first = depth_to_distance(grid, sl.clamp(depth - slack, 0.0, 1.0))
    other = depth_to_distance(grid, sl.clamp(depth + slack, 0.0, 1.0))
    return sl.vec2(sl.min(first, other), sl.max(first, other))


@sl.function
def distance_range(grid: ClusterGrid, least: float, greatest: float) -> sl.vec2:
    """Return the least and the greatest distance of surfaces whose depths lie between two depths of a
    texture; if `least` is above `greatest` there are none, and the range is empty, as that of an empty
    cell."""
    if least > greatest:
        return sl.vec2(1.0, 0.0)
    first = rounded_distance_range(grid, least)
    other = rounded_distance_range(grid, greatest)
    return sl.vec2(sl.min(first.x, other.x), sl.max(first.y, other.y))


@sl.function
def depth_bits(near: float, far: float, low: float, high: float) -> sl.uint:
    """Return the slices between the depths `low` and `high`, a bit for each of the 32 slices of a range.

    All slices of a flat range, `near` = `far`, are the first one. Rounding can't separate what touches: a
    slice's number never falls as depth grows.
    """
    scale = float(MASK_SLICES) / (far - near) if far > near else 0.0
    last = float(MASK_SLICES - 1)
    first_bit = int(sl.clamp(sl.floor((low - near) * scale), 0.0, last))
    last_bit = int(sl.clamp(sl.floor((high - near) * scale), 0.0, last))
    return (sl.uint(0xFFFFFFFF) << sl.uint(first_bit)) & (
        sl.uint(0xFFFFFFFF) >> sl.uint(MASK_SLICES - 1 - last_bit)
    )


@sl.function
def padded_radius(cell: Cell, centre: sl.vec3, radius: float) -> float:
    """Return a radius with which tests in float32 find all that they would find without rounding: larger by
    2^-20 of the greatest coordinates."""
    reach = sl.max(sl.abs(cell.near), sl.abs(cell.far))
    sides = (
        sl.max(sl.abs(cell.low), sl.abs(cell.high))
        + sl.max(sl.abs(cell.low_slope), sl.abs(cell.high_slope)) * reach
    )
    away = sl.abs(centre)
    return radius + PADDING * (radius + reach + sides.x + sides.y + away.x + away.y + away.z)


@sl.function
def relative_cell(cell: Cell, origin: sl.vec3) -> Cell:
    """Return the same cell with the origin at `origin`."""
    return Cell(
        low=cell.low + cell.low_slope * origin.z - origin.xy,
        low_slope=cell.low_slope,
        high=cell.high + cell.high_slope * origin.z - origin.xy,
        high_slope=cell.high_slope,
        near=cell.near - origin.z,
        far=cell.far - origin.z,
    )


@sl.function
def corner(cell: Cell, index: int) -> sl.vec3:
    """Return one of the eight corners: bit 0 of the index says right, bit 1 top, bit 2 far."""
    z = cell.far if index >= 4 else cell.near
    low = cell.low + cell.low_slope * z
    high = cell.high + cell.high_slope * z
    return sl.vec3(high.x if index % 2 == 1 else low.x, high.y if index // 2 % 2 == 1 else low.y, z)


@sl.function
def extent_along(cell: Cell, axis: sl.vec3) -> sl.vec2:
    """Return the least and the greatest value of `dot(axis, p)` in a cell."""
    across = axis.xy
    near_low = across * (cell.low + cell.low_slope * cell.near)
    near_high = across * (cell.high + cell.high_slope * cell.near)
    far_low = across * (cell.low + cell.low_slope * cell.far)
    far_high = across * (cell.high + cell.high_slope * cell.far)
    near = axis.z * cell.near
    far = axis.z * cell.far
    least_near = sl.min(near_low, near_high)
    least_far = sl.min(far_low, far_high)
    most_near = sl.max(near_low, near_high)
    most_far = sl.max(far_low, far_high)
    return sl.vec2(
        sl.min(least_near.x + least_near.y + near, least_far.x + least_far.y + far),
        sl.max(most_near.x + most_near.y + near, most_far.x + most_far.y + far),
    )


@sl.function
def squared_distance(cell: Cell) -> float:
    """Return the squared distance of a cell that isn't empty from the origin.

    At depth z the cell is a rectangle, at a squared distance of `x² + y² + z²`, where x and y are 0 if the
    rectangle spans 0 there. That is convex in z and smooth. With each of none, the low and the high side
    nearest in x and in y it is a parabola, and its least value lies at the lowest point of one of the nine,
    or at an end. Every value is the distance of some point of the cell, so the least is exact and never too
    small.
    """
    low = cell.low * cell.low_slope
    high = cell.high * cell.high_slope
    low_square = cell.low_slope * cell.low_slope
    high_square = cell.high_slope * cell.high_slope
    best = _square_at(cell, 0.0)
    for x in range(3):
        product = 0.0 if x == 0 else low.x if x == 1 else high.x
        square = 1.0 if x == 0 else 1.0 + (low_square.x if x == 1 else high_square.x)
        best = sl.min(best, _square_at(cell, -product / square))
        best = sl.min(best, _square_at(cell, -(product + low.y) / (square + low_square.y)))
        best = sl.min(best, _square_at(cell, -(product + high.y) / (square + high_square.y)))
    return best


@sl.function
def _square_at(cell: Cell, z: float) -> float:
    """Return the squared distance of the rectangle at the depth nearest to `z` from the origin."""
    at = sl.clamp(z, cell.near, cell.far)
    gap = sl.max(sl.max(cell.low + cell.low_slope * at, -(cell.high + cell.high_slope * at)), sl.vec2(0.0))
    return sl.dot(gap, gap) + at * at
