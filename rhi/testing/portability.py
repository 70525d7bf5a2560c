"""Would this frame run elsewhere? One frame against many devices, none of which is there.

A frame is a function of a device. It runs on null devices that pretend to be others (`rhi.backends.null.capabilities`),
on each until nothing stops it any more: the call that was refused is noted, the capability that stopped it is granted
to this one line of the program, and the frame runs again. So every line is found that the device would refuse, each
with what it lacks; and a frame that asks `device.capabilities` and adapts is judged by what it then does, since all
other lines see the device as it is.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields
from typing import Any, TypeAlias

from rhi.backends.null.capabilities import PROFILES, find_profile
from rhi.contract.backend import Capabilities
from rhi.device.device import Device
from rhi.device.registry import create_device
from rhi.errors import RhiError, find_user_frame

__rhi_internal__ = True

Line: TypeAlias = tuple[str, int]
Grants: TypeAlias = frozenset[tuple[Line, str]]


@dataclass(frozen=True)
class Obstacle:
    """A call that stops a frame on a device.

    Attributes:
        capability: the field of `Capabilities` without which it is refused.
        error: the refusal, with rule, call, given, allowed and the user's line.
    """

    capability: str
    error: RhiError

    def __str__(self) -> str:
        error = self.error
        given = f": {error.given}" if error.given else ""
        allowed = f" (allowed: {error.allowed})" if error.allowed else ""
        return f"{self.capability}: {error.call}{given}{allowed}  {error.site or ''}  [{error.rule.id}]"


@dataclass(frozen=True)
class Portability:
    """By profile, what stops the frame there, in the order in which it is met: once for each line of the program and
    capability. Prints as a table."""

    obstacles: Mapping[str, tuple[Obstacle, ...]]

    @property
    def runs_on(self) -> list[str]:
        """The profiles on which nothing stops it."""
        return [name for name, found in self.obstacles.items() if not found]

    def __str__(self) -> str:
        lines = []
        for name, found in self.obstacles.items():
            lines.append(f"{name}: {'runs' if not found else f'stopped by {len(found)}'}")
            lines += [f"  {obstacle}" for obstacle in found]
        return "\n".join(lines)


def check_portability(
    frame: Callable[[Device], object], profiles: Mapping[str, Capabilities] = PROFILES
) -> Portability:
    """Run `frame` against all profiles and say which calls would be refused where.

    It is called several times, each with a new device. What it does may depend on the device only.

    Raises:
        RhiError: what the frame breaks on a device that can do everything.
    """
    error = _run(frame, find_profile("everything"), frozenset())
    if error is not None:
        raise error
    return Portability(
        {name: _find_obstacles(frame, find_profile(profile)) for name, profile in profiles.items()}
    )


def _find_obstacles(frame: Callable[[Device], object], profile: Capabilities) -> tuple[Obstacle, ...]:
    found = []
    everything = find_profile("everything")
    lacking = [
        field.name for field in fields(Capabilities)
        if field.name not in ("backend", "device", "driver")
        and getattr(profile, field.name) != getattr(everything, field.name)
    ]  # fmt: skip
    grants: Grants = frozenset()
    while (error := _run(frame, profile, grants)) is not None:
        if error.site is None:
            raise error
        line = error.site.file, error.site.line
        allowed = error.allowed  # most messages name their capability: that one is tried first
        for name in sorted(lacking, key=allowed.find, reverse=True):
            more = grants | {(line, name)}
            if more != grants and not _is_same(error, _run(frame, profile, more)):
                break
        else:
            raise error  # not a matter of one capability
        found.append(Obstacle(name, error))
        grants = more
    return tuple(found)


def _is_same(error: RhiError, other: RhiError | None) -> bool:
    return other is not None and (error.rule, error.call, error.site) == (other.rule, other.call, other.site)


class _ByLine(Capabilities):
    """A profile's capabilities, but where a line of the program was granted more."""

    __slots__ = ("_everything", "_grants", "_names")

    def __getattribute__(self, name: str) -> Any:
        value = super().__getattribute__(name)
        if name in super().__getattribute__("_names"):
            user = find_user_frame()
            if user is not None:
                line = user.f_code.co_filename, user.f_lineno
                if (line, name) in super().__getattribute__("_grants"):
                    return getattr(super().__getattribute__("_everything"), name)
        return value


class _UnsupportedStates(dict[type, str]):
    """Which states the device lacks, as far as the line isn't granted them."""

    def __init__(self, states: Mapping[type, str], capabilities: Capabilities) -> None:
        super().__init__(states)
        self._capabilities = capabilities

    def __contains__(self, state_type: object) -> bool:
        return super().__contains__(state_type) and not getattr(self._capabilities, self[state_type])  # type: ignore[index]


def _run(frame: Callable[[Device], object], profile: Capabilities, grants: Grants) -> RhiError | None:
    """The error that the frame ends in, with these capabilities of these lines beyond the profile's."""
    device = create_device("null", profile=profile)
    core = device._core
    core.capabilities = _grant(core.capabilities, grants)
    core.states.unsupported = _UnsupportedStates(core.states.unsupported, core.capabilities)
    core.states.check_always()
    try:
        frame(device)
    except RhiError as error:
        return error
    finally:
        device.close(quiet=True)
    return None


def _grant(profile: Capabilities, grants: Grants) -> Capabilities:
    granted = _ByLine.__new__(_ByLine)
    more = {
        "_everything": find_profile("everything"),
        "_grants": grants,
        "_names": {name for _, name in grants},
    }
    for name, value in more.items():
        object.__setattr__(granted, name, value)
    for field in fields(Capabilities):
        object.__setattr__(granted, field.name, getattr(profile, field.name))
    return granted
