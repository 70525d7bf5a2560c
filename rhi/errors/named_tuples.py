"""Named tuples whose annotations stay texts.

`typing.NamedTuple` compiles the text of each annotation, which nobody evaluates: a tenth of `import rhi`.
"""

from __future__ import annotations

from collections import namedtuple
from typing import TYPE_CHECKING, Any, Final

if TYPE_CHECKING:
    from typing import NamedTuple as NamedTuple
else:
    _IGNORED: Final = {"__annotations__", "__module__", "__qualname__", "__dict__", "__weakref__"}

    class _NamedTupleMeta(type):
        def __new__(cls, name: str, bases: tuple[type, ...], namespace: dict[str, Any]) -> type:
            """Return the tuple class of a class statement."""
            annotations = namespace.get("__annotations__", {})
            defaults = [namespace[field] for field in annotations if field in namespace]
            owner = namedtuple(name, annotations, defaults=defaults, module=namespace["__module__"])
            owner.__annotations__ = annotations
            owner.__qualname__ = namespace["__qualname__"]
            for attribute, value in namespace.items():
                if attribute not in annotations and attribute not in _IGNORED:
                    setattr(owner, attribute, value)
            return owner

    NamedTuple = type.__new__(_NamedTupleMeta, "NamedTuple", (), {})
    """The base of a named tuple, as `typing.NamedTuple` is."""
