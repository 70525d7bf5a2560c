"""Defaults, limits and scopes are on each backend as docs/states.md says."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import rhi
from rhi import (
    AlphaFunction,
    AlphaReference,
    AlphaTest,
    AlphaToCoverage,
    BlendColor,
    BlendFactor,
    BlendFunction,
    ColorWrite,
    CullMode,
    DepthBias,
    DepthFunction,
    DepthTest,
    DepthWrite,
    Device,
    Format,
    FrontFace,
    LineWidth,
    PolygonMode,
    PolygonOffset,
    Scissor,
    StencilBack,
    StencilFront,
    StencilReadMask,
    StencilReference,
    StencilTest,
    StencilWriteMask,
    Viewport,
)
from rhi.conformance.shaders import Colored
from rhi.conformance.shapes import rectangle
from rhi.contract.states import DEFAULTS, Comparison, StencilOperation

PAGE = Path(__file__).parents[3] / "docs" / "states.md"
ON_THE_PAGE: dict[str, tuple[Any, ...]] = {
    "BACK": (CullMode.BACK,),
    "COUNTER_CLOCKWISE": (FrontFace.COUNTER_CLOCKWISE,),
    "GREATER (reversed depth: near is 1)": (DepthFunction.GREATER,),
    "0, 0, 0, 0": (BlendColor(0, 0, 0, 0),),
    "ALWAYS, KEEP": tuple(
        face(Comparison.ALWAYS, *[StencilOperation.KEEP] * 3) for face in (StencilFront, StencilBack)
    ),
    "0, 255, 255": (StencilReference(0, 0), StencilReadMask(255, 255), StencilWriteMask(255, 255)),
    "TARGET: the whole target": (Viewport.TARGET,),
    "0": (DepthBias(0),),
    "0, 0": (PolygonOffset(0, 0),),
    "OFF, GREATER, 0.5": (AlphaTest.OFF, AlphaFunction.GREATER, AlphaReference(0.5)),
    "1": (LineWidth(1),),
    "FILL": (PolygonMode.FILL,),
}
"""The states that each text of the last column means; ON and OFF are the members of that name."""

LIMITS: list[tuple[str, Callable[[], Any], Callable[[], Any]]] = [
    (
        "x, y (from the top) within ±32,767",
        lambda: Viewport(32767, 0, 4, 4),
        lambda: Viewport(32768, 0, 4, 4),
    ),
    (
        "x, y (from the top) within ±32,767",
        lambda: Viewport(0, -32767, 4, 4),
        lambda: Viewport(0, -32768, 4, 4),
    ),
    ("width and height up to 16,384", lambda: Viewport(0, 0, 16384, 4), lambda: Viewport(0, 0, 16385, 4)),
    ("width and height up to 16,384", lambda: Viewport(0, 0, 4, 16384), lambda: Viewport(0, 0, 4, 16384.5)),
    ("within ±2³⁰", lambda: Scissor(1 << 30, 0, 4, 4), lambda: Scissor((1 << 30) + 1, 0, 4, 4)),
    ("within ±2³⁰", lambda: Scissor(0, -(1 << 30), 4, 4), lambda: Scissor(0, -(1 << 30) - 1, 4, 4)),
    ("width, height up to 2³⁰", lambda: Scissor(0, 0, 1 << 30, 4), lambda: Scissor(0, 0, (1 << 30) + 1, 4)),
    ("width, height up to 2³⁰", lambda: Scissor(0, 0, 4, 1 << 30), lambda: Scissor(0, 0, 4, (1 << 30) + 1)),
    ("whole numbers", lambda: Scissor(0, 0, 4, 4), lambda: Scissor(0, 0.5, 4, 4)),  # type: ignore[arg-type]
    ("0…255", lambda: StencilReference(255, 255), lambda: StencilReference(0, 256)),
    ("0…255", lambda: StencilReadMask(0, 0), lambda: StencilReadMask(-1, 0)),
    ("0…255", lambda: StencilWriteMask(255, 255), lambda: StencilWriteMask(256, 255)),
    ("texels, 1 to", lambda: LineWidth(1), lambda: LineWidth(0.999)),
]
"""A text of the table, a value at the end of the range that it names, and one beyond."""

CHANGES: list[tuple[Any, ...]] = [
    (CullMode.FRONT,),
    (FrontFace.CLOCKWISE,),
    (DepthFunction.NEVER,),
    (DepthTest.OFF, DepthBias(1e6)),
    (DepthWrite.OFF,),
    (ColorWrite.OFF,),
    (ColorWrite(True, False, False, False).at(0),),
    (BlendFunction(BlendFactor.CONSTANT, BlendFactor.ONE), BlendColor(0.5, 0.25, 0.125, 1.0)),
    (BlendFunction.MULTIPLY.at(0),),
    (
        StencilTest.ON,
        StencilFront(Comparison.NEVER),
        StencilBack(Comparison.NEVER),
        StencilReference(3, 3),
        StencilReadMask(15, 15),
        StencilWriteMask(15, 15),
    ),
    (Viewport(0, 0, 3, 3, 0.25, 0.5),),
    (Scissor(0, 0, 0, 0),),
    (PolygonOffset(1.0),),
    (AlphaToCoverage.ON,),
    (AlphaTest.ON, AlphaFunction.NEVER, AlphaReference(1.0)),
    (PolygonMode.LINE,),
    (CullMode.NONE,),
]
"""States beside their defaults; most change the drawn image."""


@pytest.fixture(scope="module", params=["gl", "cl", "wgpu", "null"])
def any_device(request: pytest.FixtureRequest) -> Iterator[Device]:
    try:
        device = rhi.create_device(request.param)
    except rhi.DeviceError as error:
        pytest.skip(f"{request.param}: {error.given}")
    with device:
        yield device


def read_rows() -> list[tuple[list[type], str, str]]:
    """Return the rows of the table of all states: types, values, defaults."""
    table = PAGE.read_text(encoding="utf-8").partition("| type | values | default |")[2].partition("\n\n")[0]
    cells = [line.strip("| ").split(" | ") for line in table.splitlines()[2:]]
    return [
        ([getattr(rhi, name) for name in re.findall("`(\\w+)`", types)], values, default)
        for types, values, default in cells
    ]


class Draws:
    """A target of color, depth and stencil, and what a draw leaves in it."""

    def __init__(self, device: Device) -> None:
        self._device, self._mesh = device, device.mesh(rectangle())
        self._program = device.program(Colored)
        self._color = device.texture((8, 8), Format.RGBA8)
        self._depth = device.texture((8, 8), Format.D32F)

    def draw(self, *states: Any) -> tuple[Any, Any]:
        """Return color and depth that a draw in these states leaves in a cleared target."""
        with self._device.render_pass(self._color, self._depth, clear=(0.5, 0.5, 0.5, 0.5), clear_depth=0.0):
            with self._device.states(*states):
                self._device.draw(self._program, self._mesh)
        return self._color.read(), self._depth.read()


def assert_same_images(images: tuple[Any, Any], others: tuple[Any, Any]) -> None:
    for image, other in zip(images, others, strict=True):
        np.testing.assert_array_equal(image, other)


def can(device: Device, states: tuple[Any, ...]) -> bool:
    """True if the device has the capabilities of these states."""
    try:
        with device.states(*states):
            return True
    except rhi.ValidationError as error:
        if error.rule.id not in ("state-capability", "device-capability"):
            raise
        return False


def test_the_page_lists_each_state_with_its_default() -> None:
    listed: dict[type, Any] = {}
    for types, _, text in read_rows():
        same = [getattr(kind, text, None) for kind in types]
        listed |= dict(zip(types, ON_THE_PAGE.get(text) or same, strict=True))
    assert listed == DEFAULTS


@pytest.mark.parametrize(("text", "good", "bad"), LIMITS)
def test_numbers_are_refused_beyond_the_limits_of_the_page(
    any_device: Device, text: str, good: Callable[[], Any], bad: Callable[[], Any]
) -> None:
    assert any(text in values and type(good()) in types for types, values, _ in read_rows())
    draws = Draws(any_device)
    before = draws.draw()
    if can(any_device, (good(),)):
        draws.draw(good())
    with pytest.raises(rhi.ValidationError) as error:
        bad()
    assert error.value.rule.id in ("state-value", "device-argument")
    assert_same_images(draws.draw(), before)


def test_scopes_of_all_defaults_send_nothing_and_change_nothing(any_device: Device) -> None:
    draws = Draws(any_device)
    before = draws.draw()
    any_device.reset_statistics()
    assert_same_images(draws.draw(*DEFAULTS.values()), before)
    assert any_device.statistics.hardware_state_changes == 0


@pytest.mark.parametrize("states", CHANGES, ids=lambda states: states[0].__class__.__name__)
def test_an_exception_in_scopes_inside_each_other_leaves_the_defaults(
    any_device: Device, states: tuple[Any, ...]
) -> None:
    if not can(any_device, states):
        pytest.skip("the device lacks a state")
    draws = Draws(any_device)
    before = draws.draw()
    with pytest.raises(ZeroDivisionError), any_device.states(CullMode.NONE):
        with any_device.states(*states):
            draws.draw()
            raise ZeroDivisionError
    any_device.reset_statistics()
    assert_same_images(draws.draw(), before)
    if states != (CullMode.NONE,):
        assert any_device.statistics.hardware_state_changes > 0


def test_most_of_the_tried_states_change_the_image(any_device: Device) -> None:
    """Otherwise the test above would pass on a device that restores nothing."""
    if any_device.capabilities.backend == "null":
        pytest.skip("nothing is rasterised")
    draws = Draws(any_device)
    before = draws.draw()
    changing = 0
    for states in CHANGES:
        if can(any_device, states):
            color, depth = draws.draw(*states)
            changing += bool((color != before[0]).any() or (depth != before[1]).any())
    assert changing >= 8


def test_a_scope_refuses_two_values_of_one_state(any_device: Device) -> None:
    with any_device.states(CullMode.NONE, ColorWrite.OFF.at(0), ColorWrite.OFF.at(1)):
        pass
    for twice in ((CullMode.NONE, CullMode.BACK), (ColorWrite.OFF.at(1), ColorWrite.ON.at(1))):
        with pytest.raises(rhi.ValidationError) as error:
            any_device.states(*twice).__enter__()
        assert error.value.rule.id == "state-duplicate"
    assert_same_images(Draws(any_device).draw(), Draws(any_device).draw(CullMode.BACK))


@pytest.mark.parametrize("backend", ["gl", "cl", "wgpu", "null"])
def test_a_quiet_close_inside_a_scope_raises_nothing(backend: str) -> None:
    for quiet in (True, False):
        try:
            device = rhi.create_device(backend)
        except rhi.DeviceError as error:
            pytest.skip(f"{backend}: {error.given}")
        with device.states(CullMode.NONE), device.event("open"):
            if quiet:
                device.close(quiet=True)
            else:
                with pytest.raises(rhi.ValidationError, match="scope-open"):
                    device.close()
        assert device.closed
