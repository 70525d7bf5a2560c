"""Commands over a socket: only from this computer, without waiting, and not from pages in a browser."""

from __future__ import annotations

import contextlib
import socket
from collections.abc import Iterator

import pytest

from renderer.viewer.command_server import ADDRESS, CommandServer
from rhi import DeviceError

RAN: list[str] = []


def answer(line: str) -> tuple[str, bool]:
    RAN.append(line)
    return ("what?\nnothing", True) if line.startswith(("bad", "POST")) else (line.upper(), False)


@pytest.fixture
def server() -> Iterator[CommandServer]:
    RAN.clear()
    command_server = CommandServer(0, answer)
    yield command_server
    command_server.close()


@pytest.fixture
def client(server: CommandServer) -> Iterator[socket.socket]:
    with connect(server) as connection:
        yield connection


def connect(server: CommandServer, greeting: str | None = None) -> socket.socket:
    """Return a connection that has greeted, or one with other words, or with "" none."""
    connection = socket.create_connection((ADDRESS, server.port))
    connection.settimeout(5.0)
    server.poll()
    if greeting != "":
        connection.sendall(f"{server.greeting if greeting is None else greeting}\n".encode())
        assert server.poll() == 0
        if greeting is None:
            assert connection.recv(9) == b"ok\n"
    return connection


def receive(client: socket.socket, lines: int) -> bytes:
    """Return so many lines, which may come in parts."""
    data = b""
    while data.count(b"\n") < lines:
        data += client.recv(999)
    return data


def is_closed(client: socket.socket) -> bool:
    """Return whether nothing was answered and the connection was closed, or reset with what wasn't read."""
    try:
        return client.recv(999) == b""
    except ConnectionResetError:
        return True


@pytest.mark.parametrize(
    "first",
    [
        "\n",
        "# comment",
        "time",
        "GET / HTTP/1.1",
        "# / HTTP/1.1",
        "POST / HTTP/1.1\r\nHost: x\r\n\r\nscreenshot evil.png",
        "hello",
        "hello x",
        "HELLO",
        "é\0",
        " {}",
        "{} x",
        "{}x",
    ],
)
def test_without_the_greeting_nothing_is_run_or_answered(server: CommandServer, first: str) -> None:
    with connect(server, first.replace("{}", server.greeting)) as client:
        with contextlib.suppress(OSError):
            client.sendall(server.greeting.encode() + b"\nscreenshot evil.png\n")
        server.poll()
        assert is_closed(client)
    assert RAN == []


def test_a_greeting_is_for_one_server_and_can_come_in_parts(server: CommandServer) -> None:
    other = CommandServer(0, answer)
    assert len(other.greeting) > 30
    with connect(other, server.greeting) as client:
        assert is_closed(client)
    with connect(server, "") as client:
        client.sendall(server.greeting[:9].encode())
        assert server.poll() == 0
        client.sendall(server.greeting[9:].encode() + b"\r\ntime\n")
        assert server.poll() == 1
        assert receive(client, 2) == b"ok\nok TIME\n"
    other.close()


def test_idle_connections_lock_nobody_out(server: CommandServer) -> None:
    idle = [connect(server, "") for _ in range(20)]
    with connect(server) as client:
        client.sendall(b"ping\n")
        server.poll()
        assert client.recv(99) == b"ok PING\n"
        more = [connect(server, "") for _ in range(20)]
        client.sendall(b"pong\n")
        server.poll()
        assert client.recv(99) == b"ok PONG\n"
    for connection in (*idle, *more):
        connection.close()


def test_each_line_is_run_and_answered(server: CommandServer, client: socket.socket) -> None:
    client.sendall(b"time\nbad\nde")
    assert server.poll() == 2
    assert receive(client, 2) == b"ok TIME\nerror: what? nothing\n"
    client.sendall(b"pth\n")
    assert server.poll() == 1
    assert client.recv(999) == b"ok DEPTH\n"


def test_blank_lines_and_comments_are_no_commands(server: CommandServer, client: socket.socket) -> None:
    client.sendall(b"\n  \r\n# / HTTP/1.1\n\t# time\nping\n")
    assert server.poll() == 1
    assert client.recv(999) == b"ok PING\n"
    assert RAN == ["ping"]


def test_nothing_to_do_does_not_wait(server: CommandServer, client: socket.socket) -> None:
    assert server.poll() == 0


def test_a_line_without_an_end_is_cut_off(server: CommandServer, client: socket.socket) -> None:
    client.sendall(b"x" * 20_000)
    for _ in range(9):
        server.poll()
    assert is_closed(client)
    assert RAN == []


def test_the_ninth_client_replaces_the_client_that_was_silent_for_longest(server: CommandServer) -> None:
    clients = [connect(server) for _ in range(8)]
    clients[0].sendall(b"ping\n")
    server.poll()
    strangers = [connect(server, "") for _ in range(9)]  # close none of them
    clients.append(connect(server))
    for number, client in enumerate(clients):
        if number == 1:
            assert is_closed(client)
            continue
        client.sendall(b"time\n")
        server.poll()
        assert receive(client, 2 - bool(number)).endswith(b"ok TIME\n")
    for connection in (*clients, *strangers):
        connection.close()


def test_a_client_may_be_replaced_while_its_message_arrives(server: CommandServer) -> None:
    idle = [connect(server, "") for _ in range(8)]
    idle[0].sendall(server.greeting.encode() + b"\n")
    with socket.create_connection((ADDRESS, server.port)):
        server.poll()
        assert is_closed(idle[0])
    for connection in idle:
        connection.close()


def test_it_listens_to_this_computer_only(server: CommandServer) -> None:
    assert server._socket.getsockname()[0] == "127.0.0.1"


@pytest.mark.parametrize("port", [70_000, None])
def test_a_port_that_is_taken_or_none_is_refused(server: CommandServer, port: int | None) -> None:
    with pytest.raises(DeviceError, match="viewer-cannot-listen"):
        CommandServer(server.port if port is None else port, answer)
