"""Commands over a socket: only from this computer, without waiting, and not from pages in a browser."""

from __future__ import annotations

import socket
from collections.abc import Iterator

import pytest

from renderer.viewer.server import ADDRESS, CommandServer
from rhi import DeviceError

RAN: list[str] = []


def answer(line: str) -> tuple[str, bool]:
    RAN.append(line)
    return ("what?\nnothing", True) if line.startswith(("bad", "POST")) else (line.upper(), False)


@pytest.fixture
def server() -> Iterator[CommandServer]:
    RAN.clear()
    made = CommandServer(0, answer)
    yield made
    made.close()


@pytest.fixture
def client(server: CommandServer) -> Iterator[socket.socket]:
    with connect(server) as made:
        yield made


def connect(server: CommandServer) -> socket.socket:
    made = socket.create_connection((ADDRESS, server.port))
    made.settimeout(5.0)
    server.poll()
    return made


def test_each_line_is_run_and_answered(server: CommandServer, client: socket.socket) -> None:
    client.sendall(b"time\nbad\nde")
    assert server.poll() == 2
    assert client.recv(999) == b"ok TIME\nerror: what? nothing\n"
    client.sendall(b"pth\n")
    assert server.poll() == 1
    assert client.recv(999) == b"ok DEPTH\n"


def test_nothing_to_do_does_not_wait(server: CommandServer, client: socket.socket) -> None:
    assert server.poll() == 0


def test_a_request_of_a_browser_runs_nothing(server: CommandServer, client: socket.socket) -> None:
    client.sendall(b"POST / HTTP/1.1\r\nHost: x\r\n\r\nscreenshot evil.png\n")
    server.poll()
    assert client.recv(999).startswith(b"error:")
    assert client.recv(999) == b""
    assert RAN == ["POST / HTTP/1.1\r"]


def test_a_line_without_an_end_is_cut_off(server: CommandServer, client: socket.socket) -> None:
    client.sendall(b"x" * 20_000)
    for _ in range(9):
        server.poll()
    with pytest.raises(OSError):  # noqa: PT011  # closed, or reset with what was not read
        if client.recv(9) == b"":
            raise OSError
    assert RAN == []


def test_too_many_connections_are_refused(server: CommandServer) -> None:
    clients = [connect(server) for _ in range(9)]
    server.poll()
    assert clients[8].recv(9) == b""
    clients[0].close()
    server.poll()
    with connect(server) as another:
        another.sendall(b"ping\n")
        server.poll()
        assert another.recv(99) == b"ok PING\n"
    for one in clients:
        one.close()


def test_it_listens_to_this_computer_only(server: CommandServer) -> None:
    assert server._socket.getsockname()[0] == "127.0.0.1"


@pytest.mark.parametrize("port", [70_000, None])
def test_a_port_that_is_taken_or_none_is_refused(server: CommandServer, port: int | None) -> None:
    with pytest.raises(DeviceError, match="viewer-cannot-listen"):
        CommandServer(server.port if port is None else port, answer)
