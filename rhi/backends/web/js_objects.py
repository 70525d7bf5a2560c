"""Objects of the page with the names of Python: `device.create_buffer(size=…)` calls `createBuffer({size})`."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Final

from js import Map, Object
from pyodide.ffi import JsProxy, to_js

from rhi.backends.web.pass_commands import ObjectTable
from rhi.backends.webgpu.javascript_names import prepare, to_camel_case

OBJECTS: Final = Map.new()
"""The objects that commands of passes use, by their numbers in `TABLE`."""
TABLE: Final = ObjectTable(OBJECTS.set, OBJECTS.delete)


def to_javascript(value: Any) -> Any:
    """Return a value of Python as the page takes it. What is None in a dictionary is left out."""
    if isinstance(value, (bytes, memoryview)):
        return to_js(value)
    return to_js(prepare(value, _unwrap), dict_converter=Object.fromEntries)


def _unwrap(value: Any) -> Any:
    return value._internal if isinstance(value, WebObject) else value


def wrap(value: Any) -> Any:
    """Return an object of the page with the names of Python; other values as they are."""
    return WebObject(value) if isinstance(value, JsProxy) else value


class WebObject:
    """An object of WebGPU. `_internal` is the page's object."""

    __slots__ = ("_internal",)

    def __init__(self, proxy: Any) -> None:
        self._internal = proxy

    def __del__(self) -> None:
        TABLE.forget(self._internal)

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
