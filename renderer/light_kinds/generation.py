"""Shaders that are the same for each kind of lights but for names: made from templates, when they are
imported.

A template is the text of Python code, in which `$kind` stands for the name of a kind. A kind thus costs
nothing that isn't its own, and a device sees the code that would be written by hand.
"""

from __future__ import annotations

from collections.abc import Callable
from string import Template
from typing import Any, Final

from renderer.light_kinds.kind import LocalLightKind
from renderer.light_kinds.table import LIGHT_KINDS, LOCAL_LIGHT_KINDS
from rhi.shading import from_source

_COMPONENTS: Final = "xyzw"


def for_each_kind(template: str, **values: Callable[[int, LocalLightKind], str]) -> str:
    """The texts of a template for all kinds with a position, one behind the other; see `for_kind`."""
    return "".join(for_kind(template, kind, **values) for kind in LOCAL_LIGHT_KINDS)


def for_kind(template: str, kind: LocalLightKind, **values: Callable[[int, LocalLightKind], str]) -> str:
    """The text of a template for a kind with a position.

    In a template stand `$kind` for the name of the kind, `$Element` for its struct, `$incidence` for its
    shader function, `$component` for the component of a vector that is the kind's, and `$begin` and `$end`
    for the components of `LightBounds` that say where its lights begin and end in a list. Further names come
    from `values`, functions of the index of the kind and the kind.
    """
    index = LOCAL_LIGHT_KINDS.index(kind)
    return Template(template).substitute(
        kind=kind.name,
        Element=kind.element.__name__,
        incidence=kind.incidence.__name__,
        component=_COMPONENTS[index],
        begin=_COMPONENTS[index],
        end=_COMPONENTS[index + 1],
        **{name: value(index, kind) for name, value in values.items()},
    )


def define(text: str, name: str, module: str, /, **names: Any) -> Any:
    """Execute a text and return what it defines with this name, as part of a module.

    The text may use `names`, and the structs and shader functions of all kinds.
    """
    for kind in LIGHT_KINDS:
        names[kind.element.__name__] = kind.element
        names[kind.incidence.__name__] = kind.incidence
    defined = from_source(text, name, file=f"<{module}: {name}>", scope=names)
    defined.__module__ = module
    return defined
