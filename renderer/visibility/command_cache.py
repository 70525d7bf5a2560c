"""Commands that are the same in frame after frame: recorded once, and only submitted from then on.

A frame's static part is whatever its *key* names: the resources that are used, and the numbers that are part
of commands. What changes from frame to frame, such as the camera, lies in buffers, which commands only refer
to.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

from rhi import CommandBuffer, Device, Encoder, Program, Region, StorageBuffer, Texture

Dispatch = tuple[Program[...], int | tuple[int, ...], dict[str, Any]]
"""A compute program, the number of its groups, and its bindings."""


class CommandCache:
    """Commands that a device executes in each frame.

    Those with a new key are executed directly. When they come again in the next frame they are recorded,
    since they are likely to stay; after that they are only submitted, until the key changes. So commands that
    change in every frame cost nothing more.
    """

    def __init__(self, device: Device, label: str) -> None:
        self._device = device
        self._label = label
        self._key: tuple[object, ...] | None = None
        self._commands: CommandBuffer | None = None

    def execute(self, key: tuple[object, ...], issue: Callable[[Encoder], None]) -> None:
        """Execute the commands that `issue` gives to an encoder; they depend on nothing but `key`. The key
        holds the resources that are used."""
        if key != self._key:
            self.forget()
            issue(self._device)
            self._key = key
            return
        if self.repeat(key):
            return
        commands = self._device.record(label=self._label)
        with commands:
            issue(commands)
        self._commands = commands
        self._device.submit(commands)

    def repeat(self, key: tuple[object, ...]) -> bool:
        """Execute the commands if they are recorded with this key; return whether they are."""
        commands = self._commands
        if commands is None or commands.is_stale or key != self._key:  # stale: a program was exchanged
            return False
        self._device.submit(commands)
        return True

    def dispatch(self, work: Sequence[Dispatch]) -> None:
        """Execute dispatches, in order."""

        def issue(encoder: Encoder) -> None:
            for program, groups, bindings in work:
                encoder.dispatch(program, groups, **bindings)

        key: list[object] = []
        for program, groups, bindings in work:
            key += (program, groups, *bindings.values())
        self.execute(tuple(key), issue)

    def forget(self) -> None:
        """Drop what was recorded, since the resources that it uses may be destroyed."""
        self._key = self._commands = None


def clear(encoder: Encoder, buffer: StorageBuffer[Any]) -> None:
    """Fill a buffer with zeros, in order with the commands of a device or of a command buffer."""
    if isinstance(encoder, CommandBuffer):
        encoder.clear(buffer)
    else:
        buffer.clear()


def copy(
    encoder: Encoder,
    source: Texture | StorageBuffer[Any],
    target: Texture | StorageBuffer[Any],
    *,
    region: Region | None = None,
    x: int = 0,
    y: int = 0,
) -> None:
    """Copy a region (None: all) of a texture to (x, y) of another one, or a whole texture to a buffer or from
    it, in order with the commands of a device or of a command buffer."""
    commands = encoder if isinstance(encoder, CommandBuffer) else None
    if isinstance(source, Texture) and isinstance(target, Texture):
        if commands is None:
            source.copy_to(target, region=region, x=x, y=y)
        else:
            commands.copy_texture(source, target, region=region, x=x, y=y)
    elif isinstance(source, Texture) and isinstance(target, StorageBuffer):
        if commands is None:
            source.copy_to_buffer(target)
        else:
            commands.copy_texture_to_buffer(source, target)
    elif isinstance(source, StorageBuffer) and isinstance(target, Texture):
        if commands is None:
            target.copy_from_buffer(source)
        else:
            commands.copy_buffer_to_texture(source, target)
