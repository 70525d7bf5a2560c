"""Data classes whose methods are generated when one is first needed.

`dataclasses.dataclass` compiles some five methods for each class, which takes a quarter of a millisecond: more than
loading all else of its module. `import rhi` defines 67 data classes, and most programs use few of them. So for
classes with slots `dataclass` here creates the class alone. A method that is called, or a look at the fields,
generates all of them, with `dataclasses.dataclass` itself: whatever reads data classes works with these.
"""

from __future__ import annotations

import dataclasses
import threading
from dataclasses import fields
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from dataclasses import dataclass as dataclass
else:

    def dataclass(plain=None, /, **options):
        """Return the decorated class, as `dataclasses.dataclass` does with the same options."""
        if plain is None:
            return lambda plain: dataclass(plain, **options)
        if not options.get("slots") or not _is_simple(plain, options):
            return dataclasses.dataclass(plain, **options)
        return _DeferredMethods(plain, options).owner


_OPTIONS = frozenset({"slots", "frozen", "eq"})
_ATTRIBUTES = ("__dataclass_fields__", "__dataclass_params__", "__match_args__", "__signature__")
_LOCK = threading.RLock()


def _is_simple(plain: type, options: dict[str, Any]) -> bool:
    """True if the slots of a class follow from its own annotations: its bases have slots too."""
    bases = plain.__mro__[1:-1]
    return _OPTIONS.issuperset(options) and all("__slots__" in vars(base) for base in bases)


class _DeferredMethods:
    """The class that stands for a decorated one, and what generates its methods.

    Attributes:
        owner: the class. Until its methods are generated, a look at any of them calls `generate`.
    """

    def __init__(self, plain: type, options: dict[str, Any]) -> None:
        self._plain = plain
        self._original = dict(vars(plain))
        self._options = {name: value for name, value in options.items() if name != "slots"}
        self._is_done = False
        is_frozen, is_equal = options.get("frozen", False), options.get("eq", True)
        own = [name for name, kind in plain.__annotations__.items() if not str(kind).startswith(_NO_FIELDS)]
        inherited = {name for base in plain.__mro__[1:-1] for name in _slots_of(base)}
        namespace = {name: value for name, value in self._original.items() if name not in own}
        namespace.pop("__dict__", None)
        namespace.pop("__weakref__", None)
        namespace["__slots__"] = tuple(name for name in own if name not in inherited)
        names = ["__init__", "__repr__"]
        if is_equal:
            names += ["__eq__", "__hash__"] if is_frozen else ["__eq__"]
            if not is_frozen:
                namespace.setdefault("__hash__", None)
        if is_frozen:
            names += ["__setattr__", "__delattr__"]
            namespace.setdefault("__getstate__", _get_state)
            namespace.setdefault("__setstate__", _set_state)
        for name in names:
            if name not in namespace:
                namespace[name] = _DeferredAttribute(self, name)
        for name in _ATTRIBUTES:
            namespace.setdefault(name, _DeferredAttribute(self, name))
        self.owner = type(plain)(plain.__name__, plain.__bases__, namespace)
        self.owner.__qualname__ = plain.__qualname__

    def generate(self) -> None:
        """Generate the methods. If that is interrupted, the next call does it again."""
        with _LOCK:
            if self._is_done:
                return
            plain, owner = self._plain, self.owner
            for name in vars(plain).keys() - self._original.keys():  # of a call that was interrupted
                delattr(plain, name)
            for name, value in self._original.items():
                if vars(plain).get(name) is not value:
                    setattr(plain, name, value)
            generated = vars(dataclasses.dataclass(plain, **self._options))
            for name in ("__signature__", *(generated.keys() - self._original.keys())):
                if name in generated:
                    setattr(owner, name, generated[name])
                elif name in vars(owner):
                    delattr(owner, name)
            self._is_done = True


class _DeferredAttribute:
    """A method or another attribute of a data class, which is there once the methods are generated."""

    def __init__(self, deferred: _DeferredMethods, name: str) -> None:
        self._deferred = deferred
        self._name = name

    def __get__(self, instance: object, owner: type) -> Any:
        self._deferred.generate()
        if self._name == "__signature__":
            return None  # that of `__init__` counts
        attribute = getattr(self._deferred.owner, self._name)
        return attribute if instance is None or not callable(attribute) else attribute.__get__(instance)


_NO_FIELDS = ("ClassVar", "typing.ClassVar", "InitVar", "dataclasses.InitVar")
"""How the annotations begin of names that aren't fields."""


def _slots_of(cls: type) -> tuple[str, ...]:
    slots: str | tuple[str, ...] = vars(cls)["__slots__"]
    return (slots,) if isinstance(slots, str) else tuple(slots)


def _get_state(self: Any) -> list[Any]:
    return [getattr(self, field.name) for field in fields(self)]


def _set_state(self: Any, state: list[Any]) -> None:
    for field, value in zip(fields(self), state, strict=True):
        object.__setattr__(self, field.name, value)
