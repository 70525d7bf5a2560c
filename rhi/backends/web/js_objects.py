"""Objects of the page with the names of Python: `device.create_buffer(size=…)` calls `createBuffer({size})`."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import cache
from typing import Any, Final

from js import Object
from pyodide.ffi import JsProxy, to_js

_VERBATIM: Final = "constants"
"""The member whose keys are names of the user's, not of WebGPU."""


@cache
def to_camel_case(name: str) -> str:
    """Return WebGPU's spelling of a name: `mip_level_count` is `mipLevelCount`."""
    first, *others = name.split("_")
    return first + "".join(part[:1].upper() + part[1:] for part in others)


def to_javascript(value: Any) -> Any:
    """Return a value of Python as the page takes it. What is None in a dictionary is left out."""
    if isinstance(value, (WebObject, dict, list, tuple)):
        value = _prepare(value)
    elif isinstance(value, (bytes, memoryview)):
        return to_js(value)
    return to_js(value, dict_converter=Object.fromEntries)


def _prepare(value: Any) -> Any:
    if isinstance(value, WebObject):
        return value._internal
    if isinstance(value, Mapping):
        return {
            to_camel_case(key): dict(part) if key == _VERBATIM else _prepare(part)
            for key, part in value.items()
            if part is not None
        }
    if isinstance(value, (list, tuple)):
        return [_prepare(part) for part in value]
    return int(value) if isinstance(value, int) and not isinstance(value, bool) else value


def wrap(value: Any) -> Any:
    """Return an object of the page with the names of Python; other values as they are."""
    return WebObject(value) if isinstance(value, JsProxy) else value


class WebObject:
    """An object of WebGPU. `_internal` is the page's object."""

    __slots__ = ("_internal",)

    def __init__(self, proxy: Any) -> None:
        self._internal = proxy

    def __getattr__(self, name: str) -> Any:
        value = getattr(self._internal, to_camel_case(name))
        if not callable(value):
            return wrap(value)
        return _bind(value)


def _bind(method: Any) -> Callable[..., Any]:
    def call(*arguments: Any, **members: Any) -> Any:
        converted = [to_javascript(argument) for argument in arguments]
        if members:
            converted.append(to_javascript(members))
        return wrap(method(*converted))

    return call
