"""Would this frame run elsewhere? One frame against many devices, none of which is there.

A frame is a function of a device. It runs on null devices that pretend to be others (`rhi.backends.null.profiles`),
on each until nothing stops it any more: the call that was refused is noted, the one capability that stopped it is
granted, and the frame runs again. So every capability that a frame lacks is found, with the first call that needs
it; and a frame that asks `device.capabilities` and adapts is judged by what it then does.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields, replace

from rhi.backend import Capabilities
from rhi.backends.null.profiles import PROFILES, find_profile
from rhi.device import Device
from rhi.errors import RhiError
from rhi.registry import create_device

__rhi_internal__ = True


@dataclass(frozen=True)
class Obstacle:
    """What stops a frame on a device.

    Attributes:
        capability: the field of `Capabilities` without which the call is refused.
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
    """By profile, what stops the frame there, in the order in which it is met. Prints as a table."""

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
    everything = find_profile("everything")
    error = _run(frame, everything)
    if error is not None:
        raise error
    found = {name: _find_obstacles(frame, find_profile(profile), everything) for name, profile in profiles.items()}
    return Portability(found)


def _find_obstacles(
    frame: Callable[[Device], object], capabilities: Capabilities, everything: Capabilities
) -> tuple[Obstacle, ...]:
    found = []
    lacking = [field.name for field in fields(Capabilities) if field.name not in ("backend", "device", "driver")]
    while (error := _run(frame, capabilities)) is not None:
        allowed = error.allowed  # most messages name their capability: that one is tried first
        for name in sorted(lacking, key=allowed.find, reverse=True):
            granted = _grant(capabilities, name, everything)
            if granted is not None and not _is_same(error, _run(frame, granted)):
                break
        else:
            raise error  # not a matter of one capability
        found.append(Obstacle(name, error))
        capabilities = granted
    return tuple(found)


def _grant(capabilities: Capabilities, name: str, everything: Capabilities) -> Capabilities | None:
    """With one capability as a device has it that can do everything; None if that changes nothing."""
    value = getattr(everything, name)
    return replace(capabilities, **{name: value}) if getattr(capabilities, name) != value else None


def _is_same(error: RhiError, other: RhiError | None) -> bool:
    return other is not None and (error.rule, error.call, error.site) == (other.rule, other.call, other.site)


def _run(frame: Callable[[Device], object], capabilities: Capabilities) -> RhiError | None:
    device = create_device("null", profile=capabilities)
    try:
        frame(device)
    except RhiError as error:
        return error
    finally:
        device.close(quiet=True)
    return None
