# SPDX-License-Identifier: Apache-2.0
"""Requests that the server accepts and refuses."""

from __future__ import annotations

import socket
from contextlib import suppress

import pytest

pytest.importorskip("viser", reason="no viser")

from wam_power_ros.view.guarded_server import close, open_server, refusal


@pytest.mark.parametrize("host", ["127.0.0.1:8080", "localhost:8080", "[::1]:8080", "10.0.0.7:80"])
def test_the_page_is_served_under_every_address_and_name_of_this_machine(host: str) -> None:
    assert refusal(host, None) == refusal(host, f"http://{host}") == ""
    assert refusal(f"{socket.gethostname()}:8080", None) == ""


@pytest.mark.parametrize(
    "origin",
    ["http://elsewhere.example", "http://127.0.0.1:8081", "https://127.0.0.1:8080", "null", ""],
)
def test_a_page_of_another_origin_is_refused(origin: str) -> None:
    assert "origin" in refusal("127.0.0.1:8080", origin)


@pytest.mark.parametrize("host", ["rebound.example:8080", "127.0.0.1.example", "", None])
def test_a_foreign_name_for_this_machine_is_refused(host: str | None) -> None:
    assert "is not this machine" in refusal(host, None)


def test_only_this_machine_reaches_the_server_and_the_public_relay_is_off() -> None:
    from viser import _messages

    server = open_server("127.0.0.1", 0)
    try:
        assert _messages.ShareUrlRequest not in server._websock_server._incoming_handlers
        with socket.create_connection(("127.0.0.1", server.get_port())) as asking:
            asking.shutdown(socket.SHUT_WR)
            while asking.recv(4096):  # until the server has closed it, too
                pass
        with socket.socket() as other, pytest.raises(OSError, match="refused"):
            other.connect(("127.0.0.2", server.get_port()))
    finally:
        server.stop()


def test_an_address_of_another_machine_is_refused() -> None:
    with pytest.raises(ValueError, match=r"'192\.0\.2\.1' is not an address of this machine"):
        open_server("192.0.2.1", 0)


def test_the_next_free_port_is_used_and_without_one_the_server_is_refused() -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        server = open_server("127.0.0.1", port)
        try:
            assert server.get_port() > port
        finally:
            server.stop()
    with pytest.raises(ValueError, match="port from 70000"):
        open_server("127.0.0.1", 70000)


def test_a_client_that_is_no_page_is_told_and_prints_no_traceback(
    caplog: pytest.LogCaptureFixture, capfd: pytest.CaptureFixture[str]
) -> None:
    import msgspec
    import viser
    import zstandard
    from websockets.exceptions import ConnectionClosed
    from websockets.sync.client import connect

    server, pressed = open_server("127.0.0.1", 0), []
    try:
        server.gui.add_button("Reward").on_click(pressed.append)
        (uuid,) = server.gui._gui_input_handle_from_uuid
        address = f"ws://127.0.0.1:{server.get_port()}"
        protocol = [f"viser-v{viser.__version__}"]
        press = {"type": "GuiUpdateMessage", "uuid": uuid, "updates": {"value": True}}
        with connect(address, subprotocols=protocol, max_size=None) as client:
            client.send(msgspec.msgpack.encode(press))
            said = b""
            while b"must send its camera first" not in said:
                frame = client.recv(timeout=20.0)
                said = zstandard.decompress(frame[16 : 16 + int.from_bytes(frame[8:16], "little")])
        bad = [b"", b"\x00", b"{", {"type": "no such"}, {"updates": {}}, {**press, "updates": 3}]
        bad += [{**press, "updates": {"nothing": 1}}]
        for message in bad:
            with connect(address, subprotocols=protocol, max_size=None) as client:
                raw = isinstance(message, bytes)
                client.send(message if raw else msgspec.msgpack.encode(message))
                with suppress(ConnectionClosed, TimeoutError):
                    while True:
                        client.recv(timeout=0.3)
    finally:
        close(server)
    out, err = capfd.readouterr()
    assert "Traceback" not in out + err and not any(r.exc_info for r in caplog.records)
    assert not pressed and "stopped" not in out
    assert sum("ignored" in r.getMessage() for r in caplog.records) >= 1
