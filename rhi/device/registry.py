"""The registry of backends, and the creation of devices.

- The package's own backends are named here, so they exist wherever its modules do: in an archive, in a frozen
  program, in a folder that was copied. Those of ports are found by the metadata of their packages.
- A port's backend is an entry point of the group `rhi.backends`: a name and a function `create(*, validation:
  bool, …) -> Backend`. A port registers itself by an entry point of its own package; nothing here depends on
  it. Further keyword parameters of the function are options that only this backend has; `create_device`
  passes them on.
- A backend without an entry point is named by its function, `package.module:function`.
- This is the only module that may treat backends differently: it decides the order in which they are tried,
  that the null device records, and that only its devices may be created in a process that was forked after
  another device.
"""

from __future__ import annotations

import atexit
import inspect
import os
import sys
import time
from collections.abc import Callable, Mapping
from functools import cache
from threading import get_ident, main_thread
from types import FrameType
from typing import TYPE_CHECKING, Final
from weakref import WeakSet

from rhi.commands.recorder import Recorder
from rhi.contract.backend import Backend, Capabilities
from rhi.device.core.core import ENDING, FORKED, NO_THREAD, block_forever
from rhi.device.device import Device
from rhi.errors import DeviceError, RhiError, refuse
from rhi.errors.arguments import ArgumentChecker
from rhi.errors.data_classes import dataclass
from rhi.errors.rules import DEVICE_ARGUMENT, DEVICE_DRIVER, DEVICE_FORKED, DEVICE_UNKNOWN
from rhi.shading import Precision

if TYPE_CHECKING:
    from importlib.metadata import EntryPoint

GROUP: Final = "rhi.backends"
BUILT_IN: Final = {
    name: f"rhi.backends.{name}:create_backend" for name in ("gl", "cl", "wgpu", "web", "null")
}
"""The functions of this package's own backends, by name. Tools that package programs don't see such names as
imports: `rhi/shading/tools/pyinstaller` has a hook, and docs/errors.md says what others need."""
PREFERENCE: Final = ("web",) if sys.platform == "emscripten" else ("gl",)
"""Backends that are tried first, in this order, if no name is given. A backend that doesn't render must be
named."""


_LONGEST: Final = 5.0  # seconds
_creating: Final[set[int]] = set()  # threads that create a device
_is_ending = False
_devices: Final[WeakSet[Device]] = WeakSet()
_loaded: Final[set[str]] = set()  # backends whose drivers this process has loaded
_forked: Final[set[str]] = set()  # backends whose drivers its parent had loaded when it forked


@cache
def _entry_points() -> dict[str, EntryPoint]:
    # A lazy import: it takes a seventh of the package's import time.
    from importlib.metadata import EntryPoint, entry_points

    points = {name: EntryPoint(name, function, GROUP) for name, function in BUILT_IN.items()}
    return points | {point.name: point for point in entry_points(group=GROUP)}


def backend_names() -> list[str]:
    """Return the names of the installed backends, in the order in which they are tried.

    Examples:
        >>> "null" in rhi.backend_names()
        True
    """
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
    precision: Precision | None = None,
    **options: object,
) -> Device:
    """Create a device on the backend `name`.

    Args:
        name: a backend's name, or `module:function` for one that is not installed; None uses `RHI_BACKEND`
            from the environment, or else the first backend that works.
        validation: also turn the driver's own error messages into exceptions, and check thread and context at
            each draw (slower).
        record: keep every command with the line it came from (`device.stream`); None: only on the null
            device.
        timing: take timestamps in `device.event` blocks.
        frames_in_flight: how many frames the CPU may be ahead of the GPU.
        precision: the precision of shaders that don't state one, where a backend has a choice (OpenCL); None
            uses `RHI_PRECISION` from the environment, `fast` or `exact`, or else EXACT.
        options: options of the named backend, which are the keyword parameters of its `create_backend`.

    Raises:
        ValidationError: `device-argument` for an option that the backend doesn't have.
        DeviceError: `device-unknown` if no backend has this name, `device-driver` if its driver
            can't be used, with a tip about what to install.

    Examples:
        >>> with rhi.create_device("null") as null:
        ...     null.backend_name
        'null'
    """
    check = ArgumentChecker("rhi.create_device")
    if name is not None:
        check.text("name", name)
    validation, timing = check.flag("validation", validation), check.flag("timing", timing)
    if record is not None:
        record = check.flag("record", record)
    frames_in_flight = check.integer("frames_in_flight", frames_in_flight, 1)
    precision = default_precision() if precision is None else check.choice("precision", precision, Precision)
    name = name or os.environ.get("RHI_BACKEND") or None
    here = get_ident()
    _creating.add(here)
    try:
        backend = _create_named(name, validation, options) if name else _create_first(validation, options)
        if record is None:
            record = backend.capabilities.backend == "null"
        device = Device(
            Recorder(backend) if record else backend,
            validation=validation,
            timing=timing,
            frames_in_flight=frames_in_flight,
            precision=precision,
        )
        _devices.add(device)
        device._core.hand_back()  # to other code whose context was current
        if _is_ending and here != main_thread().ident:
            block_forever()
    finally:
        _creating.discard(here)
    return device


def default_precision() -> Precision:
    """Return the precision that `RHI_PRECISION` names, or EXACT.

    Raises:
        ValidationError: `device-argument` if it names none.
    """
    name = os.environ.get("RHI_PRECISION") or Precision.EXACT.value
    if name.lower() not in {precision.value for precision in Precision}:
        refuse(DEVICE_ARGUMENT, "rhi.create_device", f"RHI_PRECISION={name}", "fast, exact")
    return Precision(name.lower())


def _note_fork() -> None:
    """Mark the parent's devices as unusable, in a process that was just forked: their drivers' threads and
    locks are gone."""
    _forked.update(_loaded)
    for device in _devices:
        device._core.thread = FORKED


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_note_fork)


def _stop_daemons() -> None:
    """Keep daemon threads out of drivers while the interpreter ends, since a driver's C++ code would abort
    the process. Their next calls don't return. Calls in progress are waited for, at most `_LONGEST` seconds.
    """
    global _is_ending
    _is_ending = True
    here = get_ident()
    passes = {}
    for device in list(_devices):
        core = device._core
        if not core.closed and core.thread not in (here, NO_THREAD, FORKED):
            passes[core.thread] = core
            core.closed, core.thread = True, ENDING
    until = time.monotonic() + _LONGEST
    calm = 0
    while (passes or _creating - {here}) and calm < 2 and time.monotonic() < until:
        frames = sys._current_frames()
        is_busy = any(
            _is_inside(frames.get(thread))
            or (core.render_pass is not None and not _is_stopped(frames.get(thread)))
            for thread, core in passes.items()
        ) or any(not _is_stopped(frames.get(thread)) for thread in _creating - {here})
        calm = 0 if is_busy else calm + 1
        time.sleep(0.002)


def _is_stopped(frame: FrameType | None) -> bool:
    return frame is None or frame.f_code is block_forever.__code__


def _is_inside(frame: FrameType | None) -> bool:
    """True if a thread is inside a call of this package that hasn't been stopped."""
    if _is_stopped(frame):
        return False
    while frame is not None and not str(frame.f_globals.get("__name__")).startswith("rhi."):
        frame = frame.f_back
    return frame is not None


atexit.register(_stop_daemons)


def _create_named(name: str, validation: bool, options: Mapping[str, object]) -> Backend:
    create = load_backend_factory(name)
    if name in _forked:
        raise DeviceError(
            DEVICE_FORKED, f"rhi.create_device({name!r})", f"{name} was used before this process was forked"
        )
    if name != "null":
        _loaded.add(name)
    if options:
        accepted = list(inspect.signature(create).parameters.keys() - {"validation"})
        unknown = sorted(options.keys() - accepted)
        if unknown:
            given, allowed = ", ".join(unknown), ", ".join(sorted(accepted)) or "no options"
            refuse(DEVICE_ARGUMENT, f"rhi.create_device({name!r}, {unknown[0]}=…)", given, allowed)
    return create(validation=validation, **options)


def load_backend_factory(name: str) -> Callable[..., Backend]:
    """Return the function that creates the backend of this name; it isn't called.

    Raises:
        DeviceError: `device-unknown` if no backend has this name, or its module can't be imported.
    """
    point = _entry_points().get(name)
    if ":" in name:
        from importlib.metadata import EntryPoint

        point = EntryPoint(name, name, GROUP)
    if point is None:
        from difflib import get_close_matches  # which only errors need

        names = backend_names()
        close = get_close_matches(name, names, 1)
        tip = f"did you mean {close[0]!r}?" if close else ""
        raise DeviceError(DEVICE_UNKNOWN, f"rhi.create_device({name!r})", repr(name), ", ".join(names), tip)
    call, tip = f"rhi.create_device({name!r})", "is its module on Python's path?"
    try:
        create: Callable[..., Backend] = point.load()
    except (ImportError, AttributeError) as error:
        if point.value == BUILT_IN.get(name):
            tip = f"this program was packaged without it: include the modules of rhi.backends.{name}"
            raise DeviceError(DEVICE_DRIVER, call, f"{name!r}: {error}", "", tip) from error
        raise DeviceError(DEVICE_UNKNOWN, call, f"{name!r}: {error}", "", tip) from error
    try:
        inspect.signature(create).bind(validation=False)
    except (TypeError, ValueError) as error:  # it isn't called: it may be any function of any module
        given, tip = f"{name!r}: {error}", "see python -m rhi docs porting"
        raise DeviceError(DEVICE_UNKNOWN, call, given, "a function create(*, validation)", tip) from error
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
        reasons.append(f"{name}: it doesn't render, so it must be requested by name")
    tip = 'install a driver (see python -m rhi), or request the null device: rhi.create_device("null")'
    raise DeviceError(DEVICE_DRIVER, "rhi.create_device()", "\n".join(reasons) or "no backends", "", tip)


@dataclass(frozen=True, slots=True)
class BackendReport:
    """The state of one backend on this machine: its capabilities, or the reason why it can't be used."""

    name: str
    usable: bool
    reason: str
    tip: str
    capabilities: Capabilities | None


def report() -> list[BackendReport]:
    """Try every backend and return a report on each."""
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
