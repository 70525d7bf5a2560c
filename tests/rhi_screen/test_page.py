"""The page of a browser: it is there for one who knows its address, and for no other page, host or
program."""

from __future__ import annotations

import asyncio
import io
import json
from collections.abc import Awaitable, Callable
from typing import Any

import numpy as np
import pytest
from PIL import Image

import rhi

pytest.importorskip("rendercanvas", reason="no rendercanvas: pip install rhi[viewer]")
pytest.importorskip("websockets", reason="no websockets: pip install rhi[viewer]")

from rendercanvas.asyncio import loop
from websockets.asyncio.client import ClientConnection, connect
from websockets.exceptions import ConnectionClosed, InvalidStatus

from rhi_screen import Screen, open_canvas

SIZE = (24, 10)
RESIZE = {"type": "resize", "pwidth": 30, "pheight": 20, "ratio": 1.0, "timestamp": 1.0}
KEY = {"type": "key_down", "key": "x", "modifiers": [], "timestamp": 1.0}

Visit = Callable[[Any], Awaitable[None]]


class PageLog:
    """The images and events of a page, at the end."""

    def __init__(self) -> None:
        self.sizes: list[tuple[int, int]] = []
        self.keys: list[str] = []


def show(visit: Visit, **options: Any) -> PageLog:
    """Run a page that shows red images until a visitor is done with it."""
    seen, errors = PageLog(), []
    canvas = open_canvas("page", title="a <b>", size=SIZE, **options)

    async def go() -> None:
        try:
            await asyncio.wait_for(visit(canvas), 20)
        except BaseException as error:  # pytest's own is none of Exception
            errors.append(error)
        canvas.close()

    def draw() -> None:
        seen.sizes.append(screen.size)
        image = screen.device.texture(screen.size, rhi.Format.RGBA8)
        with screen.device.render_pass(image, clear=(1.0, 0.0, 0.0, 1.0)):
            pass
        screen.show(image)
        image.destroy()

    with Screen(canvas, "null") as screen:
        assert screen.size == SIZE
        canvas.add_event_handler(lambda event: seen.keys.append(event["key"]), "key_down")
        loop.add_task(go)
        screen.run(draw)
    if errors:
        raise errors[0]
    return seen


def enter(page: Any, *, path: str = "", origin: str | None = "same", host: str | None = None) -> connect:
    """Open a WebSocket as a page of `origin` does, with other words where they are given."""
    port = page.address.split(":")[2].split("/")[0]
    url = page.address.replace("http", "ws") if not path else f"ws://127.0.0.1:{port}{path}"
    address = f"http://127.0.0.1:{port}"
    headers = {} if host is None else {"Host": host}
    return connect(url, origin=address if origin == "same" else origin, additional_headers=headers)  # type: ignore[arg-type]


async def fetch(page: Any, path: str, host: str = "") -> tuple[int, str]:
    """Return the status and the text of a GET."""
    port = int(page.address.split(":")[2].split("/")[0])
    reader, writer = await asyncio.open_connection("127.0.0.1", port)
    writer.write(f"GET {path} HTTP/1.1\r\nHost: {host or f'127.0.0.1:{port}'}\r\n\r\n".encode())
    answer = (await reader.read()).decode()
    writer.close()
    return int(answer.split()[1]), answer


async def receive_frame(client: ClientConnection, index: int) -> np.ndarray:
    """Return the next image, say that it is shown."""
    while True:
        event = json.loads(await client.recv())
        if event["type"] == "framebufferdata":
            data = await client.recv()
            await client.send(json.dumps({"type": "_framefeedback", "index": index, "timestamp": 1.0}))
            with Image.open(io.BytesIO(data)) as image:
                return np.asarray(image)


def token_of(page: Any) -> str:
    return str(page.address.split("/")[3])


def test_the_page_has_the_size_and_the_title_of_the_canvas() -> None:
    async def visit(page: Any) -> None:
        status, text = await fetch(page, f"/{token_of(page)}/")
        assert status == 200
        assert "<title>a &lt;b&gt;</title>" in text
        assert "width:24.0px; height:10.0px" in text

    show(visit)


def test_the_page_gets_its_scripts_and_no_other_file() -> None:
    async def visit(page: Any) -> None:
        for name in ("renderview.js", "renderview-client.js", "renderview.css"):
            assert (await fetch(page, f"/{token_of(page)}/{name}"))[0] == 200
        assert (await fetch(page, f"/{token_of(page)}/__init__.py"))[0] == 404

    show(visit)


@pytest.mark.parametrize(
    "header", ["Cache-Control: no-store", "Referrer-Policy: no-referrer", "X-Frame-Options: DENY"]
)
def test_the_page_is_sent_with_headers_that_keep_it_private(header: str) -> None:
    async def visit(page: Any) -> None:
        assert header in (await fetch(page, f"/{token_of(page)}/"))[1]

    show(visit)


def test_a_visitor_gets_the_title_and_images_of_the_size_that_it_asks_for() -> None:
    async def visit(page: Any) -> None:
        await asyncio.sleep(0.1)  # a frame was asked for before anybody looked
        async with enter(page) as client:
            assert json.loads(await client.recv()) == {"type": "title", "value": "a <b>"}
            image = await receive_frame(client, 1)
            assert image.shape[:2] == SIZE[::-1]
            await client.send(json.dumps(RESIZE))
            while image.shape[:2] != (20, 30):
                image = await receive_frame(client, 9)

    assert {SIZE, (30, 20)} <= set(show(visit).sizes)


def test_keys_of_a_visitor_arrive_and_unknown_events_are_passed_over() -> None:
    pressed = asyncio.Event()

    async def visit(page: Any) -> None:
        page.add_event_handler(lambda event: pressed.set(), "key_down")
        async with enter(page) as client:
            await client.send(json.dumps(KEY | {"type": "unknown"}))
            await client.send(json.dumps(KEY))
            await pressed.wait()

    assert show(visit).keys == ["x"]


@pytest.mark.parametrize("origin", ["https://evil.example", "http://127.0.0.1:1", "null", "file://", None])
def test_a_page_of_another_origin_that_knows_the_address_can_not_enter(origin: str | None) -> None:
    async def visit(page: Any) -> None:
        with pytest.raises(InvalidStatus, match="403"):
            async with enter(page, origin=origin):
                pass

    assert show(visit).keys == []


@pytest.mark.parametrize("path", ["/", "/x/", "//", "/renderview.js", "/%C3%A9/"])
def test_without_the_token_nothing_is_answered(path: str) -> None:
    async def visit(page: Any) -> None:
        port = page.address.split(":")[2].split("/")[0]
        assert port not in ("60649", "0")
        status, text = await fetch(page, path)
        assert (status, "RenderView" in text) in ((404, False), (400, False))
        with pytest.raises((InvalidStatus, ConnectionClosed, OSError, ValueError)):
            async with enter(page, path=path):
                pass
        assert token_of(page) != token_of(other)

    other = open_canvas("page")
    other.close()
    show(visit)


def test_a_domain_that_a_stranger_leads_here_is_refused() -> None:
    async def visit(page: Any) -> None:
        port = page.address.split(":")[2].split("/")[0]
        path = f"/{token_of(page)}/"
        assert (await fetch(page, path, f"evil.example:{port}"))[0] == 421
        assert (await fetch(page, path, "127.0.0.1"))[0] == 421
        assert (await fetch(page, path, f"localhost:{port}"))[0] == 200

    show(visit)


def test_one_client_at_a_time_unless_more_are_asked_for() -> None:
    async def visit_one(page: Any) -> None:
        async with enter(page) as first:
            with pytest.raises(InvalidStatus, match="409"):
                async with enter(page):
                    pass
            await page._attend(None)  # one that was admitted at the same time
            await receive_frame(first, 1)
        async with enter(page) as next_one:
            await receive_frame(next_one, 1)
        while page._clients:
            await asyncio.sleep(0.01)
        page._is_closed = True  # while one is let in
        await page._attend(None)
        page._is_closed = False

    async def visit_both(page: Any) -> None:
        async with enter(page) as first, enter(page) as second:
            await receive_frame(first, 1)
            assert (await receive_frame(second, 1)).shape[:2] == SIZE[::-1]
            await second.send(json.dumps(KEY | {"key": "passive"}))
            await second.ping()
            await first.send(json.dumps(KEY | {"key": "active"}))
            await asyncio.sleep(0.2)

    show(visit_one)
    assert show(visit_both, clients=2).keys == ["active"]


@pytest.mark.parametrize(
    "message",
    [
        "\0",
        "[" * 50_000,
        "{}",
        "[]",
        '"resize"',
        '{"type": []}',
        json.dumps(RESIZE | {"pwidth": 1 << 20}),
        json.dumps(RESIZE | {"pwidth": -1}),
        json.dumps(RESIZE | {"pheight": 1 << 20}),
        json.dumps(RESIZE | {"pheight": -1}),
        json.dumps(RESIZE | {"ratio": 1e-9}),
        json.dumps(RESIZE | {"ratio": 1e9}),
        json.dumps(RESIZE | {"pheight": 1e400}),
        '{"type": "key_down"}',
        json.dumps(KEY | {"key": "x" * (1 << 17)}),
    ],
)
def test_a_message_that_is_not_an_event_closes_the_connection_and_the_loop_goes_on(
    message: str, caplog: pytest.LogCaptureFixture
) -> None:
    async def visit(page: Any) -> None:
        async with enter(page) as client:
            await client.send(message)
            with pytest.raises(ConnectionClosed):
                while True:
                    await client.recv()
        async with enter(page) as client:
            await receive_frame(client, 1)

    assert show(visit).sizes[-1] == SIZE
    assert ("closed a page that sent no event" in caplog.text) == (len(message) < 1 << 16)


def test_no_more_than_two_frames_are_sent_that_a_page_has_not_shown() -> None:
    """Whatever it says that it has: it can't have shown more than it was sent."""

    async def visit(page: Any) -> None:
        async with enter(page) as client:
            await client.send(json.dumps({"type": "_framefeedback", "index": 10**9, "timestamp": 1.0}))
            for width in range(10, 20):
                await client.send(json.dumps(RESIZE | {"pwidth": width}))
                await asyncio.sleep(0.02)
            with pytest.raises(asyncio.TimeoutError):
                while True:
                    received.append(await asyncio.wait_for(client.recv(), 0.5))
        assert len([message for message in received if isinstance(message, bytes)]) in (
            2,
            3,
        )  # one may precede what it said

    received: list[str | bytes] = []
    show(visit)
