"""Machine code made by threads while draws gather: the same pictures, nobody waits, nothing is lost."""

from __future__ import annotations

import logging
import threading
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numpy as np
import pyopencl as cl
import pytest
from numpy.typing import NDArray

import rhi
from rhi import BlendFunction, CullMode, Device, Format, Program
from rhi.backends.cl.raster import builds
from rhi.conformance.shaders import Colored, DepthFromColor
from rhi.conformance.shapes import corners, rectangle
from rhi.contract.descriptors import ProgramDescriptor, Stage, StageText
from rhi.errors import ShaderError

SIZE = (130, 70)


def draw(
    device: Device, program: Program[Any], color: tuple[float, ...] = (0.2, 0.4, 0.6, 1.0)
) -> rhi.Texture:
    """A picture of many small triangles and a rectangle, whose draws go through all kernels."""
    image = device.texture(SIZE, Format.RGBA8)
    depth = device.texture(SIZE, Format.D32F)
    rng = np.random.default_rng(0)
    places = np.zeros((1500, 4))
    places[:, :2] = np.repeat(rng.uniform(-1, 1, (500, 2)), 3, axis=0) + rng.uniform(-0.1, 0.1, (1500, 2))
    places[:, 2:] = 0.5, 1.0
    with (
        device.render_pass(image, depth, clear=(0, 0, 0, 0), clear_depth=0.0),
        device.states(CullMode.NONE, BlendFunction.ALPHA),
    ):
        device.draw(program, device.mesh(rectangle(depth=0.25, color=color)))
        device.draw(program, device.mesh(corners(places, color)))
    return image


@pytest.fixture
def expected() -> NDArray[Any]:
    with rhi.create_device("cl") as device:
        return draw(device, device.program(Colored)).read()


@pytest.fixture
def cold(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let each text count as one that wasn't on disk."""
    monkeypatch.setattr(builds, "_COLD", -1.0)


@pytest.mark.usefixtures("cold")
def test_a_first_run_draws_the_same_and_tells_how_far_it_is(
    expected: NDArray[Any], caplog: pytest.LogCaptureFixture
) -> None:
    with caplog.at_level(logging.INFO, "rhi.kernels"), rhi.create_device("cl") as device:
        np.testing.assert_array_equal(draw(device, device.program(Colored)).read(), expected)
        draw(device, device.program(DepthFromColor)).read()
    told = [record.args for record in caplog.records]
    assert told[0] == (0, 3)
    assert (9, 9) in told
    assert all(done <= begun for done, begun in told)  # type: ignore[misc,operator,union-attr]


def test_from_the_disk_nothing_is_told(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture, expected: NDArray[Any]
) -> None:
    monkeypatch.setattr(builds, "_COLD", 1e9)
    with caplog.at_level(logging.INFO, "rhi.kernels"), rhi.create_device("cl") as device:
        np.testing.assert_array_equal(draw(device, device.program(Colored)).read(), expected)
    assert not caplog.records


@pytest.mark.usefixtures("cold")
def test_only_the_device_waits_for_machine_code(
    monkeypatch: pytest.MonkeyPatch, expected: NDArray[Any]
) -> None:
    go_on = threading.Event()
    real = builds.build_again

    def wait(*given: Any) -> cl.Program:
        go_on.wait()
        return real(*given)

    monkeypatch.setattr(builds, "build_again", wait)
    with rhi.create_device("cl") as device:
        try:
            image = draw(device, device.program(Colored))
            other = draw(device, device.program(DepthFromColor))
            value = device.signal()
            assert device.completed < value
            assert not device.wait(value, 0.01)
        finally:
            go_on.set()
        np.testing.assert_array_equal(image.read(), expected)
        assert other.read().any()
        assert device.wait(value, 60.0)


@pytest.mark.usefixtures("cold")
@pytest.mark.parametrize("error", [cl.LogicError("no"), MemoryError()])
def test_what_a_thread_fails_to_do_the_device_does(
    monkeypatch: pytest.MonkeyPatch, expected: NDArray[Any], error: Exception
) -> None:
    def fail(*given: Any) -> cl.Program:
        raise error

    monkeypatch.setattr(builds, "build_again", fail)
    with rhi.create_device("cl") as device:
        np.testing.assert_array_equal(draw(device, device.program(Colored)).read(), expected)


@pytest.mark.usefixtures("cold")
def test_without_threads_the_device_makes_machine_code(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture, expected: NDArray[Any]
) -> None:
    def refuse(*given: Any) -> None:
        raise RuntimeError("can't start new thread")

    monkeypatch.setattr(ThreadPoolExecutor, "submit", refuse)
    with caplog.at_level(logging.INFO, "rhi.kernels"), rhi.create_device("cl") as device:
        np.testing.assert_array_equal(draw(device, device.program(Colored)).read(), expected)
    assert caplog.records[-1].args == (6, 6)


@pytest.mark.usefixtures("cold")
@pytest.mark.parametrize("stage", [Stage.VERTEX, Stage.FRAGMENT])
def test_a_text_that_the_driver_refuses_is_told_of_by_the_draw_that_needs_it(
    expected: NDArray[Any], stage: Stage
) -> None:
    with rhi.create_device("cl") as device:
        good = device.program(Colored)
        descriptor = good.descriptor

        def emit(language: str, wanted: Stage) -> StageText:
            emitted = descriptor.emit(language, wanted)
            if wanted is not stage:
                return emitted
            text = "int undeclared(void) {\n    return nothing;\n}\n" + emitted.text
            return StageText(text, tuple(("bad.py", line) for line in (10, 20, 30)))

        bad = device.program(ProgramDescriptor(
            "Bad", descriptor.stages, descriptor.bindings, descriptor.attributes, descriptor.outputs,
            descriptor.work_group, emit, varyings=descriptor.varyings,
        ))  # fmt: skip
        image = device.texture(SIZE, Format.RGBA8)
        mesh = device.mesh(rectangle())
        with device.render_pass(image, clear=(0, 1, 0, 1)):
            with pytest.raises(ShaderError, match="nothing") as caught:
                device.draw(bad, mesh)
            device.draw(good, mesh)
        assert caught.value.rule.id == "shader-driver"
        assert f"its {stage.value} stage" in caught.value.call
        assert str(caught.value.site) == "bad.py:20"
        assert image.read().min() == 255  # the good draw
        np.testing.assert_array_equal(draw(device, good).read(), expected)
