"""Checks one frame against the capabilities of many devices, none of which has to be present.

- A frame is a function of a device. It runs on null devices with the profiles of other devices
  (`rhi.backends.null.null_capabilities`), on each profile until nothing refuses it any more: the refused call
  is noted, the capability that it lacks is granted, and the frame runs again.
- `device.capabilities` reports the plain profile in every run, whatever was granted. So a frame that reads it
  and adapts is checked by what it would do on that device.
- A capability is granted to the whole device. So each capability is reported once, at the first call that
  lacks it; later calls that lack the same capability show when that call has been changed.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields, replace

from rhi.backends.null import NullBackend
from rhi.backends.null.null_capabilities import PROFILES, get_profile
from rhi.commands.recorder import Recorder
from rhi.contract.backend import Capabilities
from rhi.device.device import Device
from rhi.errors import RhiError, refuse
from rhi.errors.rules import ASSERTION_ARGUMENT
from rhi.testing.arguments import checker
from rhi.testing.messages import MAX_SHOWN
from rhi.testing.rebinding import BoundBecause, needless_bindings


@dataclass(frozen=True)
class Obstacle:
    """A call that a device with a given profile refuses.

    Attributes:
        capability: the field of `Capabilities` that the call lacks.
        error: the refusal, with rule, call, given, allowed and the user's line.
    """

    capability: str
    error: RhiError

    def __str__(self) -> str:
        error = self.error
        value = f": {error.given}" if error.given else ""
        allowed = f" (allowed: {error.allowed})" if error.allowed else ""
        tip = f"; {error.tip}" if error.tip else ""
        return f"{self.capability}: {error.call}{value}{allowed}{tip}  {error.site or ''}  [{error.rule.id}]"


@dataclass(frozen=True)
class Portability:
    """The result of `check_portability`; it prints as a table.

    Attributes:
        obstacles: for each profile the refused calls, in the order in which the frame reaches them. A
            capability appears at most once, at the first call that lacks it.
        warnings: what runs everywhere and costs time everywhere: commands that bind what is bound already
            (`needless_bindings`).
    """

    obstacles: Mapping[str, tuple[Obstacle, ...]]
    warnings: tuple[BoundBecause, ...] = ()

    @property
    def runs_on(self) -> list[str]:
        """The names of the profiles that refuse nothing."""
        return [name for name, obstacles in self.obstacles.items() if not obstacles]

    def __str__(self) -> str:
        lines = []
        for name, obstacles in self.obstacles.items():
            lines.append(f"{name}: {'runs' if not obstacles else f'stopped by {len(obstacles)}'}")
            lines += [f"  {obstacle}" for obstacle in obstacles]
        if self.warnings:
            lines.append(f"bound needlessly: {len(self.warnings)}")
            lines += [f"  {warning}" for warning in self.warnings[:MAX_SHOWN]]
        return "\n".join(lines)


def check_portability(
    frame: Callable[[Device], object], profiles: Mapping[str, Capabilities] = PROFILES
) -> Portability:
    """Run `frame` against all profiles and report which calls each of them would refuse.

    The frame is called several times, each time with a new device. It may depend on nothing but the device.

    Raises:
        RhiError: the frame breaks a rule on a device that can do everything, or a profile refuses a call for
            a reason that no single capability removes.

    Examples:
        >>> def frame(tested):
        ...     target = tested.texture((8, 8), rhi.Format.RGBA8)
        ...     with tested.render_pass(target, clear=(0, 0, 0, 1)):
        ...         pass
        >>> "webgpu" in check_portability(frame).runs_on
        True
    """
    check = checker("check_portability")
    if not callable(frame) or isinstance(frame, type):
        check.fail("frame", frame, "a function of a device")
    check.instance("profiles", profiles, Mapping, "capabilities by name")
    if not profiles:
        refuse(ASSERTION_ARGUMENT, "check_portability", "no profiles", "capabilities by name")
    everything = get_profile("everything")
    warnings: list[BoundBecause] = []
    error = _run(frame, reported=everything, enforced=everything, warnings=warnings)
    if error is not None:
        raise error
    return Portability(
        {name: _collect_obstacles(frame, get_profile(profile)) for name, profile in profiles.items()},
        tuple(warnings),
    )


def _collect_obstacles(frame: Callable[[Device], object], profile: Capabilities) -> tuple[Obstacle, ...]:
    obstacles = []
    enforced = profile
    while (error := _run(frame, profile, enforced)) is not None:
        granted = _missing_capability(frame, profile, enforced, error)
        if granted is None:
            raise error
        name, enforced = granted
        obstacles.append(Obstacle(name, error))
    return tuple(obstacles)


def _missing_capability(
    frame: Callable[[Device], object], profile: Capabilities, enforced: Capabilities, error: RhiError
) -> tuple[str, Capabilities] | None:
    """Return the name of the one capability without which `error` occurs, and `enforced` with it granted.

    The capabilities that are lacking are halved: those whose grant removes the error contain it.
    """
    everything = get_profile("everything")
    lacking = [
        field.name
        for field in fields(Capabilities)
        if field.name not in ("backend", "device", "driver")
        and getattr(enforced, field.name) != getattr(everything, field.name)
    ]

    def grant(names: list[str]) -> Capabilities:
        return replace(enforced, **{name: getattr(everything, name) for name in names})

    def removes(names: list[str]) -> bool:
        return not _is_same(error, _run(frame, profile, grant(names)))

    while len(lacking) > 1:
        half = lacking[: len(lacking) // 2]
        lacking = half if removes(half) else lacking[len(half) :]
    return (lacking[0], grant(lacking)) if lacking and removes(lacking) else None


def _is_same(error: RhiError, other: RhiError | None) -> bool:
    return other is not None and (error.rule, error.call, error.site) == (other.rule, other.call, other.site)


class _ProfiledDevice(Device):
    """A null device that reports one profile and enforces another, wider one."""

    def __init__(self, reported: Capabilities, enforced: Capabilities) -> None:
        super().__init__(Recorder(NullBackend(enforced)))
        self._reported = reported

    @property
    def capabilities(self) -> Capabilities:
        """The reported profile."""
        return self._reported


def _run(
    frame: Callable[[Device], object],
    reported: Capabilities,
    enforced: Capabilities,
    warnings: list[BoundBecause] | None = None,
) -> RhiError | None:
    """Run the frame and return the error that it ends in. Append the bindings that are needless."""
    device = _ProfiledDevice(reported, enforced)
    try:
        frame(device)
        if warnings is not None:
            warnings += needless_bindings(device)
    except RhiError as error:
        return error
    finally:
        device.close(quiet=True)
    return None
