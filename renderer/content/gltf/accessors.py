"""Accessors: arrays in the buffers of a glTF file.

An accessor is a view of its buffer wherever that is possible: strides (interleaved vertices), offsets and
component types are NumPy's. Only sparse and normalised accessors are copied. Each is read once, whatever
refers to it.
"""

from __future__ import annotations

from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from renderer.content.gltf.container import GltfFile
from renderer.content.gltf.document import JsonObject
from renderer.scene.arrays import Floats

_COMPONENTS: Final[dict[int, np.dtype[Any]]] = {
    5120: np.dtype("<i1"),
    5121: np.dtype("<u1"),
    5122: np.dtype("<i2"),
    5123: np.dtype("<u2"),
    5125: np.dtype("<u4"),
    5126: np.dtype("<f4"),
}
_SIZES: Final = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT2": 4, "MAT3": 9, "MAT4": 16}


class Accessors:
    """The accessors of a file.

    Attributes:
        file: the file.
        fields: the accessors as they stand in the document.
    """

    def __init__(self, file: GltfFile) -> None:
        self.file = file
        self.fields = file.root.children("accessors")
        self._arrays: dict[int, NDArray[Any]] = {}

    def __len__(self) -> int:
        return len(self.fields)

    def array(self, number: int, types: tuple[str, ...] | str, components: str = "biuf") -> NDArray[Any]:
        """Return the elements (n, size) of an accessor as they are stored; scalars are (n,).

        Args:
            types: the type, or the types, that are allowed here, such as VEC3.
            components: the kinds of components that are allowed, as NumPy's letters: i, u, f.
        """
        fields = self.fields[number]
        allowed_types = (types,) if isinstance(types, str) else types
        kind = fields.choice("type", _SIZES)
        if kind not in allowed_types:
            fields.refuse("type", kind, ", ".join(allowed_types))
        dtype = _component(fields)
        if dtype.kind not in components:
            fields.refuse("componentType", int(fields.values["componentType"]), _list_components(components))
        if number not in self._arrays:
            self._arrays[number] = self._read(fields, dtype, _SIZES[kind])
            self._arrays[number].flags.writeable = False
        elements = self._arrays[number]
        return elements[:, 0] if kind == "SCALAR" else elements

    def floats(self, number: int, types: tuple[str, ...] | str) -> NDArray[np.float32]:
        """Return the elements (n, size) of an accessor as float32: normalised integers are in -1 to 1 or 0 to
        1."""
        array = self.array(number, types)
        if array.dtype.kind == "f":
            return array
        values = array.astype(np.float32)
        if self.fields[number].flag("normalized"):
            # The quotient is rounded once, so that it is the float32 nearest to c / 255.
            values = (array / np.float64(np.iinfo(array.dtype).max)).astype(np.float32)
            values = np.maximum(values, np.float32(-1.0))
        return values

    def times(self, number: int) -> Floats:
        """Return the times (n,) of an animation's keys, ascending."""
        seconds = self.array(number, "SCALAR", "f").astype(np.float64)
        fields = self.fields[number]
        if not np.isfinite(seconds).all() or not (np.diff(seconds) >= 0.0).all() or seconds[0] < 0.0:
            fields.refuse("", "times that aren't ascending", "finite seconds, 0 or more, ascending")
        return seconds

    def _read(self, fields: JsonObject, dtype: np.dtype[Any], size: int) -> NDArray[Any]:
        view = fields.index("bufferView", len(self.file.views))
        count = fields.whole("count", low=1, high=2**32)
        if view >= 0:
            stride = self.file.views[view].whole("byteStride", 0, 0, 252)
            array = self._elements(fields, view, fields.whole("byteOffset", 0), count, dtype, size, stride)
        else:
            self.file.budget.spend_zeros(count)
            array = np.zeros((count, size), dtype)
        return self._apply_sparse(fields, array) if "sparse" in fields else array

    def _elements(
        self,
        fields: JsonObject,
        view: int,
        offset: int,
        count: int,
        dtype: np.dtype[Any],
        size: int,
        stride: int,
    ) -> NDArray[Any]:
        """Return `count` elements (count, size) of a buffer view; they must lie within it."""
        data = self.file.view(view)
        element = dtype.itemsize * size
        step = stride or element
        if step < element:
            self.file.views[view].refuse("byteStride", step, f"{element} or more, for {fields.where}")
        end = offset + step * (count - 1) + element
        if end > len(data):
            fields.refuse("", f"bytes {offset:,} to {end:,} of bufferViews[{view}]", f"0 to {len(data):,}")
        return np.ndarray((count, size), dtype, data, offset, (step, dtype.itemsize))

    def _apply_sparse(self, fields: JsonObject, base: NDArray[Any]) -> NDArray[Any]:
        """Return a copy of an accessor in which its sparse elements are replaced."""
        sparse = fields.child("sparse")
        count = sparse.whole("count", low=1, high=len(base))
        where, what = sparse.child("indices"), sparse.child("values")
        views = len(self.file.views)
        kind = _component(where)
        if kind.kind != "u":
            where.refuse("componentType", int(where.values["componentType"]), _list_components("u"))
        rows = self._elements(
            where,
            where.index("bufferView", views, required=True),
            where.whole("byteOffset", 0),
            count,
            kind,
            1,
            0,
        )[:, 0].astype(np.int64)
        if rows.max() >= len(base):
            where.refuse("", f"index {rows.max()}", f"0 to {len(base) - 1}")
        values = self._elements(
            what,
            what.index("bufferView", views, required=True),
            what.whole("byteOffset", 0),
            count,
            base.dtype,
            base.shape[1],
            0,
        )
        changed = base.copy()
        changed[rows] = values
        return changed


def _component(fields: JsonObject) -> np.dtype[Any]:
    code = fields.whole("componentType")
    if code not in _COMPONENTS:
        fields.refuse("componentType", code, ", ".join(map(str, _COMPONENTS)))
    return _COMPONENTS[code]


def _list_components(kinds: str) -> str:
    return ", ".join(
        f"{number} ({dtype.name})" for number, dtype in _COMPONENTS.items() if dtype.kind in kinds
    )
