"""The names of what a stage declares outside its functions.

Linkers match the stages of a program by the names of bindings, blocks and structs. Those of bindings are
therefore derived from all bindings of the shader, so that they are the same in each stage.
"""

from __future__ import annotations

from collections.abc import Iterator

from rhi.contract.layout import ArrayType, HostType, StructType
from rhi.shading.ir import tree
from rhi.shading.ir.interface import Interface
from rhi.shading.language.structs import struct_of
from rhi.shading.text.names import Names


def name_bindings(names: Names, stage: tree.StageTree, interface: Interface) -> None:
    """Name the bindings and the shared memory of a stage: `("binding", name)`."""
    used = [declaration.name for declaration in stage.bindings]
    every = names.apart()
    every.get_all({name: name for name in dict.fromkeys([*interface.bindings, *used])})
    for name in used:
        names.get_legal(("binding", name), every.get(name, name))


def name_structs(names: Names, stage: tree.StageTree, interface: Interface) -> None:
    """Name the structs of a stage by their types."""
    hosts = [struct_of(binding.type) for binding in interface.bindings.values()]
    shared = [type for host in hosts if host is not None for type in _structs_in(host.shading_type)]
    by_name: dict[str, StructType] = {}
    if all(by_name.setdefault(type.name, type) is type for type in (*shared, *stage.structs)) and all(
        names.legal(name) == name for name in by_name
    ):  # by identity, since hashes of structs take long
        for type in stage.structs:
            names.get_legal(type, type.name)
        return
    every = names.apart()
    every.get_all({type: type.name for type in dict.fromkeys([*shared, *stage.structs])})
    for type in stage.structs:
        names.get_legal(type, every.get(type, type.name))


def _structs_in(type: HostType) -> Iterator[StructType]:
    """Yield the structs that a type consists of."""
    match type:
        case ArrayType(element=element):
            yield from _structs_in(element)
        case StructType(fields=fields):
            for field in fields:
                yield from _structs_in(field.type)
            yield type
