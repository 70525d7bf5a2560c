"""The interface of a shader's stages: vertex inputs, varyings and outputs, read from their signatures.

- The vertex stage takes structs of attributes and returns a `vec4`, the clip position, or a struct whose
  first field is the clip position; the other fields are varyings, among them at most one `PointSize` and one
  `TargetLayer`.
- The fragment stage takes nothing, or a struct whose fields match varyings of the vertex stage by name and
  type; it returns a colour, a struct of colours (and at most one `FragmentDepth`), or None.
"""

from __future__ import annotations

import math
from collections.abc import Set as AbstractSet
from dataclasses import replace

from rhi.contract import layout
from rhi.contract.descriptors import Attribute, FragmentOutput, Interpolation, StageVarying
from rhi.shading.ir import tree
from rhi.shading.ir.interface import Varying
from rhi.shading.language import rules
from rhi.shading.language.annotations import Role
from rhi.shading.language.source import suggest
from rhi.shading.language.types import VEC4, VOID, Type, scalar_of
from rhi.shading.parser.signatures import Callee, struct_class


def vertex_inputs(vertex: Callee) -> tuple[Attribute, ...]:
    """Return the attributes of the vertex stage's parameters, in order."""
    attributes: list[Attribute] = []
    source = vertex.source
    for parameter in vertex.signature.parameters:
        if not isinstance(parameter.type, layout.StructType):
            source.refuse(
                rules.INTERFACE, source.node, f"{parameter.name}: {parameter.type}", "structs of attributes"
            )
        for field in parameter.type.fields:
            if (
                not isinstance(field.type, layout.ScalarType | layout.VectorType)
                or scalar_of(field.type) is layout.BOOL
            ):
                source.refuse(
                    rules.INTERFACE,
                    source.node,
                    f"vertex input {field.name}: {field.type}",
                    "float, int, uint and their vectors",
                    "a matrix per instance can be read from storage by instance_index()",
                )
            if any(attribute.name == field.name for attribute in attributes):
                source.refuse(rules.INTERFACE, source.node, f"two vertex inputs named {field.name!r}")
            attributes.append(Attribute(field.name, len(attributes), field.type))
    return tuple(attributes)


def varyings_of(vertex: Callee) -> tuple[str, tuple[Varying, ...]]:
    """Return the name of the position field and all varyings of the vertex stage, with the position as the
    last."""
    described, source = vertex.signature, vertex.source
    if described.result == VEC4:
        return "", ()
    cls = struct_class(described.result_host)
    fields = cls.shading_type.fields if cls is not None else ()
    if cls is None or not fields or fields[0].type != VEC4:
        actual = str(described.result)
        if fields:
            actual += f" with {fields[0].name}: {fields[0].type} first"
        source.refuse(
            rules.INTERFACE,
            source.node.returns or source.node,
            actual,
            "a vec4, or a Struct whose first field is one",
        )
    varyings, location = [], 0
    for field in (*fields[1:], fields[0]):
        role = cls._roles.get(field.name)
        if (
            isinstance(field.type, layout.StructType | layout.ArrayType)
            or scalar_of(field.type) is layout.BOOL
        ):
            actual = f"varying {field.name}: {field.type}"
            source.refuse(rules.INTERFACE, source.node, actual, "numbers, vectors, matrices")
        if scalar_of(field.type) not in (layout.FLOAT, None) or role in (
            Role.POINT_SIZE,
            Role.TARGET_LAYER,
        ):
            role = Role.FLAT
        varyings.append(Varying(field.name, field.type, role, location))
        location += field.type.size if isinstance(field.type, layout.MatrixType) else 1
    return fields[0].name, tuple(varyings)


def field_of_role(vertex: Callee, role: Role, annotation: str) -> str:
    """Return the name of the field of the vertex stage's result with a role, "" if it has none. `annotation`:
    the role's name in the language."""
    cls = struct_class(vertex.signature.result_host)
    names = [name for name, other in cls._roles.items() if other is role] if cls is not None else []
    if len(names) > 1:
        source = vertex.source
        source.refuse(
            rules.INTERFACE, source.node, f"{role.value}s {' and '.join(names)}", f"one {annotation}"
        )
    return names[0] if names else ""


def check_fragment_input(fragment: Callee, varyings: tuple[Varying, ...]) -> None:
    """Refuse a fragment stage with an input that the vertex stage doesn't write."""
    described, source = fragment.signature, fragment.source
    if len(described.parameters) > 1:
        source.refuse(
            rules.INTERFACE, source.node, f"{len(described.parameters)} parameters", "at most one struct"
        )
    for parameter in described.parameters:
        if not isinstance(parameter.type, layout.StructType):
            source.refuse(rules.INTERFACE, source.node, f"{parameter.name}: {parameter.type}", "a struct")
        types = {varying.name: varying.type for varying in varyings}
        for field in parameter.type.fields:
            if types.get(field.name) != field.type:
                actual = f"{parameter.type}.{field.name}: {field.type}"
                allowed = ", ".join(f"{name}: {type}" for name, type in types.items()) or "no varyings"
                source.refuse(rules.STAGES, source.node, actual, allowed, suggest(field.name, types))


def attributes_read(vertex: tree.StageTree, attributes: tuple[Attribute, ...]) -> tuple[Attribute, ...]:
    """Return the attributes that the vertex stage reads, with new locations from 0 on."""
    names = _fields_read(vertex.entry)
    read = [attribute for attribute in attributes if attribute.name in names]
    return tuple(replace(attribute, location=location) for location, attribute in enumerate(read))


_INTERPOLATIONS = {
    None: Interpolation.SMOOTH,
    Role.FLAT: Interpolation.FLAT,
    Role.NO_PERSPECTIVE: Interpolation.NO_PERSPECTIVE,
}


def varyings_read(
    fragment: tree.StageTree | None, varyings: tuple[Varying, ...], builtins: AbstractSet[str] = frozenset()
) -> tuple[StageVarying, ...]:
    """Return the varyings that the fragment stage reads, and those of the names `builtins`, with their
    words."""
    names = _fields_read(fragment.entry) if fragment is not None else set()
    return words_of_varyings(varyings, names | builtins)


def words_of_varyings(varyings: tuple[Varying, ...], names: set[str]) -> tuple[StageVarying, ...]:
    """Return the varyings that have these names, with their words."""
    stage_varyings, word = [], 0
    for varying in varyings:
        if varying.name in names:
            scalar, words = scalar_of(varying.type) or layout.FLOAT, math.prod(layout.shape_of(varying.type))
            interpolation = _INTERPOLATIONS[varying.role]
            stage_varyings.append(StageVarying(varying.name, word, words, scalar.name, interpolation))
            word += words
    return tuple(stage_varyings)


def _fields_read(entry: tree.Function) -> set[str]:
    """Return the fields of an entry's parameters that it or its callees read; all if one needs a whole
    parameter."""
    names: set[str] = set()
    pending = [(entry, frozenset(entry.parameters))]
    seen: set[tuple[int, frozenset[int]]] = set()
    while pending:
        function, locals = pending.pop()
        key = id(function), frozenset(map(id, locals))
        if key in seen or not locals:
            continue
        seen.add(key)
        whole = 1 if function.native else 0
        for node in tree.walk(function.body):
            match node:
                case tree.Member(base=tree.Read(local=local), name=name) if local in locals:
                    names.add(name)
                    whole -= 1
                case tree.Call(function=callee, arguments=arguments):
                    passed = [
                        parameter
                        for parameter, argument in zip(callee.parameters, arguments, strict=True)
                        if isinstance(argument, tree.Read) and argument.local in locals
                    ]
                    whole -= len(passed)
                    pending.append((callee, frozenset(passed)))
                case tree.Read(local=local) if local in locals:
                    whole += 1
        if whole:
            types = [parameter.type for parameter in entry.parameters]
            return {
                field.name for type in types if isinstance(type, layout.StructType) for field in type.fields
            }
    return names


def fragment_outputs(fragment: Callee) -> tuple[str, tuple[FragmentOutput, ...]]:
    """Return the name of the depth field and the colour outputs by location."""
    described, source = fragment.signature, fragment.source
    if described.result == VOID:
        return "", ()
    cls = struct_class(described.result_host)
    roles = cls._roles if cls is not None else {}
    fields: list[tuple[str, Type]] = [("color", described.result)]
    if cls is not None:
        fields = [(field.name, field.type) for field in cls.shading_type.fields]
    outputs: list[FragmentOutput] = []
    depth = ""
    for name, type in fields:
        if roles.get(name) is Role.FRAGMENT_DEPTH:
            depth = name
            continue
        scalar = scalar_of(type)
        if scalar is None or scalar is layout.BOOL:
            source.refuse(
                rules.INTERFACE,
                source.node.returns or source.node,
                f"output {name}: {type}",
                "float, int, uint and their vectors, FragmentDepth",
            )
        outputs.append(FragmentOutput(name, len(outputs), scalar.name, getattr(type, "size", 1)))
    return depth, tuple(outputs)
