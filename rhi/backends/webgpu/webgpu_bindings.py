"""Bound resources, and the bind groups for them.

- Bind groups are cached by their resources, until one of these is destroyed, at most `MAX_GROUPS`.
- `changed` says that a group must be bound anew; `moved`, that only offsets of uniforms have changed.
- A texture that is both sampled and stored to is sampled from a copy: WebGPU forbids both at once.
"""

from __future__ import annotations

from collections.abc import Callable
from collections.abc import Set as AbstractSet
from typing import Any, Final

from rhi.backends.webgpu.command_encoder import Stream
from rhi.backends.webgpu.implementation import GpuObject, Handle
from rhi.backends.webgpu.webgpu_buffers import GAP, Buffers, GpuBuffer
from rhi.backends.webgpu.webgpu_errors import translate_errors
from rhi.backends.webgpu.webgpu_formats import DIMENSIONS
from rhi.backends.webgpu.webgpu_programs import GpuProgram, PipelineLayout
from rhi.backends.webgpu.webgpu_samplers import Samplers
from rhi.backends.webgpu.webgpu_textures import GpuTexture, Textures
from rhi.contract.descriptors import Id, TextureKind
from rhi.contract.formats import Format
from rhi.contract.layout import FLOAT

MAX_GROUPS: Final = 8192

BindGroup = Callable[[Handle, int, Handle, int, Handle], object]
"""A function that binds a group: (pass, index, group, number of offsets, offsets)."""

PackGroup = Callable[[Handle, int, Handle, int], Callable[..., bytes]]
"""`rhi.backends.webgpu.implementation.Implementation.pack_group`."""


class BoundResources:
    """The bindings of a device."""

    def __init__(
        self,
        device: GpuObject,
        stream: Stream,
        buffers: Buffers,
        textures: Textures,
        samplers: Samplers,
        unfilterable: AbstractSet[Format],
    ) -> None:
        self._device = device
        self._stream = stream
        self._buffers = buffers
        self._textures = textures
        self._samplers = samplers
        self._unfilterable = unfilterable
        self.uniforms: dict[int, tuple[Id, int]] = {}
        self.offsets: dict[int, int] = {}
        self.storages: dict[int, tuple[Id, int, int]] = {}
        self.sampled: dict[int, tuple[Id, Id]] = {}
        self.images: dict[int, tuple[Id, int, int]] = {}
        self.dirty = [True, True, True, True]
        self.changed = True
        self.moved = False
        self.retextured = True
        self._groups: dict[tuple[object, ...], GpuObject] = {}
        self._users: dict[Id, set[tuple[object, ...]]] = {}
        implementation = stream.implementation
        self._no_offsets = implementation.no_offsets
        self.uniform_group: Handle = None
        self._uniform_object: GpuObject | None = None
        self.pack_offsets: Callable[..., bytes] | None = None  # of the group of uniforms

    # -- slots -------------------------------------------------------------------------------------------

    def bind_uniform(self, slot: int, buffer: Id, offset: int, size: int) -> None:
        if self.uniforms.get(slot) != (buffer, size):
            self.uniforms[slot] = buffer, size
            self.dirty[0] = self.changed = True
        self.offsets[slot] = offset
        self.moved = True

    def bind_storage(self, slot: int, buffer: Id, offset: int, size: int) -> None:
        self.storages[slot] = buffer, offset, size
        self.dirty[1] = self.changed = True

    def bind_texture(self, slot: int, texture: Id, sampler: Id) -> None:
        self.sampled[slot] = texture, sampler
        self.dirty[2] = True
        self.changed = True
        self.retextured = True

    def bind_image(self, slot: int, texture: Id, level: int, layer: int) -> None:
        self.images[slot] = texture, level, layer
        self.dirty[3] = self.changed = True

    def prepare_uniform(self, buffer: Id) -> Callable[[int, int, int], object]:
        """Return `bind_uniform` of a buffer."""
        uniforms = self.uniforms
        offsets = self.offsets
        dirty = self.dirty
        pairs: dict[int, tuple[Id, int]] = {}  # the same object for each size

        def bind(slot: int, offset: int, size: int) -> None:
            pair = pairs.get(size)
            if pair is None:
                pair = pairs[size] = (buffer, size)
            bound = uniforms.get(slot)
            if bound is not pair and bound != pair:
                uniforms[slot] = pair
                dirty[0] = self.changed = True
            offsets[slot] = offset
            self.moved = True

        return bind

    def prepare_uniform_write(self, buffer: Id) -> Callable[[int, int, bytes], object]:
        """Return a write to a buffer that binds what it has written."""
        target = self._buffers.objects[buffer]
        write, bind = self._buffers.write, self.prepare_uniform(buffer)
        ranges, uniforms, offsets, dirty = target.dirty, self.uniforms, self.offsets, self.dirty
        pairs: dict[int, tuple[Id, int]] = {}

        def write_and_bind(slot: int, offset: int, data: bytes) -> None:
            size = len(data)
            if target.shadow is None or target.device_wrote or not ranges:
                write(buffer, offset, data)
                bind(slot, offset, size)
                return
            # As `Buffers.write` and `bind` do, without their three frames.
            target.version += 1
            last, end = ranges[-1], offset + size
            if last[0] <= offset <= last[1] + GAP:
                if end > last[1]:
                    last[1] = end
            else:
                ranges.append([offset, end])
            target.shadow[offset:end] = data
            pair = pairs.get(size)
            if pair is None:
                pair = pairs[size] = (buffer, size)
            bound = uniforms.get(slot)
            if bound is not pair and bound != pair:
                uniforms[slot] = pair
                dirty[0] = self.changed = True
            offsets[slot] = offset
            self.moved = True

        return write_and_bind

    def invalidate(self) -> None:
        """Bind all groups anew: a pass or another program has begun."""
        self.dirty[:] = True, True, True, True
        self.changed = True

    def forget(self, resource: Id) -> None:
        """Drop the bind groups that contain a resource, or that belong to a program."""
        for key in self._users.pop(resource, ()):
            self._groups.pop(key, None)

    # -- groups ------------------------------------------------------------------------------------------

    def unfiltered(self, program: GpuProgram) -> tuple[int, ...]:
        """Return the slots of a program's textures that can't be filtered."""
        if not program.float_textures:
            return ()
        objects = self._textures.objects
        return tuple(
            slot
            for slot in program.float_textures
            if slot in self.sampled and not self._can_filter(objects[self.sampled[slot][0]].descriptor.format)
        )

    def _can_filter(self, format: Format) -> bool:
        return not format.is_depth and format not in self._unfilterable

    def mark(self, program: GpuProgram) -> None:
        """Note that the open encoder uses a program's bound resources, and which of them it writes."""
        serial = self._stream.serial
        buffers = self._buffers.objects
        textures = self._textures.objects
        for slot in program.uniforms:
            buffers[self.uniforms[slot][0]].serial = serial
        for slot in program.storages:
            buffers[self.storages[slot][0]].serial = serial
        for slot in program.written:
            self._buffers.note_device_write(buffers[self.storages[slot][0]])
        for slot in program.textures:
            textures[self.sampled[slot][0]].serial = serial
        for slot in program.images:
            textures[self.images[slot][0]].serial = serial

    def list_used(self, program: GpuProgram) -> list[GpuBuffer | GpuTexture]:
        """Return the buffers and textures that are bound for a program; `mark` notes them."""
        buffers, textures = self._buffers.objects, self._textures.objects
        return [
            *(buffers[self.uniforms[slot][0]] for slot in program.uniforms),
            *(buffers[self.storages[slot][0]] for slot in program.storages),
            *(textures[self.sampled[slot][0]] for slot in program.textures),
            *(textures[self.images[slot][0]] for slot in program.images),
        ]

    def copy_slots(self) -> tuple[dict[int, Any], ...]:
        """Return copies of what is bound to all slots."""
        return tuple(dict(slots) for slots in self._list_slots())

    def restore_slots(self, copies: tuple[dict[int, Any], ...]) -> None:
        """Bind what `copy_slots` has returned."""
        for slots, copy in zip(self._list_slots(), copies, strict=True):
            slots.clear()
            slots.update(copy)
        self.invalidate()
        self.retextured = True

    def _list_slots(self) -> tuple[dict[int, Any], ...]:
        return self.uniforms, self.offsets, self.storages, self.sampled, self.images

    def apply(self, program: GpuProgram, layout: PipelineLayout, bind: BindGroup, encoder: Handle) -> None:
        """Bind the groups of a program that have changed."""
        self.mark(program)
        dirty = self.dirty
        if program.groups and (dirty[0] or self.moved):
            if dirty[0]:
                self._uniform_object = self._get_group(program, layout, 0)
                self.uniform_group = self._uniform_object._internal
                self.pack_offsets = None
                dirty[0] = False
            self.move(program, bind, encoder)
        for index in range(1, program.groups):
            if dirty[index]:
                bind(encoder, index, self._get_group(program, layout, index)._internal, 0, self._no_offsets)
                dirty[index] = False
        self.changed = self.moved = False

    def move(self, program: GpuProgram, bind: BindGroup, encoder: Handle) -> None:
        """Bind the group of uniforms with the current offsets."""
        array, count = program.offset_array, len(program.uniforms)
        array[0:count] = program.select_offsets(self.offsets)
        bind(encoder, 0, self.uniform_group, count, array)
        self.moved = False

    def prepare_offsets(
        self, pack_group: PackGroup, program: GpuProgram, encoder: Handle
    ) -> Callable[..., bytes]:
        """Return the function of offsets that packs what `move` binds."""
        self.pack_offsets = pack_group(encoder, 0, self.uniform_group, len(program.uniforms))
        return self.pack_offsets

    def copied(self, program: GpuProgram) -> dict[int, GpuObject]:
        """Return copies of the textures that a program both samples and stores to, by slot. Ends the open
        pass."""
        stored = {self.images[slot][0] for slot in program.written_images}
        return {
            slot: self._textures.copy_whole(self.sampled[slot][0])
            for slot in program.textures
            if self.sampled[slot][0] in stored
        }

    def _get_group(self, program: GpuProgram, layout: PipelineLayout, index: int) -> GpuObject:
        """Return a bind group from the cache, creating it if it isn't there."""
        slots: tuple[int, ...]
        bound: dict[int, Any]
        slots, bound = (
            (program.uniforms, self.uniforms),
            (program.storages, self.storages),
            (program.textures, self.sampled),
            (program.images, self.images),
        )[index]
        parts = [bound[slot] for slot in slots]
        key = (program.id, layout.unfiltered, index, *parts)
        group = self._groups.get(key)
        if group is None:
            if len(self._groups) >= MAX_GROUPS:
                self._groups.clear()
                self._users.clear()
            group = self._groups[key] = self._make(program, layout, index, {})
            self._users.setdefault(program.id, set()).add(key)
            for part in parts:
                self._users.setdefault(part[0], set()).add(key)
                if index == 2:
                    self._users.setdefault(part[1], set()).add(key)
        if self._stream.retained is not None:
            self._stream.retained.append(group)
        return group

    def sampling_copies(
        self, program: GpuProgram, layout: PipelineLayout, copies: dict[int, GpuObject]
    ) -> GpuObject:
        """Return a bind group of textures, some of them copies; it isn't cached."""
        return self._make(program, layout, 2, copies)

    def _make(
        self, program: GpuProgram, layout: PipelineLayout, index: int, copies: dict[int, GpuObject]
    ) -> GpuObject:
        entries: list[dict[str, Any]] = []
        if index == 0:
            for slot in program.uniforms:
                buffer, size = self.uniforms[slot]
                part = {"buffer": self._buffers[buffer].object, "offset": 0, "size": -(-size // 16) * 16}
                entries.append({"binding": 2 * slot, "resource": part})
            entries += [
                {"binding": binding, "resource": part} for binding in program.pads
            ]  # any buffer will do
        elif index == 1:
            for slot in program.storages:
                buffer, offset, size = self.storages[slot]
                part = {"buffer": self._buffers[buffer].object, "offset": offset, "size": -(-size // 4) * 4}
                entries.append({"binding": slot, "resource": part})
        elif index == 2:
            for slot in program.textures:
                texture, sampler = self.sampled[slot]
                type = program.texture_type(slot)
                view = self._textures.sampled_view(texture)
                if slot in copies:
                    view = copies[slot].create_view(dimension=DIMENSIONS[type.kind])
                filters = type.scalar is FLOAT and not type.samples and slot not in layout.unfiltered
                entries.append({"binding": 2 * slot, "resource": view})
                sampler_object = self._samplers.get(sampler, filters, type.compare)
                entries.append({"binding": 2 * slot + 1, "resource": sampler_object})
        else:
            for slot in program.images:
                texture, level, layer = self.images[slot]
                kind: TextureKind = program.image_type(slot).kind
                view = self._textures.image_view(texture, kind, level, layer)
                entries.append({"binding": slot, "resource": view})
        with translate_errors("device.bind"):
            return self._device.create_bind_group(layout=layout.groups[index], entries=entries)
