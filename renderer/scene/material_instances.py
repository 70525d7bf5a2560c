"""Materials by their values: instances, which inherit from a parent what they don't set, and parameters of
shaders.

A material has the values that were given for it; what it lacks is its parent's, and what no parent has is the
default. So a value that is set in a parent changes all instances that don't set it themselves (Thatcher 2014,
10.4.3: parent, set, unset). From these values follow a row of `MATERIAL`, and a row of the parameters of its
shader, if that is its own. An instance has its parent's shader.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

import rhi.shading as sl
from renderer import rules
from renderer.scene.materials import MATERIAL, TEXTURES, make_material
from rhi.errors import refuse
from rhi.errors.array_likes import to_real_array

MAX_SHADERS: Final = 14
"""The most shaders of their own that the materials of a scene may have: lists that a device makes have four
parts for each, and at most 63 (`renderer.visibility.gpu.draw_lists`)."""
_STANDARD: Final = frozenset(make_material.__annotations__) - {"return"}


@dataclass(frozen=True, eq=False, slots=True)
class CustomShader:
    """A shader that materials have of their own, and the struct of its parameters, `int` if it has none."""

    shader: type[Any]
    parameters: type[Any]

    @property
    def dtype(self) -> np.dtype[Any]:
        """The type of a row of the parameters."""
        dtype: np.dtype[Any] = np.dtype(np.int32) if self.parameters is int else self.parameters.dtype
        return dtype

    @property
    def fields(self) -> tuple[str, ...]:
        """The names of the parameters."""
        return self.dtype.names or ()

    @property
    def textures(self) -> Mapping[str, bool]:
        """The parameters that are textures, and whether these hold colours."""
        textures: Mapping[str, bool] = self.shader.parameter_textures
        return textures

    def make_parameters(self, values: Mapping[str, Any], call: str) -> NDArray[Any]:
        """Create the row () of the parameters with these values."""
        row = np.zeros((), self.dtype)
        for name in self.fields:
            value = values.get(
                name, -1 if name in self.textures else self.shader.parameter_defaults.get(name)
            )
            if value is None:
                refuse(
                    rules.BAD_MATERIAL,
                    f"{call}({name}=...)",
                    "nothing",
                    f"a value: {self.shader.__name__} needs it",
                )
            row[name] = _read(value, self.dtype[name], f"{call}({name}=...)")
        return row


def _read(value: Any, dtype: np.dtype[Any], call: str) -> NDArray[Any]:
    """Return a value as a parameter keeps it."""
    base, shape = dtype.subdtype or (dtype, ())
    try:
        array = to_real_array(value)
    except (TypeError, ValueError) as error:
        refuse(rules.BAD_MATERIAL, call, value, f"real numbers: {error}")
    whole = base.kind in "iu"
    is_number = array.dtype.kind in ("iu" if whole else "iuf")
    if array.shape != shape or not is_number or not np.isfinite(array).all():
        kind = "whole number" if whole else "finite number"
        refuse(
            rules.BAD_MATERIAL,
            call,
            value,
            f"{' x '.join(map(str, shape))} {kind}s" if shape else f"a {kind}",
        )
    return array


def read_custom_shader(shader: object, call: str) -> CustomShader:
    """Check the shader of a material: a class with `describe`, and what it says of its parameters."""
    allowed = "a class derived from renderer.shaders.MaterialShader"
    if not (isinstance(shader, type) and issubclass(shader, sl.Shader) and hasattr(shader, "describe")):
        refuse(rules.BAD_MATERIAL, f"{call}(shader=...)", shader, allowed)
    if check := getattr(shader, "check", None):
        check()
    custom = CustomShader(shader, sl.find_element(shader, "parameters") or int)
    declared: Any = shader
    wrong = [
        name
        for name in (*declared.parameter_defaults, *declared.parameter_textures)
        if name not in custom.fields
    ]
    wrong += [name for name in custom.fields if name in _STANDARD]
    if wrong:
        problem = f"{shader.__name__}, {wrong[0]!r}"
        refuse(
            rules.BAD_MATERIAL,
            f"{call}(shader=...)",
            problem,
            "names of parameters, and none that a material has",
        )
    return custom


class MaterialTable:
    """The materials of a scene by their values.

    Attributes:
        shaders: those that materials have of their own. The `shader` of a material is 1 more than the place
            here.
    """

    def __init__(self) -> None:
        self.shaders: list[CustomShader] = []
        self._parents: list[int] = []
        self._own: list[dict[str, Any]] = []
        self._shader: list[int] = []

    def __len__(self) -> int:
        return len(self._own)

    def get_shader(self, material: int) -> CustomShader | None:
        """Return the custom shader of a material."""
        number = self._shader[material]
        return self.shaders[number - 1] if number else None

    def get_own_values(self, material: int) -> dict[str, Any]:
        """Return the values that a material sets itself."""
        return dict(self._own[material])

    def resolve_values(self, material: int) -> dict[str, Any]:
        """Return the values that a material or its ancestors set."""
        parent = self._parents[material]
        return (self.resolve_values(parent) if parent >= 0 else {}) | self._own[material]

    def list_instances(self, material: int) -> list[int]:
        """Return a material, and all that have it above them."""
        instances = [material]
        instances.extend(row for row in range(material + 1, len(self)) if self._parents[row] in instances)
        return instances

    def add(self, values: Mapping[str, Any], parent: int, number: int, shaders: list[CustomShader]) -> int:
        """Add a material, whose textures are given by their rows, with what `check` has returned; return its
        id."""
        self.shaders = shaders
        self._parents.append(parent)
        self._own.append(dict(values))
        self._shader.append(number)
        return len(self._own) - 1

    def check(
        self, values: Mapping[str, Any], parent: int, shader: CustomShader | None
    ) -> tuple[int, list[CustomShader]]:
        """Refuse what can't be added; return the number of the material's shader, and the shaders with it."""
        number = self._shader[parent] if parent >= 0 else 0
        shaders = list(self.shaders)
        if shader is not None:
            numbers = [
                position for position, custom in enumerate(shaders, 1) if custom.shader is shader.shader
            ]
            if parent >= 0 and numbers != [number]:
                refuse(
                    rules.BAD_MATERIAL,
                    "add_material(shader=...)",
                    shader.shader.__name__,
                    "the shader of the parent",
                )
            if not numbers:
                shaders.append(shader)
            number = numbers[0] if numbers else len(shaders)
        if len(shaders) > MAX_SHADERS:
            refuse(
                rules.BAD_MATERIAL,
                "add_material(shader=...)",
                f"{len(shaders)} shaders",
                f"at most {MAX_SHADERS}",
            )
        material_shader = shaders[number - 1] if number else None
        check_names(values, material_shader, "add_material")
        _make(
            (self.resolve_values(parent) if parent >= 0 else {}) | dict(values),
            number,
            material_shader,
            "add_material",
        )
        return number, shaders

    def make_arrays(self) -> tuple[NDArray[Any], tuple[NDArray[Any], ...]]:
        """Create the materials (k,) of `MATERIAL`, and for each of `shaders` the parameters (k,) of all
        materials, which are 0 where they have another shader; (0,) of a shader without parameters."""
        materials = np.zeros(len(self), MATERIAL)
        parameters = tuple(
            np.zeros(len(self) if shader.fields else 0, shader.dtype) for shader in self.shaders
        )
        for material in range(len(self)):
            materials[material], parameter_row = self._make_material(material, "add_material")
            self._write_parameters(material, parameter_row, parameters)
        return materials, parameters

    def change(
        self,
        material: int,
        custom_parameters: dict[str, Any],
        materials: NDArray[Any],
        parameters: tuple[NDArray[Any], ...],
        call: str,
    ) -> None:
        """Give a material these values of its own, and write what thereby changes in the rows of it and its
        instances."""
        before, changed = self._own[material], self.list_instances(material)
        check_names(custom_parameters, self.get_shader(material), call)
        previous = [self._make_material(row, call) for row in changed]
        self._own[material] = custom_parameters
        try:
            current = [self._make_material(row, call) for row in changed]
        except BaseException:
            self._own[material] = before
            raise
        for row, (old, _), (new, new_own) in zip(changed, previous, current, strict=True):
            for name in MATERIAL.names or ():
                if not np.array_equal(new[name], old[name]):
                    materials[name][row] = new[name]
            self._write_parameters(row, new_own, parameters)

    def _make_material(self, material: int, call: str) -> tuple[NDArray[Any], NDArray[Any] | None]:
        return _make(self.resolve_values(material), self._shader[material], self.get_shader(material), call)

    def _write_parameters(
        self, material: int, row: NDArray[Any] | None, parameters: tuple[NDArray[Any], ...]
    ) -> None:
        """Write a material's row of parameters, if its shader has any."""
        if row is not None and row.dtype.names:
            parameters[self._shader[material] - 1][material] = row


def check_names(values: Mapping[str, Any], custom: CustomShader | None, call: str) -> None:
    """Refuse names that neither a material nor its shader has."""
    allowed = [*_STANDARD, *(custom.fields if custom is not None else ())]
    for name in values:
        if name not in allowed:
            rules.refuse_name(rules.BAD_MATERIAL, f"{call}({name}=...)", name, allowed)


def _make(
    values: Mapping[str, Any], number: int, custom: CustomShader | None, call: str
) -> tuple[NDArray[Any], NDArray[Any] | None]:
    """Return the rows of a material with these values, and of its parameters."""
    standard = make_material(**{name: value for name, value in values.items() if name in _STANDARD})
    standard["shader"] = number
    return standard, None if custom is None else custom.make_parameters(values, call)


def needs_tangents(materials: NDArray[Any], shaders: Sequence[CustomShader]) -> NDArray[np.bool_]:
    """Return which of the materials (k,) need meshes with tangents."""
    reads = np.array([False, *(custom.shader.reads_tangents for custom in shaders)], bool)
    needs: NDArray[np.bool_] = (materials["normal_texture"] >= 0) | reads[materials["shader"]]
    return needs


def list_textures(custom: CustomShader | None) -> dict[str, bool]:
    """Return the values of a material that are textures, and whether these hold colours."""
    return TEXTURES | dict(custom.textures if custom is not None else {})


def collect_normal_images(
    textures: NDArray[Any],
    materials: NDArray[Any],
    shaders: Sequence[CustomShader],
    parameters: Sequence[NDArray[Any]],
) -> frozenset[int]:
    """Return the images that normal maps read, and no other map that holds data."""
    rows: dict[bool, list[NDArray[Any]]] = {False: [], True: []}  # of other maps, and of normal maps
    for name, is_color in TEXTURES.items():
        if not is_color:
            rows[name == "normal_texture"].append(materials[name])
    for shader, values in zip(shaders, parameters, strict=True):
        for name, is_color in shader.textures.items():
            if not is_color and len(values):
                rows[False].append(values[name])
    others, normals = (
        {int(row) for column in rows[is_normal] for row in np.unique(column) if row >= 0}
        for is_normal in (False, True)
    )
    images = textures["image"]
    return frozenset(images[sorted(normals)].tolist()) - frozenset(images[sorted(others)].tolist())
