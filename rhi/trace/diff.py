"""`diff`: the differences between two traces, aligned by labels.

- Labels form a tree. The children of a label are aligned with those of the corresponding label, so a command
  that is missing in one pass doesn't shift the comparison of the next.
- Ids are compared by the resource that they name (its type, its label or descriptor, and which of several
  equal ones, in the order in which they are first mentioned). So an additional texture at the start doesn't
  change every later command. A program is compared by its name and sources.
- Parts of streams, such as frames, are compared in the same way: what existed before them has a name as well,
  and fences are counted from the first that the part signals.
- Places in streamed buffers, whose ring goes on from frame to frame, are numbered as they are first
  mentioned.
- Two commands of the same op at the same place are one change, described by the arguments that differ.
- Refused calls are compared like commands, by rule and call.
"""

from __future__ import annotations

import dataclasses
from collections import Counter, deque
from collections.abc import Hashable, Sequence
from dataclasses import dataclass, field
from typing import Any, Final, overload

import numpy as np

from rhi.commands.buffer_bytes import UnknownDataError
from rhi.commands.ops import CREATIONS, ID_ARGUMENTS, ID_KINDS, Descriptor, Op
from rhi.commands.stream import Command, Commands, CommandStream, Refusal
from rhi.commands.text import describe
from rhi.contract import descriptors
from rhi.contract.descriptors import Id
from rhi.device.device import Device
from rhi.trace.align import align
from rhi.trace.codec import encode, sources_of
from rhi.trace.file import Trace

TraceSource = Trace | Device | Commands
Thing = Command | Refusal
REFUSED: Final = "refused"

_KINDS: Final[dict[type, str]] = {
    descriptors.BufferDescriptor: "buffer",
    descriptors.TextureDescriptor: "texture",
    descriptors.SamplerDescriptor: "sampler",
    descriptors.ProgramDescriptor: "program",
    descriptors.VertexArrayDescriptor: "vertex array",
}
"""The words for resources, by the type of their descriptor; all others are queries."""


@dataclass(frozen=True)
class Difference:
    """A command or refused call that only one trace has, or two that differ at the same place.

    Attributes:
        labels: the labels around it, outermost first.
        a, b: the command or refusal in each trace, or None.
        changes: for two commands, "argument: value in a → value in b".
    """

    labels: tuple[str, ...]
    a: Command | Refusal | None
    b: Command | Refusal | None
    changes: tuple[str, ...] = ()

    def __str__(self) -> str:
        if self.a is not None and self.b is not None:
            what = self.a.op.method if isinstance(self.a, Command) else self.a.call
            return f"~ {self.a.index:>6}  {what}: {', '.join(self.changes)}  {self.b.site or ''}"
        command = self.a or self.b
        assert command is not None
        return f"{'-' if self.b is None else '+'} {command.index:>6}  {command}"


class Differences(Sequence[Difference]):
    """The differences of two streams in order; an empty one is false. Its text lists them under their
    labels."""

    def __init__(self, items: list[Difference]) -> None:
        self._items = items

    def __len__(self) -> int:
        return len(self._items)

    @overload
    def __getitem__(self, index: int) -> Difference: ...
    @overload
    def __getitem__(self, index: slice) -> Differences: ...
    def __getitem__(self, index: int | slice) -> Difference | Differences:
        return Differences(self._items[index]) if isinstance(index, slice) else self._items[index]

    def __str__(self) -> str:
        lines: list[str] = []
        labels: tuple[str, ...] | None = None
        for item in self._items:
            if item.labels != labels:
                labels = item.labels
                lines.append(" / ".join(labels) or "(no label)")
            lines.append(f"  {item}")
        return "\n".join(lines) or "no differences"


def _list_offset_arguments(op: Op) -> dict[int, int]:
    """Return the indices of the arguments that are offsets into buffers, with those of the buffers."""
    names = list(op.parameters)
    pairs = {f"{name.removesuffix('buffer').rstrip('_')}_offset".lstrip("_"): name for name in names}
    return {names.index(offset): names.index(name) for offset, name in pairs.items() if offset in names}


_OFFSET_ARGUMENTS: Final = {op: _list_offset_arguments(op) for op in Op}
_FENCES: Final = frozenset({Op.SIGNAL, Op.WAIT})


def diff(a: TraceSource, b: TraceSource) -> Differences:
    """Return the differences of trace `b` from trace `a`, or of one part of a stream from another.

    Examples:
        >>> len(diff(device, device))
        0
    """
    programs = _ProgramKeys()
    left, right = _Side(_select(a), programs), _Side(_select(b), programs)
    differences: list[Difference] = []
    _compare(left, right, left.root, right.root, (), differences)
    return Differences(differences)


def _select(source: TraceSource) -> Commands:
    return source.stream if isinstance(source, (Trace, Device)) else source


class _ProgramKeys:
    """The keys by which programs are compared: the same one for the same fields and sources.

    Writing the sources takes longer than all else, so it is done only for programs that don't differ in
    another way.
    """

    def __init__(self) -> None:
        self._keys: dict[descriptors.ProgramDescriptor, Hashable] = {}
        self._alike: dict[str, list[descriptors.ProgramDescriptor]] = {}  # those with the same fields

    def get_key(self, program: descriptors.ProgramDescriptor) -> Hashable:
        key = self._keys.get(program)
        if key is None:
            fields = repr(encode(program))
            alike = self._alike.setdefault(fields, [])
            number = next(
                (i for i, other in enumerate(alike) if sources_of(other) == sources_of(program)), len(alike)
            )
            alike.append(program)
            key = self._keys[program] = fields, number
        return key


@dataclass(slots=True)
class _Node:
    """A label with its children (commands, refused calls and labels) and the key by which each is
    compared."""

    index: int
    keys: list[Hashable] = field(default_factory=list)
    items: list[int | Refusal | _Node] = field(default_factory=list)

    def add_refusal(self, refusal: Refusal) -> None:
        self.keys.append((REFUSED, refusal.error, refusal.call, refusal.given, refusal.allowed))
        self.items.append(refusal)


class _Side:
    """A trace of the two, prepared for the comparison."""

    def __init__(self, commands: Commands, programs: _ProgramKeys) -> None:
        self.stream = stream = commands.stream
        self.names: dict[Id, str] = {}
        self._programs = programs
        self._index = 0  # of the command whose key is being found
        signals = (index for index in commands.indices() if stream.op(index) is Op.SIGNAL)
        first = next(signals, None)
        self._fence = 0 if first is None else stream.entry(first)[1][0]
        self._identities: dict[Id, Hashable] = {}
        self._descriptors: dict[Id, Descriptor] = {}
        self._offsets: dict[str, dict[tuple[Id, int], int]] = {}  # by ring, the number of each place
        self._seen: Counter[Hashable] = Counter()
        self._keys: dict[Hashable, Hashable] = {}
        self.root = _Node(-1)
        path = [self.root]
        refusals = deque(commands.refusals)
        for index in commands.indices():
            self._index = index
            while refusals and refusals[0].index <= index:
                path[-1].add_refusal(refusals.popleft())
            op, values, _, _ = stream.entry(index)
            if op is Op.PUSH_LABEL:
                node = _Node(index)
                path[-1].keys.append(("label", values[0]))
                path[-1].items.append(node)
                path.append(node)
            elif op is Op.POP_LABEL and len(path) > 1:
                path.pop()
            else:
                path[-1].keys.append(self._key(op, values, stream.failures.get(index)))
                path[-1].items.append(index)
        for refusal in refusals:
            path[-1].add_refusal(refusal)

    def _key(self, op: Op, values: tuple[Any, ...], failure: object) -> Hashable:
        """Return the key by which a command is compared; it is computed once for equal commands."""
        if op in CREATIONS:
            return (op, *self._register(values[0], values[1]), failure)
        if op in _FENCES:
            return op, values[0] - self._fence, *values[1:], failure
        key = self._keys.get((op, values, failure))
        if key is None:
            id_indices = ID_ARGUMENTS[op]
            parts = [self.identify(v) if i in id_indices else self.normalize(v) for i, v in enumerate(values)]
            for offset, buffer in _OFFSET_ARGUMENTS[op].items():
                parts[offset] = self._locate(values[buffer], values[offset])
            key = self._keys[op, values, failure] = (op, *parts, failure)
        return key if op is not Op.DRAW_INDIRECT else (key, self.draws(self._index))

    def draws(self, index: int) -> bytes:
        """The draws of an indirect command; none if they are unknown."""
        try:
            return Command(self.stream, index).draw_arguments.tobytes()
        except UnknownDataError:
            return b""

    def _register(self, resource: Id, descriptor: Descriptor) -> tuple[Hashable, int]:
        """Name a resource; return what it is, and which of several equal ones."""
        kind = _KINDS.get(type(descriptor), "query")
        what = self.normalize(descriptor)
        self._seen[kind, what] += 1
        number = self._seen[kind, what]
        label = getattr(descriptor, "label", "") or getattr(descriptor, "name", "")
        name = repr(label) if label and isinstance(label, str) else "without a label"
        self.names[resource] = f"{kind} {name} #{number}"
        self._identities[resource] = kind, what, number
        self._descriptors[resource] = descriptor
        return what, number

    def name(self, resource: Id) -> str:
        """Name of a resource in a message."""
        self.identify(resource)
        return self.names.get(resource, f"id {resource}") if resource else "none"

    def identify(self, resource: Id) -> Hashable:
        """Describe the resource of an id: its kind, its descriptor, and which of several equal
        ones."""
        if not resource:
            return 0
        if resource not in self._identities:
            descriptor = self.stream.context(self._index).resources.get(resource)
            if descriptor is None:
                return "id", resource
            self._register(resource, descriptor)
        streamed = self._get_ring_label(resource)
        return self._identities[resource] if streamed is None else ("streamed", streamed)

    def _get_ring_label(self, buffer: Id) -> str | None:
        """Return the label of a streamed buffer, None of any other. A ring goes on in the next when one is
        full."""
        descriptor = self._descriptors.get(buffer)
        if (
            isinstance(descriptor, descriptors.BufferDescriptor)
            and descriptor.usage is descriptors.BufferUsage.STREAM
        ):
            return descriptor.label
        return None

    def _locate(self, buffer: Id, offset: int) -> Hashable:
        """Stand-in for an offset into a ring buffer, so that equal uses compare as equal."""
        ring = self._get_ring_label(buffer)
        if ring is None:
            return offset
        offsets = self._offsets.setdefault(ring, {})
        return "place", offsets.setdefault((buffer, offset), len(offsets))

    def normalize(self, value: Any) -> Hashable:
        """Return a value with what ids stand for in their place."""
        if isinstance(value, descriptors.ProgramDescriptor):
            return self._programs.get_key(value)
        if type(value) is tuple:
            return tuple(map(self.normalize, value))
        if dataclasses.is_dataclass(value) and not isinstance(value, type):
            fields = dataclasses.fields(value)
            return (
                type(value),
                *(
                    self.identify(getattr(value, f.name))
                    if f.type in ID_KINDS
                    else self.normalize(getattr(value, f.name))
                    for f in fields
                ),
            )
        hashable: Hashable = value
        return hashable


def _compare(
    left: _Side, right: _Side, a: _Node, b: _Node, labels: tuple[str, ...], differences: list[Difference]
) -> None:
    """Append the differences between the children of two labels."""
    x = y = 0
    for next_x, next_y in [*align(a.keys, b.keys), (len(a.keys), len(b.keys))]:
        _report_differences(left, right, a.items[x:next_x], b.items[y:next_y], labels, differences)
        if next_x < len(a.keys):
            left_item, right_item = a.items[next_x], b.items[next_y]
            if isinstance(left_item, _Node) and isinstance(right_item, _Node):
                label = left.stream.entry(left_item.index)[1][0]
                _compare(left, right, left_item, right_item, (*labels, label), differences)
        x, y = next_x + 1, next_y + 1


def _report_differences(
    left: _Side,
    right: _Side,
    removed: list[int | Refusal | _Node],
    added: list[int | Refusal | _Node],
    labels: tuple[str, ...],
    differences: list[Difference],
) -> None:
    """Append the differences between two matches: changes where the kinds are equal, else removals, then
    additions."""
    a = [_thing(left.stream, item) for item in removed]
    b = [_thing(right.stream, item) for item in added]
    x = y = 0
    for next_x, next_y in [*align(list(map(_kind, a)), list(map(_kind, b))), (len(a), len(b))]:
        differences.extend(Difference(labels, command, None) for command in a[x:next_x])
        differences.extend(Difference(labels, None, command) for command in b[y:next_y])
        if next_x < len(a):
            left_item, right_item = a[next_x], b[next_y]
            differences.append(
                Difference(labels, left_item, right_item, tuple(_changes(left, right, left_item, right_item)))
            )
        x, y = next_x + 1, next_y + 1


def _thing(stream: CommandStream, item: int | Refusal | _Node) -> Thing:
    if isinstance(item, Refusal):
        return item
    return Command(stream, item.index if isinstance(item, _Node) else item)


def _kind(thing: Thing) -> Hashable:
    """Return the kind of a command or refusal. Two of the same kind can be reported as one change."""
    return thing.op if isinstance(thing, Command) else (REFUSED, thing.call)


def _changes(left: _Side, right: _Side, a: Thing, b: Thing) -> list[str]:
    if isinstance(a, Refusal) or isinstance(b, Refusal):
        parts = ((name, getattr(a, name), getattr(b, name)) for name in ("error", "given", "allowed"))
        return [f"{name}: {old} → {new}" for name, old, new in parts if old != new]
    changes = []
    for (name, annotation), old, new in zip(a.op.parameters.items(), a.values, b.values, strict=True):
        if annotation in ID_KINDS:
            if a.op in CREATIONS:
                continue
            old, new = left.name(old), right.name(new)
            if old != new:
                changes.append(f"{name}: {old} → {new}")
        elif isinstance(old, bytes) and isinstance(new, bytes):
            if old != new:
                changes.append(f"{name}: {_compare_bytes(old, new)}")
        elif left.normalize(old) != right.normalize(new):
            texts = describe(old), describe(new)
            changes.append(
                f"{name}: {texts[0]} → {texts[1]}" if texts[0] != texts[1] else f"{name}: its contents"
            )
    if a.op is Op.DRAW_INDIRECT and left.draws(a.index) != right.draws(b.index):
        changes.append(f"draws: {a.describe_draws()} → {b.describe_draws()}")
    if a.failure != b.failure:
        failures = [command.failure.error if command.failure is not None else "none" for command in (a, b)]
        changes.append(f"failure: {failures[0]} → {failures[1]}")
    return changes or ["which of several like it"]


def _compare_bytes(a: bytes, b: bytes) -> str:
    if len(a) != len(b):
        return f"{len(a)} bytes → {len(b)} bytes"
    differs = np.flatnonzero(np.frombuffer(a, np.uint8) != np.frombuffer(b, np.uint8))
    return f"{len(differs)} of {len(a)} bytes differ, the first at {differs[0]}"
