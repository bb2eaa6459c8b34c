# SPDX-License-Identifier: Apache-2.0
"""Serialised messages of the 500 Hz loop, read and written in place.

Deserialising a JointState with rclpy takes longer than the control step, and serialising a torque
half as long. So the loop works on the bytes (CDR) and checks what it assumes of their format: rclpy
reads the first message of every layout and writes the first with every label; the numbers are read
and written in place only while all other bytes stay the same.
"""

from __future__ import annotations

import struct

import numpy as np
from geometry_msgs.msg import PoseStamped
from rclpy.serialization import deserialize_message, serialize_message
from sensor_msgs.msg import JointState
from trajectory_msgs.msg import JointTrajectory

from wam_power_ros.ros.joint_messages import JointReading, JointStateReader, TorqueWriter

_ORIGIN = 4  # offset of the message, after two bytes of encoding and two of options
_STAMP = struct.Struct("=iI")
_LABEL_OFFSET = _ORIGIN + 8  # of a torque, whose label begins with the stamp in digits
_FRAME_OFFSET = _ORIGIN + _STAMP.size + 4  # of the same in a trajectory


class StateReader:
    """Serialised JointState -> reading; a `JointStateReader` reads the first of every layout."""

    def __init__(self, reader: JointStateReader) -> None:
        self._reader = reader
        self._layout: _Layout | None = None  # of the last message with our joints

    def __call__(self, data: bytes) -> JointReading | None:
        """Read one message like `JointStateReader`; bytes that are none are a ValueError."""
        numbers = None if self._layout is None else self._layout.numbers(data)
        if numbers is not None:
            return self._reader.reading(*numbers)
        try:
            message = deserialize_message(data, JointState)
        except Exception as error:  # of a type that rclpy does not export
            raise ValueError(f"{len(data)} bytes are not a JointState: {error}") from None
        previous = self._layout
        self._layout = None  # stays None if the message is refused: its names may be new
        reading = self._reader(message)
        if reading is None:
            self._layout = previous
        elif (layout := _Layout(message, data)).matches(data, message):
            self._layout = layout
        return reading


class _Layout:
    """Offsets of the numbers in all messages whose other bytes equal those of one message."""

    def __init__(self, message: JointState, data: bytes) -> None:
        self._format, self._size = "=2s2xiI", _ORIGIN + _STAMP.size
        self._fixed: list[object] = [data[:2]]  # all values but the stamp and the numbers
        self._add_text(message.header.frame_id)
        self._add_count(len(message.name))
        for name in message.name:
            self._add_text(name)
        self._q = self._add_doubles(len(message.position))
        self._qd = self._add_doubles(len(message.velocity))
        self._add_doubles(len(message.effort))
        self._struct = struct.Struct(self._format)

    def _add(self, code: str, size: int, alignment: int) -> int:
        """Append a field, after a gap of any content, and return its offset."""
        gap = (_ORIGIN - self._size) % alignment
        self._format, offset = f"{self._format}{gap}x{code}", self._size + gap
        self._size = offset + size
        return offset

    def _add_count(self, count: int) -> None:
        self._add("I", 4, 4)
        self._fixed.append(count)

    def _add_text(self, text: str) -> None:
        encoded = text.encode() + b"\0"
        self._add_count(len(encoded))
        self._add(f"{len(encoded)}s", len(encoded), 1)
        self._fixed.append(encoded)

    def _add_doubles(self, count: int) -> tuple[int, int]:
        """Append an array of doubles; returns its length and offset."""
        self._add_count(count)
        return count, self._add(f"{8 * count}x", 8 * count, 8 if count else 1)

    def numbers(self, data: bytes) -> tuple[int, np.ndarray, np.ndarray | None] | None:
        """Stamp [ns], positions, and velocities or None; None when the layout differs."""
        if len(data) < self._size:  # longer is allowed: senders do not trim messages
            return None
        encoding, sec, nanosec, *fixed = self._struct.unpack_from(data)
        if [encoding, *fixed] != self._fixed:
            return None
        q, qd = (np.frombuffer(data, float, *where) for where in (self._q, self._qd))
        return sec * 1_000_000_000 + nanosec, q, qd if len(qd) else None

    def matches(self, data: bytes, message: JointState) -> bool:
        """Return True if the numbers equal those that rclpy has read."""
        numbers = self.numbers(data)
        if numbers is None:
            return False
        _, q, qd = numbers
        found = [q.tobytes(), b"" if qd is None else qd.tobytes()]
        return found == [message.position.tobytes(), message.velocity.tobytes()]


class TorqueSerializer:
    """Torques -> serialised message; a `TorqueWriter` writes the first with every label."""

    def __init__(self, writer: TorqueWriter) -> None:
        self._writer = writer
        self._in_header = writer.message_type in (JointState, PoseStamped)
        trajectory = writer.message_type is JointTrajectory
        self._label_offset = _FRAME_OFFSET if trajectory else _LABEL_OFFSET
        self._bytes = bytearray()  # the last message
        self._tau_offset = 0
        self._label, self._digit_count = "", 0  # of the stamp in the last message

    def __call__(self, stamp_ns: int, label: str, tau: np.ndarray) -> bytes:
        """Serialise one message with tau (nj,) [N m]; see `TorqueWriter`."""
        data, digits, numbers = self._bytes, str(stamp_ns).encode(), tau.tobytes()
        if label != self._label or len(digits) != self._digit_count:
            pattern = np.arange(1.0, len(tau) + 1.0)  # bytes that occur nowhere else
            data[:] = serialize_message(self._writer(stamp_ns, label, pattern))
            self._tau_offset = data.index(pattern.tobytes())
            self._label, self._digit_count = label, len(digits)
        if self._in_header:
            _STAMP.pack_into(data, _ORIGIN, *divmod(stamp_ns, 1_000_000_000))
        else:
            data[self._label_offset : self._label_offset + len(digits)] = digits
        data[self._tau_offset : self._tau_offset + len(numbers)] = numbers
        return bytes(data)
