"""Backends with one fault each, and a run of the kit against all of them.

`python faulty_backends.py` prints a line of JSON: for each fault the tests of its group that failed, up to
the first.
"""

from __future__ import annotations

import contextlib
import dataclasses
import json
import os
from collections.abc import Callable, Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import rhi
import rhi.conformance
from rhi.device import registry

KIT = Path(rhi.conformance.__file__).parent


class Faulty:
    """A backend that does all as `inner` does, by its contract alone: it prepares no draws."""

    def __init__(self, inner: Any) -> None:
        self._inner = inner

    def __getattr__(self, name: str) -> Any:
        if name.startswith("prepare_"):
            raise AttributeError(name)
        return getattr(self._inner, name)


class Preparing(Faulty):
    """The same, with prepared draws."""

    def __getattr__(self, name: str) -> Any:
        return getattr(self._inner, name)


class Late(Faulty):
    """A backend that is seen to reach a fence value only by who waits for it, or asks often: a quick device
    reaches one before anybody can notice who waits for it and who doesn't."""

    POLLS = 8

    def __init__(self, inner: Any) -> None:
        super().__init__(inner)
        self._seen = self._asked = 0

    def completed(self) -> int:
        reached: int = self._inner.completed()
        self._asked = self._asked + 1 if reached > self._seen else 0
        if self._asked > self.POLLS:
            self._seen = reached
        return self._seen

    def wait(self, value: int, seconds: float) -> bool:
        reached: bool = self._inner.wait(value, seconds)
        if reached:
            self._seen = max(self._seen, value)
        return reached


class PreparedFromTheFirst(Preparing):
    def prepare_draw(self, program: int, array: int, primitive: Any, first: int, *rest: Any) -> Any:
        return self._inner.prepare_draw(program, array, primitive, 0, *rest)


class PreparedOnce(Preparing):
    def prepare_draw(self, *a: Any) -> Any:
        draw = self._inner.prepare_draw(*a)
        return lambda instances: draw(1)


class PreparedAtZero(Preparing):
    def prepare_uniform(self, buffer: int) -> Any:
        bind = self._inner.prepare_uniform(buffer)
        return lambda slot, offset, size: bind(slot, 0, size)


class OneRowForAll(Preparing):
    """Counts all draws of a query set together."""

    def prepare_queries(self, queries: Any) -> Any:
        prepared = self._inner.prepare_queries(queries)

        def draw(array: int, primitive: Any, draws: Any, rows: Any) -> None:
            prepared.draw(array, primitive, draws, rows * 0)

        return SimpleNamespace(draw=draw, read=lambda rows: prepared.read(rows * 0))


class RowsInOrder(Preparing):
    """Answers in the order of a query set's rows, not in that of the draws."""

    def prepare_queries(self, queries: Any) -> Any:
        prepared = self._inner.prepare_queries(queries)
        return SimpleNamespace(draw=prepared.draw, read=lambda rows: prepared.read(np.sort(rows)))


class OneConditionForAll(Preparing):
    """Decides about all draws by the same row of a query set."""

    def prepare_queries(self, queries: Any) -> Any:
        prepared = self._inner.prepare_queries(queries)

        def draw_conditional(array: int, primitive: Any, buffer: int, offset: int, rows: Any) -> None:
            prepared.draw_conditional(array, primitive, buffer, offset, rows * 0 + rows[0])

        return SimpleNamespace(draw=prepared.draw, read=prepared.read, draw_conditional=draw_conditional)


class UpsideDown(Faulty):
    def read_texture(self, *a: Any) -> Any:
        return self._inner.read_texture(*a)[:, ::-1].copy()


class NoFirst(Faulty):
    def draw(self, array: int, primitive: Any, first: int, *rest: Any) -> None:
        self._inner.draw(array, primitive, 0, *rest)


class NoBaseInstance(Faulty):
    def draw(self, *a: Any) -> None:
        self._inner.draw(*a[:-1], 0)


class NoCount(Faulty):
    def draw_indirect(self, *a: Any) -> None:
        self._inner.draw_indirect(*a[:-2], 0, 0)


class NoUniformOffset(Faulty):
    def bind_uniform(self, slot: int, buffer: int, offset: int, size: int) -> None:
        self._inner.bind_uniform(slot, buffer, 0, size)


class NoMipmaps(Faulty):
    def generate_mipmaps(self, texture: int) -> None:
        pass


class CopyToCorner(Faulty):
    def copy_texture(
        self, source: int, level: int, region: Any, target: int, to: int, x: int, y: int, layer: int
    ) -> None:
        self._inner.copy_texture(source, level, region, target, to, 0, 0, layer)


class ShortWrite(Faulty):
    def write_buffer(self, buffer: int, offset: int, data: Any) -> None:
        self._inner.write_buffer(buffer, offset, bytes(data)[:-1] if len(data) > 4096 else data)


class EarlyFence(Faulty):
    def completed(self) -> int:
        return 1 << 40


class ZeroForUnfinished(Faulty):
    def read_query(self, query: int) -> int:
        return 0


class WaitingPoll(Late):
    def read_query(self, query: int) -> Any:
        while (answer := self._inner.read_query(query)) is None:
            pass
        return answer


class NoStencilClear(Faulty):
    def begin_pass(self, descriptor: Any) -> None:
        if descriptor.depth is not None:
            depth = dataclasses.replace(descriptor.depth, clear_stencil=None)
            descriptor = dataclasses.replace(descriptor, depth=depth)
        self._inner.begin_pass(descriptor)


class Deaf(Faulty):
    """Doesn't hear of one state."""

    state: type

    def set_states(self, changes: Any) -> None:
        self._inner.set_states(tuple(change for change in changes if change.type is not self.state))


class OneBlendForAll(Faulty):
    def set_states(self, changes: Any) -> None:
        self._inner.set_states(
            tuple(
                change._replace(value=(change.value[0],) * 8) if change.type is rhi.BlendFunction else change
                for change in changes
            )
        )


CONTROL = "no fault"
FAULTS: dict[str, tuple[Callable[[Any], Any], str]] = {
    "upside down": (UpsideDown, "orientation"),
    "no first": (NoFirst, "meshes"),
    "no base instance": (NoBaseInstance, "meshes"),
    "no count": (NoCount, "meshes"),
    "no uniform offset": (NoUniformOffset, "transient"),
    "prepared from the first": (PreparedFromTheFirst, "meshes"),
    "prepared once": (PreparedOnce, "meshes"),
    "prepared at zero": (PreparedAtZero, "transient"),
    "one row for all": (OneRowForAll, "query_sets"),
    "rows in order": (RowsInOrder, "query_sets"),
    "one condition for all": (OneConditionForAll, "conditional_draws"),
    "no mipmaps": (NoMipmaps, "textures"),
    "copy to corner": (CopyToCorner, "textures"),
    "short write": (ShortWrite, "buffers"),
    "early fence": (EarlyFence, "time"),
    "zero for unfinished": (ZeroForUnfinished, "queries"),
    "waiting poll": (WaitingPoll, "queries"),
    "no stencil clear": (NoStencilClear, "textures"),
    "one blend for all": (OneBlendForAll, "targets"),
}
STATES = {
    "rasterisation": (rhi.CullMode, rhi.FrontFace, rhi.Scissor, rhi.Viewport),
    "depth": (rhi.DepthTest, rhi.DepthWrite, rhi.DepthFunction, rhi.DepthBias, rhi.PolygonOffset),
    "blending": (rhi.ColorWrite, rhi.BlendFunction, rhi.BlendColor),
    "stencil": (
        rhi.StencilTest,
        rhi.StencilFront,
        rhi.StencilBack,
        rhi.StencilReference,
        rhi.StencilReadMask,
        rhi.StencilWriteMask,
    ),
    "targets": (rhi.AlphaToCoverage,),
    "lines": (rhi.LineWidth, rhi.PolygonMode),
}
"""Which states each group must see, if they are not heard of."""
FAULTS |= {
    f"deaf to {state.__name__}": (type("Deaf", (Deaf,), {"state": state}), group)
    for group, states in STATES.items()
    for state in states
}


class Failures:
    """A pytest plugin that notes the tests that fail."""

    def __init__(self) -> None:
        self.failed: list[str] = []

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        if report.failed:
            self.failed.append(report.nodeid)


@contextlib.contextmanager
def replace_gl(fault: Callable[[Any], Any]) -> Iterator[None]:
    """Replace gl by gl with a fault, and remove all other backends but null."""
    list_entry_points = registry._entry_points
    real = list_entry_points()["gl"].load()
    point = SimpleNamespace(load=lambda: lambda *, validation: fault(real(validation=validation)))
    registry._entry_points = lambda: {"gl": point, "null": list_entry_points()["null"]}  # type: ignore[assignment, dict-item, return-value]
    try:
        yield
    finally:
        registry._entry_points = list_entry_points


def list_failures(fault: Callable[[Any], Any], *groups: str) -> list[str]:
    """Run groups of the kit against gl with a fault, up to the first test that fails."""
    failures = Failures()
    options = ["-q", "-x", "-p", "no:cacheprovider", "-p", "rhi.conformance.plugin", "-c", os.devnull]
    files = [str(KIT / "operation" / f"test_{group}.py") for group in groups]
    with (
        replace_gl(fault),
        open(os.devnull, "w", encoding="utf-8") as nowhere,
        contextlib.redirect_stdout(nowhere),
    ):
        status = pytest.main([*options, "--rootdir", str(KIT), "--rhi-backend", "gl", *files], [failures])
    if status not in (pytest.ExitCode.OK, pytest.ExitCode.TESTS_FAILED):
        raise RuntimeError(f"the kit did not run: {status!r}")
    return failures.failed


if __name__ == "__main__":
    failures = {name: list_failures(*fault) for name, fault in FAULTS.items()}
    failures[CONTROL] = list_failures(Faulty, *sorted({group for _, group in FAULTS.values()}))
    print(json.dumps(failures))
