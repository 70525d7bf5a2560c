"""A canvas of rendercanvas on a page in the browser of the user, and of nobody else.

- rendercanvas's own HTTP canvas accepts every WebSocket, so any page that the browser shows could watch and
  type. This one answers only what names its token, which is new each time and in the address that is printed.
  The `Host` must be this computer's (a stranger's domain may lead here), and a WebSocket's `Origin` this
  page.
- It listens on the loopback address, at a port that was free. One client at a time; with more, the first one
  drives, and the others watch.
- The page and its script are rendercanvas's. Frames are sent as PNG, or JPEG first if `simplejpeg` is
  installed, and no more than two that the client hasn't displayed yet.
"""

from __future__ import annotations

import asyncio
import html
import json
import logging
import secrets
import socket
import sys
import time
from http import HTTPStatus
from importlib.resources import files
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray
from rendercanvas.asyncio import loop
from rendercanvas.base import BaseCanvasGroup, BaseRenderCanvas
from rendercanvas.core.encoders import encode_array
from rendercanvas.core.events import valid_event_types
from websockets.asyncio.server import Server, ServerConnection, serve
from websockets.datastructures import Headers
from websockets.exceptions import ConnectionClosed
from websockets.http11 import Request, Response

__all__ = ["Page", "loop"]

ADDRESS: Final = "127.0.0.1"
_MAX_EVENT_BYTES: Final = 1 << 16  # bytes of an event
_MAX_SIDE: Final = 1 << 14  # pixels of a side
_MAX_FRAMES_IN_FLIGHT: Final = 2  # frames
_JPEG_QUALITY: Final = 80  # of JPEG while frames follow each other
_PNG_DELAY: Final = 0.3  # seconds until a frame that was sent as JPEG is sent as PNG
_SCRIPTS: Final = ("renderview.js", "renderview-client.js")
_PAGE: Final = """<!DOCTYPE html>
<html><head><meta charset="utf-8"><title>{title}</title><link rel="stylesheet" href="renderview.css">
<script type="module" src="renderview.js"></script>
<script type="module">window.BaseRenderView.prototype.setTitle = title => {{ document.title = title }}</script>
<script type="module" src="renderview-client.js"></script></head>
<body><div id="canvas" class="renderview-wrapper is-resizable" style="width:{width}px; height:{height}px"></div>
<div id="status" style="position:fixed; top:0; right:0; font-family:monospace"></div></body></html>
"""
_HEADERS: Final = {"Cache-Control": "no-store", "Referrer-Policy": "no-referrer", "X-Frame-Options": "DENY"}
_log: Final = logging.getLogger("rhi_screen.page")
_silent: Final = logging.Logger("websockets", logging.CRITICAL + 1)  # strangers write no log


class _Client:
    """A page that is open: what it is to be sent, and how many frames it was sent and has displayed."""

    def __init__(self, connection: ServerConnection) -> None:
        self.connection = connection
        self.messages: asyncio.Queue[str | bytes] = asyncio.Queue()
        self.sent = self.displayed = self.latest = 0

    @property
    def is_ready(self) -> bool:
        """True if it may be sent another frame."""
        return self.sent - self.displayed < _MAX_FRAMES_IN_FLIGHT

    def send_message(self, kind: str, value: object) -> None:
        self.messages.put_nowait(json.dumps({"type": kind, "value": value}))


class Page(BaseRenderCanvas):  # type: ignore[misc]  # rendercanvas has no types
    """A page of a browser. Its options are those of `rendercanvas.BaseRenderCanvas`.

    Attributes:
        address: where the page is, with the token that lets its reader in.
    """

    _rc_canvas_group = BaseCanvasGroup(loop)

    def __init__(self, *arguments: Any, clients: int = 1, port: int = 0, **options: Any) -> None:
        """Listen, as soon as the loop runs; then the address is printed.

        Args:
            clients: how many pages may be open at once; the first drives, the others watch.
            port: the port; 0: one that is free.
            arguments, options: rendercanvas's.

        Raises:
            OSError: the port is taken.
        """
        self._is_closed = False
        self._clients: list[_Client] = []
        self._most = clients
        self._server: Server | None = None
        self._is_requested = False
        self._frame: NDArray[np.uint8] | None = None
        self._last_image = ("", b"")
        self._number = 0
        self._still: asyncio.TimerHandle | None = None
        self._size, self._title = (0.0, 0.0), ""
        self._socket = socket.create_server((ADDRESS, port))
        self._token = secrets.token_urlsafe(24)
        self._port: int = self._socket.getsockname()[1]
        self.address = f"http://{ADDRESS}:{self._port}/{self._token}/"
        super().__init__(*arguments, **options)
        self._final_canvas_init()
        loop.add_task(self._serve, name="page")

    # -- the server ----------------------------------------------------------------------------------------

    async def _serve(self) -> None:
        if self._is_closed:
            return
        async with serve(
            self._attend,
            sock=self._socket,
            process_request=self._admit,
            compression=None,
            max_size=_MAX_EVENT_BYTES,
            close_timeout=1.0,
            logger=_silent,
            server_header=None,
        ) as self._server:
            print(f"the page is {self.address}", file=sys.stderr, flush=True)
            await self._server.wait_closed()

    def _admit(self, _connection: ServerConnection, request: Request) -> Response | None:
        """Return the answer to a request; None lets a WebSocket be opened."""
        hosts = request.headers.get_all("Host")
        if hosts not in ([f"{ADDRESS}:{self._port}"], [f"localhost:{self._port}"]):
            return _respond(HTTPStatus.MISDIRECTED_REQUEST)
        _, token, name = [*request.path.split("/", 2), "", ""][:3]
        if not secrets.compare_digest(token.encode(), self._token.encode()):
            return _respond(HTTPStatus.NOT_FOUND)
        if "Upgrade" in request.headers:
            if request.headers.get_all("Origin") != [f"http://{hosts[0]}"]:
                return _respond(HTTPStatus.FORBIDDEN)
            return None if len(self._clients) < self._most else _respond(HTTPStatus.CONFLICT)
        if not name:
            width, height = self._size
            text = _PAGE.format(title=html.escape(self._title), width=width, height=height)
            return _respond(HTTPStatus.OK, text, "text/html")
        if name in (*_SCRIPTS, "renderview.css"):
            text = files("rendercanvas.core").joinpath(name).read_text("utf-8")
            return _respond(HTTPStatus.OK, text, "text/javascript" if name in _SCRIPTS else "text/css")
        return _respond(HTTPStatus.NOT_FOUND)

    async def _attend(self, connection: ServerConnection) -> None:
        """Exchange messages with a page until it is closed."""
        if self._is_closed or len(self._clients) >= self._most:  # another one was admitted at the same time
            return
        client = _Client(connection)
        self._clients.append(client)
        client.send_message("title", self._title)
        self._announce_driver()
        self.request_draw()
        self._draw_if_ready()  # what was asked for before somebody looked
        sender = asyncio.create_task(self._send(client))
        try:
            async for message in connection:
                try:
                    self._receive(client, json.loads(message))
                except Exception as error:  # whatever a stranger's words lead to
                    _log.warning("closed a page that sent no event: %r", error)
                    return
        except ConnectionClosed:
            pass
        finally:
            sender.cancel()
            self._clients.remove(client)
            self._announce_driver()
            self._draw_if_ready()

    async def _send(self, client: _Client) -> None:
        while True:
            try:
                await client.connection.send(await client.messages.get())
            except ConnectionClosed:
                return

    def _announce_driver(self) -> None:
        for client in self._clients:
            client.send_message("active", client is self._clients[0])

    def _send_message(self, kind: str, value: object) -> None:
        for client in self._clients:
            client.send_message(kind, value)

    def _receive(self, client: _Client, event: dict[str, Any]) -> None:
        """Take a message of a page's script."""
        kind = event.pop("type")
        if kind == "_framefeedback":
            client.displayed = min(max(client.displayed, int(event["index"])), client.sent)
            self._send_frame()
            self._draw_if_ready()
        elif client is not self._clients[0]:
            return
        elif kind == "resize":
            width = int(event["pwidth"])
            height = int(event["pheight"])
            ratio = float(event["ratio"])
            if not (0 <= width <= _MAX_SIDE and 0 <= height <= _MAX_SIDE and 0.1 <= ratio <= 16.0):
                raise ValueError(f"a page of {width}×{height} pixels")
            self._size_info.set_physical_size(width, height, ratio)
            self.request_draw()
        elif kind == "close":
            self.close()
        elif kind in valid_event_types:
            stamp = float(event.pop("timestamp"))
            lists = {name: tuple(event[name]) for name in ("buttons", "modifiers") if name in event}
            self.submit_event(event | lists | {"event_type": kind, "time_stamp": stamp})

    # -- frames --------------------------------------------------------------------------------------------

    def _draw_if_ready(self) -> None:
        if self._is_requested and self._clients and self._clients[0].is_ready and not self._is_closed:
            self._is_requested = False
            loop.call_soon(self._time_to_draw)

    def _encode(self, quality: int) -> None:
        assert self._frame is not None
        kind, data = encode_array(self._frame, quality)
        self._last_image = (kind, data)
        self._number += 1
        self._send_frame()
        if kind != "image/png":
            self._still = asyncio.get_running_loop().call_later(_PNG_DELAY, self._encode, 100)

    def _send_frame(self) -> None:
        """Send the latest image to whoever lacks it and is ready."""
        kind, data = self._last_image
        for client in self._clients:
            if client.is_ready and client.latest < self._number:
                client.latest = self._number
                client.sent += 1
                head = {"type": "framebufferdata", "nbuffers": 1, "mimetype": kind, "index": client.sent}
                client.messages.put_nowait(json.dumps(head | {"timestamp": time.time()}))
                client.messages.put_nowait(data)

    # -- what rendercanvas calls ---------------------------------------------------------------------------

    def _rc_get_present_info(self, present_methods: list[str]) -> dict[str, Any] | None:
        return {"method": "bitmap", "formats": ["rgba-u8"]} if "bitmap" in present_methods else None

    def _rc_request_draw(self) -> None:
        self._is_requested = True
        self._draw_if_ready()

    def _rc_request_paint(self) -> None:
        pass

    def _rc_force_paint(self) -> None:
        pass

    def _rc_present_bitmap(self, *, data: NDArray[np.uint8], format: str, **_: Any) -> None:
        if self._still is not None:
            self._still.cancel()
        self._frame = np.asarray(data)
        self._encode(_JPEG_QUALITY)

    def _rc_set_logical_size(self, width: float, height: float) -> None:
        self._size = (width, height)
        if self._clients:  # their script says what became of it
            self._send_message("css_width", f"{width}px")
            self._send_message("css_height", f"{height}px")
        else:
            self._size_info.set_physical_size(round(width), round(height), 1.0)

    def _rc_set_title(self, title: str) -> None:
        self._title = title
        self._send_message("title", title)

    def _rc_set_cursor(self, cursor: str) -> None:
        self._send_message("cursor", cursor)

    def _rc_close(self) -> None:
        if self._is_closed:
            return
        self._is_closed = True
        if self._still is not None:
            self._still.cancel()
        if self._server is None:
            self._socket.close()
        else:
            self._server.close()

    def _rc_get_closed(self) -> bool:
        return self._is_closed


def _respond(status: HTTPStatus, text: str = "", kind: str = "text/plain") -> Response:
    body = text.encode()
    headers = Headers(
        {"Content-Type": f"{kind}; charset=utf-8", "Content-Length": str(len(body)), **_HEADERS}
    )
    headers["Connection"] = "close"
    return Response(status.value, status.phrase, headers, body)
