"""Draws, compute, copies and queries write nothing outside of buffers."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import memory_guards
import numpy as np
import pytest
from cl_kit import FILL, ClKit, describe_program
from nightly_reasons import FEWER_CASES

import rhi
from rhi.backends.cl import create_backend
from rhi.backends.cl.raster import cl_pipelines, general_raster
from rhi.conformance.shaders import Colored, DepthFromColor
from rhi.conformance.shapes import corners
from rhi.contract.descriptors import BufferUsage


@pytest.fixture(autouse=True)
def guards(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    memory_guards.install(monkeypatch.setattr)
    yield
    assert not memory_guards.collect_writes()


@pytest.mark.parametrize("usage", BufferUsage)
@pytest.mark.parametrize("count", [32, 64, 100])
def test_a_write_behind_a_buffer_is_found(usage: BufferUsage, count: int) -> None:
    """Run the control case first: a kernel that stays within its 128 bytes."""
    kit = ClKit(create_backend())
    buffer = kit.buffer(bytes(128), usage)
    kit.backend.bind_storage(0, buffer, 0, 128)
    program = kit.program(describe_program(FILL))
    kit.dispatch(program, 32)
    kit.finish()
    assert not memory_guards.collect_writes()
    kit.dispatch(program, count)
    kit.finish()
    writes = memory_guards.collect_writes()
    assert bool(writes) == (4 * count > 128)
    if writes:
        assert f"to {4 * count - 1} of a buffer of 128" in writes[0]


def test_a_write_before_a_buffer_is_found() -> None:
    source = "__kernel void early(__global uint *words, int count) { words[-5] = 1; }"
    kit = ClKit(create_backend())
    buffer = kit.buffer(bytes(128))
    kit.backend.bind_storage(0, buffer, 0, 128)
    kit.dispatch(kit.program(describe_program(source)))
    kit.finish()
    assert memory_guards.collect_writes() == ["4 bytes from -20 to -17 of a buffer of 128"]


def test_a_write_is_found_when_its_buffer_is_gone() -> None:
    kit = ClKit(create_backend())
    buffer = kit.buffer(bytes(64))
    kit.backend.bind_storage(0, buffer, 0, 64)
    kit.dispatch(kit.program(describe_program(FILL)), 20)
    kit.finish()
    kit.backend.close()
    assert len(memory_guards.collect_writes()) == 1


PRIMITIVES = (
    rhi.Primitive.TRIANGLES,
    rhi.Primitive.TRIANGLE_STRIP,
    rhi.Primitive.LINES,
    rhi.Primitive.POINTS,
)


@pytest.mark.nightly_cases(
    "(1, 1)-*",
    "(3, 5)-*",
    "(64, 64)-*",
    "*-1-*",
    "*-LINES",
    "*-POINTS",
    "*-TRIANGLE_STRIP",
    reason=FEWER_CASES,
)
@pytest.mark.parametrize("primitive", PRIMITIVES, ids=lambda primitive: primitive.name)
@pytest.mark.parametrize("samples", [1, 4, 8])
@pytest.mark.parametrize("size", [(1, 1), (3, 5), (64, 64), (130, 70)], ids=str)
def test_draws_write_inside_their_targets(
    size: tuple[int, int], samples: int, primitive: rhi.Primitive
) -> None:
    """Triangles, lines and points of all sizes, most of them beyond the target; blending, stencil, queries,
    tables."""
    rng = np.random.default_rng(0)
    positions = rng.normal(0, 2, (600, 4))
    positions[:, 2:] = rng.uniform(-0.2, 1.2, (600, 2))
    with rhi.create_device("cl") as device:
        color = device.texture(size, rhi.Format.RGBA8, samples=samples)
        depth = device.texture(size, rhi.Format.D24S8, samples=samples)
        query = device.occlusion_query()
        mesh = device.mesh(
            corners(positions, rng.random((600, 4))),
            rng.integers(0, 600, 1500).astype("u2"),
            primitive=primitive,
        )
        with (
            device.render_pass(color, depth, clear=(0, 0, 0, 0), clear_depth=0.5, clear_stencil=1),
            device.states(
                rhi.CullMode.NONE,
                rhi.BlendFunction.ALPHA,
                rhi.StencilTest.ON,
                rhi.StencilFront(both_pass=rhi.StencilOperation.INVERT),
            ),
        ):
            with query:
                device.draw(device.program(Colored), mesh, 3)
            device.draw(device.program(DepthFromColor), mesh.view(3, 700))
        assert query.wait() > 0
        device.finish()
        assert memory_guards.count_guarded() > 10


@pytest.mark.nightly
@pytest.mark.parametrize(
    ("kernel", "before", "inserted"),
    [
        ("setup", "AT(uint, batch->survivors)[chunk] =", "AT(uint, batch->counts)[-1] = 7;"),
        ("bin", "starts[tiles] = sum;", "starts[tiles + 1] = 7;"),
        ("raster", "const Targets *targets =", "*((global uint *)opened.color[0].first - 3) = 7;"),
    ],
)
def test_a_stray_write_of_a_draw_is_found(
    monkeypatch: pytest.MonkeyPatch, kernel: str, before: str, inserted: str
) -> None:
    """A line is added to a kernel of the rasteriser; the control case is the kernel without it."""
    real = cl_pipelines.read_kernels
    changed = real(kernel).replace(before, f"{inserted}\n    {before}")
    assert changed.count(inserted) == 1

    def draw(device: rhi.Device) -> list[str]:
        image = device.texture((130, 70), rhi.Format.RGBA8)
        positions = np.random.default_rng(0).uniform(-1, 1, (900, 4))
        positions[:, 2:] = 0.5, 1.0
        with device.render_pass(image, clear=(0, 0, 0, 0)), device.states(rhi.CullMode.NONE):
            device.draw(device.program(Colored), device.mesh(corners(positions)))
        device.finish()
        return memory_guards.collect_writes()

    with rhi.create_device("cl") as device:
        assert draw(device) == []
    for module in (cl_pipelines, general_raster):
        monkeypatch.setattr(module, "read_kernels", lambda name: changed if name == kernel else real(name))
    with rhi.create_device("cl") as device:
        assert draw(device)


def run_guarded(*modules: str) -> None:
    """Run a part of the conformance kit with this module's guards."""
    here = Path(__file__).parent
    command = [sys.executable, "-m", "pytest", "-q", "-p", "memory_guards", "-p", "no:cacheprovider"]
    path = os.pathsep.join([str(here), os.environ.get("PYTHONPATH", "")])
    done = subprocess.run(
        [*command, "--pyargs", *modules, "--rhi-backend", "cl"],
        capture_output=True,
        text=True,
        env=os.environ | {"PYTHONPATH": path},
        encoding="utf-8",
    )
    assert done.returncode == 0, done.stdout[-4000:]


@pytest.mark.nightly
def test_interplay_and_rasterisation_write_inside_their_buffers() -> None:
    run_guarded("rhi.conformance.operation.test_interplay", "rhi.conformance.operation.test_rasterisation")


@pytest.mark.nightly
def test_the_conformance_kit_writes_inside_its_buffers() -> None:
    run_guarded("rhi.conformance")
