"""Which backends there are, and the way to a device.

- A backend is an entry point of the group `rhi.backends`: a name and a function
  `create(*, validation: bool, …) -> Backend`. A port registers itself by its own package's entry point;
  nothing here knows it. Further keyword parameters of the function are options that only this backend has;
  `create_device` passes them on.
- A backend that isn't installed is named by its function, `package.module:function`, as an entry point would.
- This is the one place that may treat backends differently: the order in which they are tried, and that
  the null device records.
"""

from __future__ import annotations

import difflib
import inspect
import os
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cache
from importlib.metadata import EntryPoint, entry_points
from typing import Final

from rhi.commands.recorder import Recorder
from rhi.contract.backend import Backend, Capabilities
from rhi.device.device import Device
from rhi.errors import DeviceError, RhiError, refuse
from rhi.errors.rules import DEVICE_ARGUMENT, DEVICE_DRIVER, DEVICE_UNKNOWN

__rhi_internal__ = True

GROUP: Final = "rhi.backends"
PREFERENCE: Final = ("gl",)
"""Tried in this order when no name is given, then any other; a backend that doesn't render must be asked for."""


@cache
def _entry_points() -> dict[str, EntryPoint]:
    return {point.name: point for point in entry_points(group=GROUP)}


def backend_names() -> list[str]:
    """The names of the installed backends, in the order in which they are tried."""
    names = list(_entry_points())
    first = [name for name in PREFERENCE if name in names]
    return first + sorted(set(names) - set(first) - {"null"}) + [name for name in names if name == "null"]


def create_device(
    name: str | None = None,
    *,
    validation: bool = False,
    record: bool | None = None,
    timing: bool = False,
    frames_in_flight: int = 2,
    **options: object,
) -> Device:
    """A device on the backend `name`.

    Args:
        name: a backend's name, or `module:function` for one that isn't installed; None takes `RHI_BACKEND`
            from the environment, else the first that works.
        validation: also turn the driver's own error messages into exceptions (slower).
        record: keep every command with the line it came from (`device.stream`); None: the null device does.
        timing: take timestamps in `device.event` blocks.
        frames_in_flight: how many frames the CPU may be ahead of the GPU.
        options: what only the named backend takes, by the keyword parameters of its `create_backend`.

    Raises:
        ValidationError: `device-argument` for an option that the backend doesn't have.
        DeviceError: `device-unknown` for a name there is no backend of, `device-driver` if its driver
            can't be used, with what to install.
    """
    name = name or os.environ.get("RHI_BACKEND") or None
    backend = _create_named(name, validation, options) if name else _create_first(validation, options)
    if record is None:
        record = backend.capabilities.backend == "null"
    return Device(Recorder(backend) if record else backend, timing=timing, frames_in_flight=frames_in_flight)


def _create_named(name: str, validation: bool, options: Mapping[str, object]) -> Backend:
    create = _find_function(name)
    if options:
        taken = list(inspect.signature(create).parameters.keys() - {"validation"})
        unknown = sorted(options.keys() - taken)
        if unknown:
            given, allowed = ", ".join(unknown), ", ".join(sorted(taken)) or "no options"
            refuse(DEVICE_ARGUMENT, f"rhi.create_device({name!r}, {unknown[0]}=…)", given, allowed)
    return create(validation=validation, **options)


def _find_function(name: str) -> Callable[..., Backend]:
    """What makes the backend of this name."""
    point = _entry_points().get(name)
    if ":" in name:
        point = EntryPoint(name, name, GROUP)
    if point is None:
        names = backend_names()
        close = difflib.get_close_matches(name, names, 1)
        tip = f"did you mean {close[0]!r}?" if close else ""
        raise DeviceError(DEVICE_UNKNOWN, f"rhi.create_device({name!r})", repr(name), ", ".join(names), tip)
    try:
        create: Callable[..., Backend] = point.load()
    except (ImportError, AttributeError) as error:
        call, tip = f"rhi.create_device({name!r})", "is its module on Python's path?"
        raise DeviceError(DEVICE_UNKNOWN, call, f"{name!r}: {error}", "", tip) from error
    return create


def _create_first(validation: bool, options: Mapping[str, object]) -> Backend:
    reasons = []
    for name in backend_names():
        try:
            backend = _create_named(name, validation, options)
        except RhiError as error:
            reasons.append(f"{name}: {error.given or error.rule.sentence}")
            continue
        if backend.capabilities.renders:
            return backend
        backend.close()
        reasons.append(f"{name}: it doesn't render, so it must be asked for by name")
    tip = 'install a driver (see python -m rhi), or ask for the null device: rhi.create_device("null")'
    raise DeviceError(DEVICE_DRIVER, "rhi.create_device()", "\n".join(reasons) or "no backends", "", tip)


@dataclass(frozen=True, slots=True)
class BackendReport:
    """One backend as found on this machine: its capabilities, or why it can't be used."""

    name: str
    usable: bool
    reason: str
    tip: str
    capabilities: Capabilities | None


def report() -> list[BackendReport]:
    """Try every backend and say what came of it."""
    reports = []
    for name in backend_names():
        try:
            backend = _create_named(name, False, {})
        except RhiError as error:
            reports.append(BackendReport(name, False, error.given or error.rule.sentence, error.tip, None))
        else:
            reports.append(BackendReport(name, True, "", "", backend.capabilities))
            backend.close()
    return reports
