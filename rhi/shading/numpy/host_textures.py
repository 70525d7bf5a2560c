"""Textures in NumPy arrays, sampled as specified by OpenGL 4.3, chapter 8.14: the reference of accuracy.

Arguments are numbers or arrays that broadcast. Coordinates have three components, of which a 2D texture
ignores the third. Everything is computed in `dtype`, float32 or float64, with weights of full precision.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from rhi.contract.descriptors import Filter, SamplerDescriptor, TextureKind, Wrap
from rhi.contract.formats import Format
from rhi.contract.states import Comparison
from rhi.contract.texels import add_channel_axis, convert_float64, decode, encode, unpack
from rhi.errors import refuse
from rhi.errors.arguments import to_little_endian
from rhi.shading.ir.texture_words import anisotropy_of, border_color, has_fixed_depth
from rhi.shading.language import rules
from rhi.shading.numpy.runtime import clamp

Array = NDArray[Any]
FourArrays = tuple[Array, Array, Array, Array]
TexelComparison = Callable[[Array, Array], Array]
"""A function that compares texels with the references of the selected samples; its results are filtered."""

_COMPARISONS: Final[dict[Comparison, Callable[[Array, Array], Array]]] = {
    Comparison.NEVER: lambda reference, depth: np.zeros(np.shape(reference), bool),
    Comparison.LESS: np.less,
    Comparison.EQUAL: np.equal,
    Comparison.LESS_EQUAL: np.less_equal,
    Comparison.GREATER: np.greater,
    Comparison.NOT_EQUAL: np.not_equal,
    Comparison.GREATER_EQUAL: np.greater_equal,
    Comparison.ALWAYS: lambda reference, depth: np.ones(np.shape(reference), bool),
}
# For each face, the components that s, t and the major axis come from, and their signs; t points down. OpenGL
# 4.3, table 8.19.
_AXES: Final = np.array([(2, 1, 0), (2, 1, 0), (0, 2, 1), (0, 2, 1), (0, 1, 2), (0, 1, 2)])
_SIGNS: Final = np.array(
    [(-1, -1, 1), (1, -1, -1), (1, 1, 1), (1, -1, -1), (1, -1, 1), (-1, -1, -1)], np.float32
)


class HostTexture:
    """A texture or an image in host memory, for `run_compute` and its like.

    Attributes:
        levels: texels of each mip level as (layers, height, width, channels), in the format's dtype.
        format, kind, sampler: as for a texture of a device.
    """

    def __init__(
        self,
        levels: Array | Sequence[Array],
        format: Format,
        kind: TextureKind = TextureKind.D2,
        sampler: SamplerDescriptor | None = None,
    ) -> None:
        """Create a texture from copies of texels.

        Args:
            levels: one mip level or all of them, largest first. A single layer may be given as (height,
                width, channels), and with one channel as (height, width); layers of one channel as (layers,
                height, width). They are copied: later changes of the arrays don't change the texture.
            format: of the texels.
            kind: the dimensions.
            sampler: defaults to the sampler that a device's textures have by default.

        Raises:
            ValidationError `shading-arguments`: `levels` has another dtype or shape.
        """
        nearest = format.is_integer or format.is_depth
        default = (
            SamplerDescriptor(Filter.NEAREST, Filter.NEAREST, Filter.NEAREST)
            if nearest
            else SamplerDescriptor()
        )
        all_levels = [levels] if isinstance(levels, np.ndarray) else list(levels)
        self.levels = [_layered(level, format, kind) for level in all_levels]
        self.format = format
        self.kind = kind
        self.sampler = sampler or default

    # -- operations of shaders -----------------------------------------------------------------------------

    def sample(self, dtype: Any, u: Any, v: Any, z: Any, lod: Any) -> FourArrays:
        """Sample the texture at a level of detail."""
        result = self._sample_levels(dtype, u, v, z, lod)
        return tuple(result[..., c] for c in range(4))  # type: ignore[return-value]

    def sample_compare(self, dtype: Any, u: Any, v: Any, z: Any, reference: Any, lod: Any) -> tuple[Array]:
        """Compare each texel with a reference, and return the filtered results."""
        u, v, z, reference, lod = np.broadcast_arrays(u, v, z, reference, lod)
        result = self._sample_levels(
            dtype, u, v, z, lod, lambda texels, selected: self._compare(dtype, reference[selected], texels)
        )
        return (result[..., 0],)

    def sample_grad(self, dtype: Any, u: Any, v: Any, z: Any, *steps: Any) -> FourArrays:
        """Sample a pixel's area: `steps` are the six differences to the next pixels right and below, and a
        bias of the level."""
        result = self._average(dtype, (u, v, z), steps, partial(self._sample_levels, dtype))
        return tuple(result[..., c] for c in range(4))  # type: ignore[return-value]

    def sample_compare_grad(
        self, dtype: Any, u: Any, v: Any, z: Any, reference: Any, *steps: Any
    ) -> tuple[Array]:
        """Compare each texel with a reference, and return the filtered results over a pixel's area."""

        def sample(u: Any, v: Any, z: Any, lod: Any) -> Array:
            return self.sample_compare(dtype, u, v, z, reference, lod)[0][..., None]

        return (self._average(dtype, (u, v, z), steps, sample)[..., 0],)

    def gather(self, dtype: Any, component: int, u: Any, v: Any, z: Any) -> FourArrays:
        """Return one component of the four texels around a point: counterclockwise from the lower left, with
        v up."""
        taps, _ = self._taps(dtype, 0, *self._locate(dtype, u, v, z), in_order=True)
        return tuple(taps[tap][..., int(component)] for tap in (2, 3, 1, 0))  # type: ignore[return-value]

    def gather_compare(self, dtype: Any, u: Any, v: Any, z: Any, reference: Any) -> FourArrays:
        """Compare the four texels around a point with a reference, in the order of `gather`."""
        u, v, z, reference = np.broadcast_arrays(u, v, z, reference)
        where = self._locate(dtype, u, v, z)
        taps, _ = self._taps(dtype, 0, *where, lambda texels: self._compare(dtype, reference, texels), True)
        return tuple(taps[tap][..., 0] for tap in (2, 3, 1, 0))  # type: ignore[return-value]

    def load(self, dtype: Any, x: Any, y: Any, z: Any, level: Any) -> FourArrays:
        """Read one texel; zeros outside the texture."""
        x, y, z, level = np.broadcast_arrays(x, y, z, level)
        result = np.zeros((*x.shape, 4), self._value_dtype(dtype))
        for number in range(len(self.levels)):
            depth, height, width, _ = self.levels[number].shape
            inside = (
                (level == number) & (x >= 0) & (x < width) & (y >= 0) & (y < height) & (z >= 0) & (z < depth)
            )
            result[inside] = self._values(dtype, number, z[inside], y[inside], x[inside])
        return tuple(result[..., c] for c in range(4))  # type: ignore[return-value]

    def store(
        self, x: Any, y: Any, z: Any, values: tuple[Any, ...], mask: Any, shape: tuple[int, ...]
    ) -> None:
        """Write texels of level 0; writes outside are dropped, and the last of several values for a texel
        stays."""
        texels = self.levels[0]
        depth, height, width, _ = texels.shape
        x, y, z, mask, *parts = np.broadcast_arrays(
            x, y, z, True if mask is None else mask, *values, np.empty(shape)
        )[:-1]
        inside = mask & (x >= 0) & (x < width) & (y >= 0) & (y < height) & (z >= 0) & (z < depth)
        whole = np.stack([part[inside] for part in parts], -1)[:, : self.format.channels]
        integer = self.format.is_integer and not self.format.is_packed
        stored = whole.astype(texels.dtype) if integer else encode(self.format, whole.astype(np.float64))
        texels[z[inside], y[inside], x[inside]] = stored

    def size(self, level: Any, axes: int) -> tuple[Array, ...]:
        """Return width, height, and depth or layers of a level, or of the nearest level that exists."""
        sizes = np.array([texels.shape[2::-1] for texels in self.levels], np.int32)
        level = clamp(level, len(sizes))
        return tuple(sizes[level, axis] for axis in range(axes))

    def count_levels(self) -> tuple[np.int32]:
        """Return the number of mip levels."""
        return (np.int32(len(self.levels)),)

    # -- texels --------------------------------------------------------------------------------------------

    def _value_dtype(self, dtype: Any) -> Any:
        if self.format.is_integer:
            return np.int32 if self.format.dtype.kind == "i" else np.uint32
        return dtype

    def _values(self, dtype: Any, level: int, z: Array, y: Array, x: Array) -> Array:
        """Return texels as shaders read them: four components."""
        texels = self.levels[level][z, y, x]
        values = unpack(self.format, texels) if self.format.is_integer else decode(self.format, texels)
        result = np.zeros((*texels.shape[:-1], 4), self._value_dtype(dtype))
        result[..., 3] = 1
        result[..., : values.shape[-1]] = values
        return result

    def _compare(self, dtype: Any, reference: Array, texels: Array) -> Array:
        """Compare references with depths; returns 1 or 0 as texels of one component."""
        depth = texels[..., :1]
        if self.sampler.compare is None:
            return depth
        if has_fixed_depth(self.format):
            reference = np.fmax(np.fmin(reference, 1), 0)
        return _COMPARISONS[self.sampler.compare](reference[..., None].astype(dtype), depth).astype(dtype)

    def _tap(self, dtype: Any, level: int, z: Array, y: Array, x: Array) -> Array:
        """Return texels, or the border color outside the level."""
        depth, height, width, _ = self.levels[level].shape
        i, j, k = clamp(x, width), clamp(y, height), clamp(z, depth)
        values = self._values(dtype, level, k, j, i)
        values[(i != x) | (j != y) | (k != z)] = border_color(self.format, self.sampler).astype(values.dtype)
        return values

    # -- coordinates ---------------------------------------------------------------------------------------

    def _locate(self, dtype: Any, u: Any, v: Any, z: Any) -> tuple[Array, Array, Array]:
        """Return normalized coordinates in a layer and the layer; for a cube, in a face and the face."""
        at = np.stack(np.broadcast_arrays(u, v, z), -1).astype(dtype)
        if self.kind is TextureKind.CUBE:
            face = _face_of(at)
            s, t, m = _project(face, at)
            return s / m * dtype(0.5) + dtype(0.5), t / m * dtype(0.5) + dtype(0.5), face
        u, v, z = (at[..., axis] for axis in range(3))
        if self.kind is TextureKind.D2:
            return u, v, np.zeros(u.shape, np.int32)
        if self.kind is TextureKind.D2_ARRAY:
            last = dtype(self.levels[0].shape[0] - 1)
            return u, v, np.fmin(np.fmax(np.floor(z + dtype(0.5)), dtype(0)), last).astype(np.int32)
        return u, v, z

    def _wraps(self) -> tuple[Wrap, Wrap, Wrap]:
        if self.kind is TextureKind.CUBE:  # no wrapping: beyond an edge lies the next face
            return Wrap.BORDER, Wrap.BORDER, Wrap.BORDER
        return self.sampler.wrap_u, self.sampler.wrap_v, self.sampler.wrap_w

    def _nearest(self, dtype: Any, wrap: Wrap, size: int, u: Array) -> Array:
        i = np.floor(_wrap(dtype, wrap, size, u)).astype(np.int32)
        return i if wrap is Wrap.BORDER and self.kind is not TextureKind.CUBE else clamp(i, size)

    def _around(
        self, dtype: Any, wrap: Wrap, size: int, u: Array, in_order: bool = False
    ) -> tuple[Array, Array, Array]:
        """Return the texels before and after a coordinate, and the second one's weight. With `in_order` they
        are in the coordinate's order also where it is reflected; then the weight isn't right there."""
        x = _wrap(dtype, wrap, size, u) - dtype(0.5)
        whole = np.floor(x)
        i = whole.astype(np.int32)
        j = i + 1
        if in_order and wrap is Wrap.MIRROR:
            is_reflected = np.floor(u) % 2 == 1
            i = np.where(is_reflected, np.ceil(x).astype(np.int32), i)
            j = np.where(is_reflected, i - 1, j)
        if wrap is Wrap.REPEAT:
            i, j = i % size, j % size
        elif wrap is not Wrap.BORDER:
            i, j = clamp(i, size), clamp(j, size)
        return i, j, x - whole

    def _taps(
        self,
        dtype: Any,
        level: int,
        u: Array,
        v: Array,
        layer: Array,
        compare: Callable[[Array], Array] | None = None,
        in_order: bool = False,
    ) -> tuple[list[Array], tuple[Array, Array]]:
        """Return the four texels around a point in a layer, or their comparisons, and the second ones'
        weights; `in_order` as for `_around`."""
        compare = compare or (lambda texels: texels)
        _, height, width, _ = self.levels[level].shape
        wrap_u, wrap_v, _ = self._wraps()
        x0, x1, near_x = self._around(dtype, wrap_u, width, u, in_order)
        y0, y1, near_y = self._around(dtype, wrap_v, height, v, in_order)
        corners = [(x0, y0), (x1, y0), (x0, y1), (x1, y1)]
        if self.kind is not TextureKind.CUBE:
            return [compare(self._tap(dtype, level, layer, y, x)) for x, y in corners], (near_x, near_y)
        taps = [compare(self._values(dtype, level, *_cross_edges(width, layer, y, x))) for x, y in corners]
        result = []
        for tap, (x, y) in enumerate(
            corners
        ):  # where three faces meet, the missing texel is the mean of the others
            corner = ((x < 0) | (x >= width)) & ((y < 0) | (y >= height))
            mean = (taps[tap ^ 1] + taps[tap ^ 2] + taps[tap ^ 3]) / 3
            result.append(np.where(corner[..., None], mean.astype(taps[tap].dtype), taps[tap]))
        return result, (near_x, near_y)

    def _filter(
        self,
        dtype: Any,
        level: int,
        filter: Filter,
        samples: Array,
        u: Array,
        v: Array,
        z: Array,
        compare: TexelComparison | None = None,
    ) -> Array:
        """Filter a mip level at the coordinates of `samples`; `compare` is applied to texels before."""
        depth, height, width, _ = self.levels[level].shape
        wrap_u, wrap_v, wrap_w = self._wraps()
        solid = self.kind is TextureKind.D3
        if filter is Filter.NEAREST or self.format.is_integer:
            i = self._nearest(dtype, wrap_u, width, u)
            j = self._nearest(dtype, wrap_v, height, v)
            k = self._nearest(dtype, wrap_w, depth, z) if solid else z
            texels = self._tap(dtype, level, k, j, i)
            return compare(texels, samples) if compare is not None else texels
        slices = self._around(dtype, wrap_w, depth, z) if solid else (z, z, np.zeros(z.shape, dtype))
        means = []
        for layer in slices[: 2 if solid else 1]:
            taps, (near_x, near_y) = self._taps(
                dtype, level, u, v, layer, compare and (lambda tap: compare(tap, samples))
            )
            a, b = (_mix(taps[row], taps[row + 1], near_x) for row in (0, 2))
            means.append(_mix(a, b, near_y))
        return _mix(means[0], means[1], slices[2]) if solid else means[0]

    def _average(
        self, dtype: Any, at: Sequence[Any], steps: Sequence[Any], sample: Callable[..., Array]
    ) -> Array:
        """Return the mean of the samples over a pixel's area, or the sample at the level of the longer step.

        OpenGL 4.3, equations 8.5 and 8.8.

        An anisotropic sampler averages along the longer axis of the ellipse that the pixel covers, at the
        level of the shorter one. Each sample stands for a segment as long as the shorter axis. Segments are
        laid from both ends; the rest in the middle is one or two segments of less weight, so that no result
        jumps where one more is covered.
        """
        *steps, bias = np.broadcast_arrays(*(np.asarray(step, dtype) for step in steps))
        a, b = self._in_texels(dtype, at, [np.stack(step, -1) for step in (steps[:3], steps[3:])])
        aa, bb, ab = (np.sum(x * y, axis=-1) for x, y in ((a, a), (b, b), (a, b)))
        longer = np.maximum(aa, bb)
        anisotropy = anisotropy_of(self.format, self.sampler)
        if not anisotropy:
            return sample(*at, dtype(0.5) * np.log2(longer) + bias)
        regular = (longer > 2.0**-100) & (aa + bb < 2.0**100)
        scale = 1 / np.where(regular, longer, 1)
        half = (aa - bb) / 2 * scale
        product = ab * scale
        area = np.cross(a, b) * scale[..., None]
        spread = np.sqrt(half**2 + product**2)
        longest = (aa + bb) / 2 * scale + spread
        ratio = np.fmin(longest / np.sqrt(np.sum(area**2, axis=-1)), dtype(anisotropy))
        longest *= longer
        cell = np.fmax(longest / ratio**2, np.fmin(longest, 1))  # details below a texel aren't visible
        ratio = np.where(regular, np.fmax(np.sqrt(longest / cell), 1), 1).astype(dtype)
        lod = dtype(0.5) * np.log2(np.where(regular, cell, longer)) + bias
        right, down = np.where(half > 0, half + spread, product), np.where(half > 0, product, spread - half)
        length = np.hypot(right, down) * ratio
        turned = regular & (length > 0)
        further = [
            np.where(turned, (right * x + down * y) / np.where(turned, length, 1), 0)
            for x, y in zip(steps[:3], steps[3:], strict=True)
        ]
        left, total = ratio, dtype(0)
        while (left > 0).any():
            position, weight = np.maximum(left / 2 - dtype(0.5), 0), np.clip(left / 2, 0, 1)[..., None]
            for side in (position, -position):
                value = sample(*(x + side * step for x, step in zip(at, further, strict=True)), lod)
                total = total + np.where(weight > 0, weight * value, 0)
            left = left - 2
        mean: Array = total / ratio[..., None]
        return mean

    def _in_texels(self, dtype: Any, at: Sequence[Any], steps: list[Array]) -> list[Array]:
        """Return steps of coordinates, (…, 3), as steps in texels of the largest level."""
        layers, height, width, _ = self.levels[0].shape
        size = np.array([width, height, layers if self.kind is TextureKind.D3 else 0], dtype)
        if self.kind is TextureKind.CUBE:
            where, *steps = np.broadcast_arrays(np.stack(np.broadcast_arrays(*at), -1).astype(dtype), *steps)
            face = _face_of(where)
            s, t, m = _project(face, where)
            projected = [_project(face, step) for step in steps]
            steps = [
                np.stack([(ds - s / m * dm) / (2 * m), (dt - t / m * dm) / (2 * m), 0 * ds], -1)
                for ds, dt, dm in projected
            ]
        return [step * size for step in steps]

    def _sample_levels(
        self, dtype: Any, u: Any, v: Any, z: Any, lod: Any, compare: TexelComparison | None = None
    ) -> Array:
        """Filter each mip level for the samples that use it, and mix the results."""
        u, v, z = self._locate(dtype, u, v, z)
        lod = np.broadcast_to(np.asarray(lod, dtype), np.broadcast_shapes(np.shape(lod), u.shape))
        u, v, z = (np.broadcast_to(part, lod.shape) for part in (u, v, z))
        sampler, last = self.sampler, len(self.levels) - 1
        magnified = ~(lod > 0)
        mip = sampler.mip
        if mip is Filter.LINEAR and self.format.is_integer:
            mip = Filter.NEAREST
        at = np.where(magnified, dtype(0), np.minimum(lod, dtype(0 if mip is None else last)))
        first = np.round(at) if mip is Filter.NEAREST else np.floor(at)
        part = at - first if mip is Filter.LINEAR else np.zeros_like(at)
        result: Array | None = None
        for number in range(last + 1):
            weight = np.where(first == number, 1 - part, np.where(first == number - 1, part, 0)).astype(dtype)
            for selected_filter, lanes in ((sampler.minify, ~magnified), (sampler.magnify, magnified)):
                selected = (weight > 0) & lanes
                if not selected.any():
                    continue
                value = self._filter(
                    dtype, number, selected_filter, selected, u[selected], v[selected], z[selected], compare
                )
                if result is None:
                    result = np.zeros((*lod.shape, value.shape[-1]), value.dtype)
                whole = weight[selected][:, None] == 1
                with np.errstate(all="ignore"):
                    mixed = (result[selected] + weight[selected][:, None] * value).astype(value.dtype)
                result[selected] = np.where(whole, value, mixed)
        return result if result is not None else np.zeros((*lod.shape, 4), dtype)


def _layered(level: Array, format: Format, kind: TextureKind) -> Array:
    array = np.array(to_little_endian(np.asarray(level)), order="C")
    array = add_channel_axis(array, format.components, kind is not TextureKind.D2)
    converted = convert_float64(array, format)
    array = array if converted is None else converted
    if array.ndim == 2 and format.components == 1:
        array = array[None, :, :, None]
    elif array.ndim == 3:
        array = array[None]
    if array.dtype != format.dtype or array.ndim != 4 or array.shape[3] != format.components:
        allowed = f"(layers, height, width, {format.components}) of {format.dtype}"
        refuse(rules.WRONG_ARGUMENTS, "HostTexture", f"shape {np.shape(level)} of {array.dtype}", allowed)
    return array


def _mix(a: Array, b: Array, at: Array) -> Array:
    mixed: Array = a + at[..., None] * (b - a)
    return mixed


def _wrap(dtype: Any, wrap: Wrap, size: int, u: Array) -> Array:
    """Return a wrapped coordinate in texels, clamped to just outside, beyond which is only the border."""
    if wrap is Wrap.REPEAT:
        u = u - np.floor(u)
    elif wrap is Wrap.MIRROR:
        u = np.abs(u - 2 * np.floor(u / 2 + dtype(0.5)))
    beyond = 1 if wrap is Wrap.BORDER else 0.5
    texel: Array = np.fmin(np.fmax(u * dtype(size), dtype(-beyond)), dtype(size + beyond))
    return texel


def _face_of(at: Array) -> Array:
    """Return the face that a direction hits; among equal components z precedes y, and y precedes x, as on
    llvmpipe."""
    size = np.abs(at)
    axis = np.where(
        (size[..., 2] >= size[..., 0]) & (size[..., 2] >= size[..., 1]),
        2,
        np.where(size[..., 1] >= size[..., 0], 1, 0),
    )
    along = np.take_along_axis(at, axis[..., None], -1)[..., 0]
    return (2 * axis + (along < 0)).astype(np.int32)


def _project(face: Array, at: Array) -> tuple[Array, Array, Array]:
    """Return (s, t, m) of directions on a face; m is the length along the face's axis."""
    projected = np.take_along_axis(at, np.broadcast_to(_AXES[face], at.shape), -1) * _SIGNS[face].astype(
        at.dtype
    )
    return projected[..., 0], projected[..., 1], projected[..., 2]


def _cross_edges(size: int, face: Array, j: Array, i: Array) -> tuple[Array, Array, Array]:
    """Return (face, row, column) of texels; beyond an edge, of the texel that the direction of their center
    hits."""
    s, t = (2 * i + 1 - size) / size, (2 * j + 1 - size) / size
    at = np.empty((*s.shape, 3))
    projected = np.stack([s, t, np.ones(s.shape)], -1) * _SIGNS[face]
    np.put_along_axis(at, np.broadcast_to(_AXES[face], at.shape), projected, -1)
    next_face = _face_of(at)
    x, y, m = _project(next_face, at)
    outside = (i < 0) | (i >= size) | (j < 0) | (j >= size)
    column = np.clip(np.floor((x / m + 1) / 2 * size), 0, size - 1).astype(np.int32)
    row = np.clip(np.floor((y / m + 1) / 2 * size), 0, size - 1).astype(np.int32)
    return np.where(outside, next_face, face), np.where(outside, row, j), np.where(outside, column, i)
