# SPDX-License-Identifier: Apache-2.0
"""Requests that the server accepts and refuses."""

from __future__ import annotations

import socket
from collections.abc import Iterator
from socket import gethostname

import pytest

pytest.importorskip("viser", reason="no viser")

from wam_power_ros.view.guarded_server import GuardedServer, refusal

OURS = ("127.0.0.1:8080", "localhost:8080", "[::1]:8080", "10.0.0.7:80", f"{gethostname()}:80")
FOREIGN = ("rebound.example:8080", "127.0.0.1.example", "", None)
OTHERS = ("http://a.example", "http://127.0.0.1:8081", "https://127.0.0.1:8080", "null", "")


def test_the_page_is_for_its_own_origin_under_the_names_of_this_machine_alone() -> None:
    assert not [host for host in OURS if refusal(host, None) or refusal(host, f"http://{host}")]
    assert all("is not this machine" in refusal(host, None) for host in FOREIGN)
    assert all("origin" in refusal("127.0.0.1:8080", origin) for origin in OTHERS)


@pytest.fixture(scope="module")
def server() -> Iterator[GuardedServer]:
    server = GuardedServer("127.0.0.1", 0)
    yield server
    server.stop()


def answer(port: int, *head: str) -> bytes:
    """First line of the answer to a request with these headers; empty for none."""
    with socket.create_connection(("127.0.0.1", port)) as asking:
        asking.sendall("\r\n".join(["GET / HTTP/1.1", *head, "", ""]).encode())
        return asking.makefile("rb").readline().strip()


def test_only_this_machine_reaches_the_server_and_the_public_relay_is_off(
    server: GuardedServer,
) -> None:
    port = server.get_port()
    assert answer(port, f"Host: 127.0.0.1:{port}") == b"HTTP/1.1 200 OK"
    with socket.socket() as other, pytest.raises(OSError, match="refused"):
        other.connect(("127.0.0.2", port))
    assert server.request_share_url() is None


def test_a_strange_request_does_not_reach_viser(server: GuardedServer) -> None:
    port = server.get_port()
    ours = f"Host: 127.0.0.1:{port}"
    upgrade = ("Connection: Upgrade", "Upgrade: websocket", "Origin: http://a", ours)
    for head in ((), ("Host: rebound.example",), ("Origin: http://a", ours), upgrade):
        assert answer(port, *head) == b"HTTP/1.1 403 Forbidden"


def test_a_request_without_an_end_is_closed_and_a_server_with_guests_stops(
    capfd: pytest.CaptureFixture[str],
) -> None:
    server = GuardedServer("127.0.0.1", 0)
    assert answer(server.get_port(), "Host: " + "a" * 100_000) == b""
    with socket.create_connection(("127.0.0.1", server.get_port())):
        server.draw(lambda: None)  # it has been accepted
        server.stop()
    assert "Traceback" not in (err := capfd.readouterr().err) and "pending" not in err


def test_an_address_of_another_machine_is_refused() -> None:
    with pytest.raises(ValueError, match=r"'192\.0\.2\.1' is not one of this machine"):
        GuardedServer("192.0.2.1", 0)


def test_the_next_free_port_is_used_and_without_one_the_server_is_refused() -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        server = GuardedServer("127.0.0.1", port)
        try:
            assert server.get_port() > port
        finally:
            server.stop()
    with pytest.raises(ValueError, match="port from 70000"):
        GuardedServer("127.0.0.1", 70000)
