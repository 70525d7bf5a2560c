"""Refused calls are kept in the stream of the device that refused them, wherever the check lies."""

from __future__ import annotations

import re
from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path

import numpy as np
import pytest
from null_kit import Kit

import rhi
from rhi import CullMode
from rhi.device.core.scopes import STACK_DEPTH
from rhi.shading import Struct


class Flag(Struct):
    """A struct without a layout in memory."""

    on: bool


def open_too_many_scopes(kit: Kit) -> None:
    scope = kit.device.states(CullMode.NONE)
    with ExitStack() as stack:
        for _ in range(STACK_DEPTH + 1):
            stack.enter_context(scope)


def draw_transient_mesh_indirectly(kit: Kit) -> None:
    vertices = np.zeros(3, [("position", "<f4", (2,))])
    with kit.device.render_pass(kit.image):
        mesh = kit.device.transient.mesh(kit.program, vertices)
        with kit.device.buffer(kit.mesh.draws()) as draws:
            arguments = rhi.IndirectDraws(draws, 1)
            kit.device.draw_indirect(kit.program, mesh, arguments, **kit.bindings)  # type: ignore[arg-type]


def overflow_transient_memory(kit: Kit) -> None:
    transient = kit.device.transient
    transient._vertices.limit = 256  # type: ignore[union-attr]
    transient.mesh(kit.program, np.zeros(33, [("position", "<f4", (2,))]))


CALLS: dict[str, tuple[Callable[[Kit], object], str]] = {
    "stack of scopes full": (open_too_many_scopes, "container-full"),
    "scope that is not open": (
        lambda kit: kit.device.states(CullMode.NONE).__exit__(None, None, None),
        "scope-order",
    ),
    "fence": (lambda kit: kit.device.wait(99), "fence-value"),
    "constants without a layout": (lambda kit: kit.device.uniform(Flag(on=True)), "shading-struct"),
    "array without a layout": (lambda kit: kit.device.uniform_array(Flag, 2), "shading-struct"),
    "transient constants without a layout": (
        lambda kit: kit.device.transient.uniform(Flag(on=True)),
        "shading-struct",
    ),
    "transient memory full": (overflow_transient_memory, "transient-size"),
    "indirect draw of a transient mesh": (draw_transient_mesh_indirectly, "device-argument"),
    "not a program": (lambda kit: kit.device.draw(kit.image, kit.mesh), "device-argument"),  # type: ignore[arg-type]
    "query of another device": (
        lambda kit: kit.device.conditional(rhi.create_device("null").occlusion_query()).__enter__(),
        "resource-foreign",
    ),
}


@pytest.mark.parametrize("name", CALLS)
def test_a_refused_call_is_recorded_once(name: str, kit: Kit) -> None:
    refused, rule = CALLS[name]
    with pytest.raises(rhi.RhiError, match=rf"^\[{rule}\]"):
        refused(kit)
    assert [refusal.error for refusal in kit.device.stream.refusals] == [rule]


def test_the_front_end_refuses_through_its_device() -> None:
    """Only code that knows no device raises errors that no stream keeps."""
    package = Path(rhi.__file__).parent / "device"
    direct = re.compile(r"(?<![\w.])(?<!def )refuse\(|raise (Validation|Device|Shader)Error\(")
    paths = [path for path in package.rglob("*.py") if direct.search(path.read_text(encoding="utf-8"))]
    files = {path.relative_to(package).as_posix() for path in paths}
    assert files == {
        "registry.py",
        "reloading.py",
        "core/containers.py",
        "core/refusals.py",
        "resources/image_decoding.py",
        "resources/images.py",
    }
