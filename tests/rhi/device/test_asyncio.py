"""Frame loops and reads under asyncio: other tasks run while a device works, and results are those of
`result`."""

from __future__ import annotations

import asyncio
from collections.abc import Iterator

import numpy as np
import pytest

import rhi
from rhi import Format, ValidationError
from rhi.shading import FullScreen, Uniform, vec4


class Fill(FullScreen):
    color: Uniform[vec4]

    def fragment(self) -> vec4:
        return self.color


@pytest.fixture(params=["gl", "cl", "wgpu", "null"])
def device(request: pytest.FixtureRequest) -> Iterator[rhi.Device]:
    try:
        opened = rhi.create_device(request.param)
    except rhi.DeviceError as error:
        pytest.skip(str(error))
    with opened:
        yield opened


def level(frame: int) -> float:
    return (frame % 16) / 16


async def draw_frames(device: rhi.Device, count: int) -> list[np.ndarray]:
    """Draw frames of different colors, and await what each has drawn."""
    image, program = device.texture((8, 8), Format.RGBA8), device.program(Fill)
    texels = []
    for frame in range(count):
        with device.render_pass(image, clear=(0, 0, 0, 1)), device.states(rhi.DepthTest.OFF):
            device.draw(program, device.mesh(3), color=vec4(level(frame), 0.0, 0.0, 1.0))
        read = image.read_async()
        device.present(image)
        texels.append(await read)
    return texels


def check(device: rhi.Device, texels: list[np.ndarray]) -> None:
    assert [image.shape for image in texels] == [(8, 8, 4)] * len(texels)
    if device.capabilities.shading:
        assert [int(image[4, 4, 0]) for image in texels] == [
            round(255 * level(i)) for i in range(len(texels))
        ]


def test_a_frame_loop_under_asyncio_awaits_its_frames(device: rhi.Device) -> None:
    check(device, asyncio.run(draw_frames(device, 8)))


def test_loops_of_several_tasks_take_turns(device: rhi.Device) -> None:
    async def run() -> list[list[np.ndarray]]:
        return list(await asyncio.gather(*(draw_frames(device, 5) for _ in range(3))))

    for texels in asyncio.run(run()):
        check(device, texels)


def test_asynchronous_reads_work_with_gather_wait_for_and_ensure_future(device: rhi.Device) -> None:
    buffer = device.buffer(np.arange(16, dtype=np.uint32))

    async def run() -> None:
        first, second = await asyncio.gather(buffer.read_async(), buffer.read_async(4, 3))
        assert (first.tolist(), second.tolist()) == (list(range(16)), [4, 5, 6])
        assert (await asyncio.wait_for(buffer.read_async(), 60.0)).tolist() == list(range(16))
        read = buffer.read_async()
        assert await read is await read is read.result()
        assert read.done
        task = asyncio.ensure_future(buffer.read_async())
        task.cancel()
        with pytest.raises(asyncio.CancelledError):
            await task
        assert (await buffer.read_async()).tolist() == list(range(16))

    asyncio.run(run())


def test_two_tasks_await_one_read(device: rhi.Device) -> None:
    buffer = device.buffer(np.arange(16, dtype=np.uint32))

    async def run() -> None:
        read = buffer.read_async()

        async def wait() -> np.ndarray:
            return await read

        first, second = await asyncio.gather(wait(), wait())
        assert first is second is read.result()
        assert first.tolist() == list(range(16))

    asyncio.run(run())


@pytest.mark.parametrize("end", ["timeout", "cancel"])
def test_a_wait_that_ends_early_leaves_the_read(
    device: rhi.Device, end: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    buffer = device.buffer(np.arange(16, dtype=np.uint32))

    async def run() -> None:
        read, other = buffer.read_async(), buffer.read_async(2, 3)
        with monkeypatch.context() as patch:
            patch.setattr(type(read), "done", False)  # as while the device works
            if end == "timeout":
                with pytest.raises(asyncio.TimeoutError):
                    await asyncio.wait_for(read, 0.01)
            else:
                both = asyncio.gather(read, other)
                await asyncio.sleep(0.01)
                both.cancel()
                with pytest.raises(asyncio.CancelledError):
                    await both
        assert (await read).tolist() == list(range(16))
        assert (await other).tolist() == [2, 3, 4]

    asyncio.run(run())


def test_wrap_future_on_an_asynchronous_read_says_to_await_it(device: rhi.Device) -> None:
    buffer = device.buffer(np.arange(4, dtype=np.uint32))

    async def run() -> None:
        read = buffer.read_async()
        with pytest.raises(AssertionError, match=r"await it, or pass it to asyncio\.ensure_future"):
            asyncio.wrap_future(read)  # type: ignore[arg-type]
        assert (await asyncio.ensure_future(read)).tolist() == [0, 1, 2, 3]

    asyncio.run(run())


def test_other_tasks_run_while_a_slow_device_works() -> None:
    """A simulated GPU finishes nothing before somebody waits or time passes."""
    with rhi.create_device("null") as device:
        polls = 0
        buffer = device.buffer(np.arange(4, dtype=np.uint32))
        read = buffer.read_async()
        completed = device._core.timeline
        kind = type(completed)

        class Slow(kind):  # type: ignore[misc, valid-type]
            __slots__ = ()

            @property
            def completed(self) -> int:
                nonlocal polls
                polls += 1
                return 0 if polls < 20 else int(super().completed)

        async def run() -> int:
            turns = 0
            task = asyncio.ensure_future(read)
            while not task.done():
                turns += 1
                await asyncio.sleep(0)
            assert task.result().tolist() == [0, 1, 2, 3]
            return turns

        completed.__class__ = Slow
        try:
            assert asyncio.run(run()) > 20
        finally:
            completed.__class__ = kind
        assert polls == 20


def test_a_read_of_a_closed_device_is_refused_in_a_task_as_elsewhere() -> None:
    device = rhi.create_device("null")
    read = device.buffer(np.arange(4, dtype=np.uint32)).read_async()
    device.close()

    async def run() -> None:
        await read

    with pytest.raises(ValidationError, match="device-closed"):
        asyncio.run(run())


def test_without_a_loop_an_await_waits() -> None:
    with rhi.create_device("null") as device:
        read = device.buffer(np.arange(4, dtype=np.uint32)).read_async()

        async def run() -> object:
            return (await read).tolist()

        with pytest.raises(StopIteration) as ended:
            run().send(None)
        assert ended.value.value == [0, 1, 2, 3]
