"""The plan of a frame: which passes run, in which order, and which textures they draw to.

A technique declares its passes with the *contents* that each of them reads and writes. Contents have names, such as
`depth`, and every name is written by one pass. A pass that draws over contents gives the result a new name, so what a
name means never depends on an order. From this `make_plan` finds everything else:

- **order**: contents are written before they are read, and read before they are drawn over. Passes that don't depend on
  each other keep the order of their declaration. A circle is refused by the names of its passes.
- **what runs**: the frame's outputs are needed as the last pass that draws over them leaves them, and so is what a
  needed pass reads. A pass with side effects is needed, and so are its inputs. Contents that a needed pass reads from
  the last frame are needed, too. The rest is dropped.
- **memory**: contents of the same format, size and samples share a texture unless both are needed at the same time.

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
"""The contents that every frame has: its image, and the depth that layers and tools read."""


@dataclass(frozen=True, slots=True)
class Target:
    """Contents that a pass writes from scratch, and the texture that holds them.

    Attributes:
        name: the name of the contents.
        scale: width and height in those of the frame, rounded up.
        samples: samples per pixel.
    """

    name: str
    format: Format
    scale: float = 1.0
    samples: int = 1

    def fit(self, size: tuple[int, int]) -> tuple[int, int]:
        """Return the texture's (width, height) in pixels for a frame of `size`."""
        return fit_size(size, self.scale)


@dataclass(frozen=True, slots=True)
class Pass(Generic[F]):
    """A step of a frame: render passes, compute work, or both.

    Attributes:
        run: issues the commands.
        because: why the pass is in the frame, such as the effect that calls for it; part of a sentence.
        reads: names of contents that are read.
        writes: contents that are written from scratch; a name alone is for those in a buffer that a technique keeps.
        changes: names of contents that are drawn over, each with the name of the result.
        reads_last: names of contents that are read as the last frame left them.
        has_side_effects: whether something besides the contents depends on the pass, so that it is never dropped.
    """

    name: str
    run: Callable[[F], None]
    because: str
    reads: tuple[str, ...] = ()
    writes: tuple[Target | str, ...] = ()
    changes: Mapping[str, str] = field(default_factory=dict)
    reads_last: tuple[str, ...] = ()
    has_side_effects: bool = False


@dataclass(frozen=True, slots=True)
class SharedTexture:
    """A texture of a plan, and the names of all contents that it holds in turn.

    A `kept` one has a second texture with the contents of the last frame: the two are exchanged after each frame.
    """

    format: Format
    scale: float
    samples: int
    names: tuple[str, ...]
    kept: bool = False

    def count_bytes(self, size: tuple[int, int]) -> int:
        """Return the texture's bytes for a frame of `size`."""
        width, height = fit_size(size, self.scale)
        return width * height * self.samples * self.format.texel_bytes * (2 if self.kept else 1)


@dataclass(frozen=True, slots=True)
class DroppedPass:
    """A declared pass that doesn't run, and why."""

    name: str
    because: str


@dataclass(frozen=True, slots=True)
class Plan(Generic[F]):
    """The passes that a frame executes, in order.

    Attributes:
        passes: those that run, in their order.
        textures: those that they draw to. dropped: declared passes that don't run.
    """

    passes: tuple[Pass[F], ...]
    textures: tuple[SharedTexture, ...]
    dropped: tuple[DroppedPass, ...]

    def count_bytes(self, size: tuple[int, int]) -> int:
        """Return the bytes of all textures for a frame of `size`."""
        return sum(texture.count_bytes(size) for texture in self.textures)


def fit_size(size: tuple[int, int], scale: float) -> tuple[int, int]:
    """Return (width, height) times `scale`, rounded up."""
    if scale == 1.0:
        return size
    width, height = (max(1, -int(-side * scale // 1)) for side in size)
    return width, height


def list_names(contents: Iterable[Target | str]) -> list[str]:
    """Return the names of contents, whether they are in a texture or not."""
    return [one if isinstance(one, str) else one.name for one in contents]


def find_last(passes: Iterable[Pass[F]], name: str) -> str:
    """Return the name of what is left of the contents `name` after all of these passes that draw over it."""
    changes = {old: new for one in passes for old, new in one.changes.items()}
    while name in changes:
        name = changes[name]
    return name


def make_plan(passes: Sequence[Pass[F]], outputs: Iterable[str] = OUTPUTS) -> Plan[F]:
    """Plan a frame with these passes, whose `outputs` are used after it.

    Raises:
        ValidationError: contents that two passes write (`plan-two-writers`), that two draw over
            (`plan-drawn-over-twice`) or that none writes (`plan-unwritten`); passes that wait for each other
            (`plan-circle`).
    """
    graph = _PassGraph(passes)
    outputs = tuple(outputs)
    needed = graph.find_needed(outputs)
    order = graph.sort(needed)
    dropped = tuple(
        DroppedPass(one.name, f"nothing reads {_join(_list_written(one))}")
        for number, one in enumerate(passes)
        if number not in needed
    )
    return Plan(tuple(passes[i] for i in order), graph.share(order, outputs), dropped)


class _PassGraph(Generic[F]):
    """A technique's passes: which of them write, read and draw over which contents."""

    def __init__(self, passes: Sequence[Pass[F]]) -> None:
        self._passes = passes
        self._writers: dict[str, int] = {}
        self._targets: dict[str, Target] = {}  # by the name of contents written from scratch
        self._origins: dict[str, str] = {}  # by the name of a result: the contents that were drawn over
        self._results: dict[str, str] = {}  # the reverse
        for number, one in enumerate(passes):
            for name in list_names(one.writes):
                self._add_writer(name, number)
            self._targets.update((target.name, target) for target in one.writes if isinstance(target, Target))
            for old, new in one.changes.items():
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
        """Return the pass that writes `name`."""
        writer = self._writers.get(name)
        if writer is None:
            refuse(rules.UNWRITTEN, "make_plan", f"{name!r}, read by {reader}", ", ".join(self._writers))
        return writer

    def find_needed(self, outputs: Iterable[str]) -> set[int]:
        """Return the passes that run."""
        needed: set[int] = set()
        waiting = [self.find_writer(self._find_result(name), "the frame's outputs") for name in outputs]
        waiting += [number for number, one in enumerate(self._passes) if one.has_side_effects]
        while waiting:
            number = waiting.pop()
            if number in needed:
                continue
            needed.add(number)
            one = self._passes[number]
            waiting += [
                self.find_writer(name, f"the pass {one.name!r}") for name in (*one.reads, *one.changes, *one.reads_last)
            ]
        return needed

    def sort(self, needed: set[int]) -> list[int]:
        """Return the passes that run in their order."""
        readers: dict[str, list[int]] = {}
        for number in needed:
            for name in self._passes[number].reads:
                readers.setdefault(name, []).append(number)
        before: dict[int, set[int]] = {}
        for number in needed:
            one = self._passes[number]
            earlier = {self._writers[name] for name in one.reads}
            for name in one.changes:
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
        """Refuse passes that wait for each other, by the names of one circle of them."""
        number, circle = waiting[0], []
        while number not in circle:
            circle.append(number)
            number = min(before[number].intersection(waiting))
        names = [repr(self._passes[i].name) for i in (*circle[circle.index(number) :], number)]
        refuse(rules.PLAN_CIRCLE, "make_plan", " waits for ".join(names))

    def share(self, order: list[int], outputs: tuple[str, ...]) -> tuple[SharedTexture, ...]:
        """Give each contents that is needed a texture; textures whose lives don't overlap are shared."""
        lives: dict[str, list[int]] = {}  # by the name of contents written from scratch: first and last use
        names: dict[str, list[str]] = {}
        kept: set[str] = set()
        for at, number in enumerate(order):
            one = self._passes[number]
            for name in list_names(one.writes):
                lives[name] = [at, at]
                names[name] = [name]
            for new in one.changes.values():
                names[self._find_root(new)].append(new)
            for name in (*one.reads, *one.changes):
                lives[self._find_root(name)][1] = at
            kept.update(map(self._find_root, one.reads_last))
        for name in outputs:
            lives[self._find_root(name)][1] = len(order)
        textures: list[tuple[tuple[Format, float, int], bool, list[str]]] = []
        ends: list[int] = []
        for root, (begin, end) in lives.items():
            target = self._targets.get(root)
            if target is None:
                continue
            kind, is_kept = (target.format, target.scale, target.samples), root in kept
            for i, (other, other_kept, held) in enumerate(textures):
                if other == kind and not is_kept and not other_kept and ends[i] < begin:
                    held += names[root]
                    ends[i] = end
                    break
            else:
                textures.append((kind, is_kept, names[root]))
                ends.append(end)
        return tuple(SharedTexture(*kind, tuple(held), is_kept) for kind, is_kept, held in textures)

    def _find_result(self, name: str) -> str:
        """Return the name of what is left after all that is drawn over the contents `name`."""
        while name in self._results:
            name = self._results[name]
        return name

    def _find_root(self, name: str) -> str:
        """Return the name of the contents that were written from scratch where `name` was drawn over them."""
        while name in self._origins:
            name = self._origins[name]
        return name


def _list_written(one: Pass[F]) -> list[str]:
    return [*list_names(one.writes), *one.changes.values()]


def _join(names: Sequence[str]) -> str:
    return ", ".join(names) if names else "anything of it"
