"""Runs commands that come over a local socket, if the user asks for it.

Each received line is run, and answered by a line: `ok` or `error:`, and the command's message.

It is bound to the loopback address, which every user of this computer and every page in a browser can reach.
So a connection must begin with the greeting, a line with a random token that only the user has seen; with any
other line it is closed, and nothing is answered. Connections that don't greet make room for new ones. Of
those that have greeted, the one that has been silent for longest makes room for another that greets: nobody
is locked out, and no stranger closes one.
"""

from __future__ import annotations

import hmac
import secrets
import selectors
import socket
from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

from renderer import rules
from rhi.errors import DeviceError

ADDRESS: Final = "127.0.0.1"
_MAX_LINE: Final = 4096  # bytes of a line
_MAX_CONNECTIONS: Final = 8  # connections that have greeted, and others

Answer = Callable[[str], tuple[str, bool]]
"""Runs a line; returns its message and whether that is an error."""


@dataclass(slots=True)
class Connection:
    """A connection: the received part of its next line, and whether it has greeted."""

    socket: socket.socket
    partial_line: bytes = b""
    has_greeted: bool = False


class CommandServer:
    """Listens on a port; `poll` runs the received lines and never blocks.

    Attributes:
        port: the port; for 0, a free one.
        greeting: the first line of every connection.
    """

    def __init__(self, port: int, answer: Answer) -> None:
        """Listen.

        Raises:
            DeviceError: `viewer-cannot-listen`.
        """
        self._answer = answer
        self.greeting = f"hello {secrets.token_urlsafe(24)}"
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
        self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        self._connections: dict[int, Connection] = {}
        try:
            self._socket.bind((ADDRESS, port))
            self._socket.listen()
        except (OSError, OverflowError) as error:
            self._socket.close()
            raise DeviceError(rules.CANNOT_LISTEN, "listen", f"{port}: {error}") from None
        self._socket.setblocking(False)
        self._selector = selectors.DefaultSelector()
        self._selector.register(self._socket, selectors.EVENT_READ)
        self.port: int = self._socket.getsockname()[1]

    def poll(self) -> int:
        """Run the received lines, and return their number."""
        count = 0
        for key, _ in self._selector.select(0):
            if key.fileobj is self._socket:
                self._accept()
            elif key.fd in self._connections:  # it may just have been closed to make room
                count += self._receive(self._connections[key.fd])
        return count

    def close(self) -> None:
        """Close all connections and the port."""
        for connection in list(self._connections.values()):
            self._drop(connection)
        self._selector.close()
        self._socket.close()

    def _accept(self) -> None:
        try:
            connection, _ = self._socket.accept()
        except OSError:  # it has gone again
            return
        self._make_room(has_greeted=False)
        connection.setblocking(False)
        self._connections[connection.fileno()] = Connection(connection)
        self._selector.register(connection, selectors.EVENT_READ)

    def _make_room(self, has_greeted: bool) -> None:
        """Close the connection of a kind that has been silent for longest, if their number is at the
        limit."""
        connections = [
            connection for connection in self._connections.values() if connection.has_greeted == has_greeted
        ]
        if len(connections) == _MAX_CONNECTIONS:
            self._drop(connections[0])

    def _receive(self, connection: Connection) -> int:
        try:
            data = connection.socket.recv(_MAX_LINE)
        except BlockingIOError:
            return 0
        except OSError:
            data = b""
        if not data:
            self._drop(connection)
            return 0
        number = connection.socket.fileno()
        self._connections[number] = self._connections.pop(number)  # the first one has been silent for longest
        *lines, connection.partial_line = (connection.partial_line + data).split(b"\n")
        if lines and not connection.has_greeted:
            if not hmac.compare_digest(lines[0].rstrip(b"\r"), self.greeting.encode()):
                self._drop(connection)
                return 0
            self._make_room(has_greeted=True)
            connection.has_greeted = True
            lines = lines[1:]
            if not self._send(connection, "ok"):
                self._drop(connection)
                return 0
        lines = [line for line in lines if line.strip() and not line.lstrip().startswith(b"#")]
        for number, line in enumerate(lines):
            reply, is_error = self._answer(line.decode("utf-8", "replace"))
            reply = f"error: {reply}" if is_error else f"ok {reply}".rstrip()
            if not self._send(connection, " ".join(reply.split())):
                self._drop(connection)
                return number + 1
        if len(connection.partial_line) > _MAX_LINE:
            self._drop(connection)
        return len(lines)

    def _send(self, connection: Connection, line: str) -> bool:
        """Send a line; connections that don't read are closed."""
        try:
            connection.socket.sendall(line.encode() + b"\n")
        except OSError:
            return False
        return True

    def _drop(self, connection: Connection) -> None:
        self._connections.pop(connection.socket.fileno(), None)
        self._selector.unregister(connection.socket)
        connection.socket.close()
