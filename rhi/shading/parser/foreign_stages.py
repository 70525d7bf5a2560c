"""Methods that look like stages of other languages: `geometry`, `mesh`, `hull`, `pixel`, `vertex_main`.

The shading language would take them for helpers, and nothing would ever run them. They are refused by name,
with what to do instead, unless another method calls them: then they are helpers.
"""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from types import FunctionType
from typing import Final

from rhi.contract.descriptors import Stage
from rhi.shading.language import rules
from rhi.shading.language.function import NATIVE
from rhi.shading.language.shader import Shader
from rhi.shading.language.source import header_of, source_of

_GEOMETRY: Final = "write the vertices in a compute shader and draw them, or choose them by vertex_index()"
_TESSELLATION: Final = "subdivide in a compute shader, and draw what it wrote indirectly"
_MESH: Final = "let a compute shader write the vertices and the arguments of indirect draws"
_RAYS: Final = "trace rays in a compute shader, through a tree in a buffer"

FOREIGN_STAGES: Final = {
    **dict.fromkeys(("geometry", "geom", "gs"), _GEOMETRY),
    **dict.fromkeys(("tesscontrol", "tessellationcontrol", "tesc", "hull", "hs"), _TESSELLATION),
    **dict.fromkeys(
        ("tesseval", "tessevaluation", "tessellationeval", "tessellationevaluation"), _TESSELLATION
    ),
    **dict.fromkeys(("tessellation", "tess", "tese", "domain", "ds", "patchconstant"), _TESSELLATION),
    **dict.fromkeys(("mesh", "task", "amplification", "object", "ms"), _MESH),
    **dict.fromkeys(("raygeneration", "raygen", "rgen", "closesthit", "rchit", "anyhit", "rahit"), _RAYS),
    **dict.fromkeys(("miss", "rmiss", "intersection", "rint", "callable", "rcall"), _RAYS),
    **dict.fromkeys(("vertex", "vert", "vs"), "call it `vertex`"),
    **dict.fromkeys(("fragment", "frag", "fs", "pixel", "ps"), "call it `fragment`"),
    **dict.fromkeys(("compute", "comp", "cs", "kernel"), "call it `compute`"),
    "main": "call it `vertex`, `fragment` or `compute`",
}
"""What to do instead of each stage, by its name without underscores, capitals and endings."""
_ENDING: Final = re.compile(r"(shader|stage|main|program|function)$")
_STAGES: Final = frozenset(stage.value for stage in Stage)


def foreign_stage_tip(name: str) -> str:
    """A tip in place of a stage with this name; "" if it doesn't look like one."""
    plain = name.lower().replace("_", "")
    return FOREIGN_STAGES.get(plain, "") or FOREIGN_STAGES.get(_ENDING.sub("", plain), "")


def refuse_foreign_stages(shader: type[Shader]) -> None:
    """Refuse the first method of a shader that looks like a stage of another language and that nothing calls.

    Raises:
        ShaderError: `shading-stages`.
    """
    methods = dict(_methods(shader))
    suspects = {name: foreign_stage_tip(name) for name in methods if name not in _STAGES}
    suspects = {name: tip for name, tip in suspects.items() if tip}
    if not suspects:
        return
    called = {name for method in methods.values() for name in _names_in(method)}
    for name, tip in suspects.items():
        if name not in called:
            source = source_of(methods[name])
            allowed = "`vertex`, `vertex` and `fragment`, or `compute`; and methods that these call"
            source.refuse(
                rules.STAGES, header_of(source.node), f"`{name}`, which no method calls", allowed, tip
            )


def _methods(shader: type[Shader]) -> Iterator[tuple[str, FunctionType]]:
    """Yield the methods of a shader and of its bases, those of bases first."""
    for base in reversed(shader.__mro__):
        if issubclass(base, Shader) and base is Shader:
            continue
        for name, value in vars(base).items():
            method = value.__func__ if isinstance(value, staticmethod) else value
            if isinstance(method, FunctionType):
                yield name, method


def _names_in(method: FunctionType) -> Iterator[str]:
    """Yield the names of attributes in a method, and all words of its native texts."""
    for part in ast.walk(source_of(method).node):
        if isinstance(part, ast.Attribute):
            yield part.attr
    for native in getattr(method, NATIVE, {}).values():
        yield from re.findall(r"\w+", native.body)
