# SPDX-License-Identifier: Apache-2.0
"""Messages between two processes of one machine: a few values as JSON, and arrays of any size.

The arrays are in shared memory whose file descriptor is sent with the message. The receiver maps
them, which takes the same short time for any size and copies nothing.
"""

from __future__ import annotations

import io
import json
import math
import mmap
import os
import socket
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

MESSAGE_MAX = 65536  # size of a message without its arrays [byte]


class Message(NamedTuple):
    """A message; its values are those of JSON."""

    values: dict[str, Any]
    arrays: dict[str, np.ndarray]  # float64, read-only


class Channel:
    """One end of a connection between two processes; `pair` makes both ends.

    If its socket is non-blocking, so are `send` and `receive`.
    """

    def __init__(self, end: socket.socket) -> None:
        self._socket = end

    def send(
        self, values: Mapping[str, object], arrays: Mapping[str, np.ndarray] | None = None
    ) -> io.FileIO | None:
        """Send a message; returns the shared memory of its arrays, None without any.

        If the caller keeps it until the receiver has released the arrays, the memory is freed in
        this process, not in the receiver.

        Raises:
            BlockingIOError: The other process has not read the messages before.
            OSError: The other process has ended; or there is no memory for the arrays.
            ValueError: The values take more than MESSAGE_MAX bytes.
        """
        shapes = {name: array.shape for name, array in (arrays or {}).items()}
        data = json.dumps([values, shapes]).encode()
        if len(data) > MESSAGE_MAX:
            raise ValueError(f"message of {len(data)} bytes; at most {MESSAGE_MAX} allowed")
        if not arrays:
            self._socket.send(data)
            return None
        shared = io.FileIO(os.memfd_create("arrays"), "r+")
        for array in arrays.values():
            shared.write(np.ascontiguousarray(array, dtype=np.float64).tobytes())
        socket.send_fds(self._socket, [data], [shared.fileno()])
        return shared

    def receive(self) -> Message | None:
        """Receive the next message; None if there is none yet and the socket is non-blocking.

        Raises:
            EOFError: The other process has ended, and all its messages have been received.
            MemoryError: The arrays cannot be mapped; the message is lost.
        """
        try:
            data, descriptors, _, _ = socket.recv_fds(self._socket, MESSAGE_MAX, 1)
        except BlockingIOError:
            return None
        except ConnectionResetError:  # raised once, if it ended without reading all messages
            return self.receive()
        if not data:
            raise EOFError("the other process has ended")
        values, shapes = json.loads(data)
        if not descriptors:
            return Message(values, {})
        try:
            memory = mmap.mmap(descriptors[0], 0, prot=mmap.PROT_READ)
        except OSError as error:
            raise MemoryError(f"arrays {shapes} cannot be mapped: {error}") from None
        finally:
            os.close(descriptors[0])
        ends = np.cumsum([math.prod(shape) for shape in shapes.values()])
        parts = zip(shapes.items(), np.split(np.frombuffer(memory), ends[:-1]), strict=True)
        return Message(values, {name: part.reshape(shape) for (name, shape), part in parts})

    def fileno(self) -> int:
        """File descriptor of the socket."""
        return self._socket.fileno()

    def close(self) -> None:
        """End the connection; the other process still receives what was sent."""
        self._socket.close()


def pair() -> tuple[Channel, Channel]:
    """The two ends of a connection: the first does not block, the second does."""
    one, other = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    one.setblocking(False)
    return Channel(one), Channel(other)
