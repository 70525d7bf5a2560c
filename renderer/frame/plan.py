"""The plan of a frame: which passes run, in which order, and which textures they draw to.

A technique declares its passes with the *resources* that each of them reads and writes. Resources have names,
such as `depth`, and every name is written by one pass. A pass that draws over a resource gives the result a
new name, so what a name means never depends on an order. From this `make_plan` finds everything else:

- **order**: resources are written before they are read, and read before they are drawn over. Passes that
  don't depend on each other keep the order of their declaration. A circle is refused by the names of its
  passes.
- **what runs**: the frame's outputs are needed as the last pass that draws over them leaves them, and so is
  what a needed pass reads. A pass with side effects is needed, and so are its inputs. Resources that a needed
  pass reads from the last frame are needed, too. The rest is dropped.
- **memory**: resources of the same format, size and samples share a texture unless both are needed at the
  same time.

A plan depends on the declaration only. It knows no device, and is kept until the declaration changes.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Final, Generic, TypeVar

from renderer import rules
from rhi import Format, refuse

F = TypeVar("F")
"""The type that passes are run with: a frame."""

OUTPUTS: Final = ("image", "depth")
"""The resources that every frame has: its image, and the depth that layers and tools read."""


@dataclass(frozen=True, slots=True)
class Target:
    """A resource that a pass writes from scratch, and the texture that it needs.

    Attributes:
        name: the name of the resource.
        scale: width and height in those of the frame, rounded up.
        samples: samples per pixel.
    """

    name: str
    format: Format
    scale: float = 1.0
    samples: int = 1

    def fit(self, size: tuple[int, int]) -> tuple[int, int]:
        """The texture's (width, height) in pixels for a frame of `size`."""
        return fit_size(size, self.scale)


@dataclass(frozen=True, slots=True)
class FramePass(Generic[F]):
    """A step of a frame: render passes, compute work, or both.

    Attributes:
        run: issues the commands.
        reason: why the pass is in the frame, such as the effect that calls for it; part of a sentence.
        reads: names of resources that are read.
        writes: resources that are written from scratch; a name alone is for those in a buffer that a
            technique keeps.
        changes: names of resources that are drawn over, each with the name of the result.
        reads_previous: names of resources that are read as the last frame left them.
        draws_objects: whether it draws the visible objects, all of them.
        has_side_effects: whether something besides the resources depends on the pass, so that it is never
            dropped.
    """

    name: str
    run: Callable[[F], None]
    reason: str
    reads: tuple[str, ...] = ()
    writes: tuple[Target | str, ...] = ()
    changes: Mapping[str, str] = field(default_factory=dict)
    reads_previous: tuple[str, ...] = ()
    has_side_effects: bool = False
    draws_objects: bool = False


@dataclass(frozen=True, slots=True)
class SharedTexture:
    """A texture of a plan, and the names of all resources that it holds in turn.

    A `has_history` one has a second texture with the last frame's resource: the two are exchanged after each
    frame.
    """

    format: Format
    scale: float
    samples: int
    names: tuple[str, ...]
    has_history: bool = False

    def count_bytes(self, size: tuple[int, int]) -> int:
        """Bytes of the texture for a frame of `size`."""
        width, height = fit_size(size, self.scale)
        return width * height * self.samples * self.format.texel_bytes * (2 if self.has_history else 1)


@dataclass(frozen=True, slots=True)
class DroppedPass:
    """A declared pass that doesn't run, and the reason."""

    name: str
    reason: str


@dataclass(frozen=True, slots=True)
class Plan(Generic[F]):
    """The passes that a frame executes, in order.

    Attributes:
        passes: those that run, in their order.
        textures: those that they draw to.
        dropped: declared passes that don't run.
    """

    passes: tuple[FramePass[F], ...]
    textures: tuple[SharedTexture, ...]
    dropped: tuple[DroppedPass, ...]

    def count_bytes(self, size: tuple[int, int]) -> int:
        """Bytes of all textures for a frame of `size`."""
        return sum(texture.count_bytes(size) for texture in self.textures)


def fit_size(size: tuple[int, int], scale: float) -> tuple[int, int]:
    """Return (width, height) times `scale`, rounded up."""
    if scale == 1.0:
        return size
    width, height = (max(1, -int(-side * scale // 1)) for side in size)
    return width, height


def resource_names(resources: Iterable[Target | str]) -> list[str]:
    """Names of resources, in textures or not."""
    return [resource if isinstance(resource, str) else resource.name for resource in resources]


def last_version(passes: Iterable[FramePass[F]], name: str) -> str:
    """Name of the resource `name` after all of these passes that draw over it."""
    changes = {old: new for frame_pass in passes for old, new in frame_pass.changes.items()}
    while name in changes:
        name = changes[name]
    return name


def make_plan(passes: Sequence[FramePass[F]], outputs: Iterable[str] = OUTPUTS) -> Plan[F]:
    """Plan a frame with these passes, whose `outputs` are read after it.

    Raises:
        ValidationError: resources that two passes write (`plan-two-writers`), that two draw over
            (`plan-drawn-over-twice`) or that none writes (`plan-unwritten`); passes that wait for each other
            (`plan-cycle`).
    """
    graph = _PassGraph(passes)
    outputs = tuple(outputs)
    needed = graph.collect_required(outputs)
    order = graph.sort(needed)
    dropped = tuple(
        DroppedPass(frame_pass.name, f"nothing reads {_join(_written_names(frame_pass))}")
        for number, frame_pass in enumerate(passes)
        if number not in needed
    )
    return Plan(tuple(passes[i] for i in order), graph.assign_textures(order, outputs), dropped)


class _PassGraph(Generic[F]):
    """The passes that write, read and draw over each resource of a technique."""

    def __init__(self, passes: Sequence[FramePass[F]]) -> None:
        self._passes = passes
        self._writers: dict[str, int] = {}
        self._targets: dict[str, Target] = {}  # by the name of a resource written from scratch
        self._origins: dict[str, str] = {}  # by the name of a result: the resource that was drawn over
        self._results: dict[str, str] = {}  # the reverse
        for number, frame_pass in enumerate(passes):
            for name in resource_names(frame_pass.writes):
                self._add_writer(name, number)
            self._targets.update(
                (target.name, target) for target in frame_pass.writes if isinstance(target, Target)
            )
            for old, new in frame_pass.changes.items():
                self._add_writer(new, number)
                if old in self._results:
                    refuse(
                        rules.DRAWN_OVER_TWICE,
                        "make_plan",
                        f"{old!r}, for {self._results[old]!r} and {new!r}",
                    )
                self._results[old] = new
                self._origins[new] = old

    def _add_writer(self, name: str, number: int) -> None:
        first = self._writers.setdefault(name, number)
        if first != number:
            names = f"{self._passes[first].name!r} and {self._passes[number].name!r}"
            refuse(rules.TWO_WRITERS, "make_plan", f"{name!r}, written by {names}")

    def find_writer(self, name: str, reader: str) -> int:
        """The number of the pass that writes `name`; refuses a name that none writes."""
        writer = self._writers.get(name)
        if writer is None:
            refuse(rules.UNWRITTEN, "make_plan", f"{name!r}, read by {reader}", ", ".join(self._writers))
        return writer

    def collect_required(self, outputs: Iterable[str]) -> set[int]:
        """Numbers of the passes that the outputs need."""
        needed: set[int] = set()
        waiting = [self.find_writer(self._last_version(name), "the frame's outputs") for name in outputs]
        waiting += [number for number, frame_pass in enumerate(self._passes) if frame_pass.has_side_effects]
        while waiting:
            number = waiting.pop()
            if number in needed:
                continue
            needed.add(number)
            frame_pass = self._passes[number]
            waiting += [
                self.find_writer(name, f"the pass {frame_pass.name!r}")
                for name in (*frame_pass.reads, *frame_pass.changes, *frame_pass.reads_previous)
            ]
        return needed

    def sort(self, needed: set[int]) -> list[int]:
        """The required passes in the order in which they run."""
        readers: dict[str, list[int]] = {}
        for number in needed:
            for name in self._passes[number].reads:
                readers.setdefault(name, []).append(number)
        before: dict[int, set[int]] = {}
        for number in needed:
            frame_pass = self._passes[number]
            earlier = {self._writers[name] for name in frame_pass.reads}
            for name in frame_pass.changes:
                earlier.add(self._writers[name])
                earlier.update(other for other in readers.get(name, ()) if other != number)
            before[number] = earlier
        order: list[int] = []
        waiting = sorted(needed)
        while waiting:
            for number in waiting:
                if before[number].issubset(order):
                    break
            else:
                self._refuse_circle(waiting, before)
            order.append(number)
            waiting.remove(number)
        return order

    def _refuse_circle(self, waiting: list[int], before: dict[int, set[int]]) -> None:
        """Refuse passes that wait for each other, naming one circle of them."""
        number, circle = waiting[0], []
        while number not in circle:
            circle.append(number)
            number = min(before[number].intersection(waiting))
        names = [repr(self._passes[i].name) for i in (*circle[circle.index(number) :], number)]
        refuse(rules.PLAN_CYCLE, "make_plan", " waits for ".join(names))

    def assign_textures(self, order: list[int], outputs: tuple[str, ...]) -> tuple[SharedTexture, ...]:
        """Assign each required resource a texture; resources whose lifetimes don't overlap share one."""
        lives: dict[str, list[int]] = {}  # by the name of a resource written from scratch: first and last use
        names: dict[str, list[str]] = {}
        has_history: set[str] = set()
        for at, number in enumerate(order):
            frame_pass = self._passes[number]
            for name in resource_names(frame_pass.writes):
                lives[name] = [at, at]
                names[name] = [name]
            for new in frame_pass.changes.values():
                names[self._original_resource(new)].append(new)
            for name in (*frame_pass.reads, *frame_pass.changes):
                lives[self._original_resource(name)][1] = at
            has_history.update(map(self._original_resource, frame_pass.reads_previous))
        for name in outputs:
            lives[self._original_resource(name)][1] = len(order)
        textures: list[tuple[tuple[Format, float, int], bool, list[str]]] = []
        ends: list[int] = []
        for root, (begin, end) in lives.items():
            target = self._targets.get(root)
            if target is None:
                continue
            kind, is_kept = (target.format, target.scale, target.samples), root in has_history
            for i, (other, other_kept, held_names) in enumerate(textures):
                if other == kind and not is_kept and not other_kept and ends[i] < begin:
                    held_names += names[root]
                    ends[i] = end
                    break
            else:
                textures.append((kind, is_kept, names[root]))
                ends.append(end)
        return tuple(
            SharedTexture(*kind, tuple(held_names), is_kept) for kind, is_kept, held_names in textures
        )

    def _last_version(self, name: str) -> str:
        """Name of the last version of the resource `name`."""
        while name in self._results:
            name = self._results[name]
        return name

    def _original_resource(self, name: str) -> str:
        """Name of the resource that was written from scratch, of which `name` is a version."""
        while name in self._origins:
            name = self._origins[name]
        return name


def _written_names(frame_pass: FramePass[F]) -> list[str]:
    return [*resource_names(frame_pass.writes), *frame_pass.changes.values()]


def _join(names: Sequence[str]) -> str:
    return ", ".join(names) if names else "anything of it"
