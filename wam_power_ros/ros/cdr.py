# SPDX-License-Identifier: Apache-2.0
"""Serialised messages of the 500 Hz loop, read and written in place.

rclpy takes longer to deserialise a JointState than the control step, and half of that to serialise
a torque. So the loop works on the bytes (CDR), and assumes nothing of the format that it has not
checked: rclpy reads the first message of every layout and writes the first with every label; the
numbers are read and written in place only while all other bytes stay the same.
"""

from __future__ import annotations

import struct

import numpy as np
from rclpy.serialization import deserialize_message, serialize_message
from sensor_msgs.msg import JointState

from wam_power_ros.ros.joint_messages import JointReading, JointStateReader, TorqueWriter

_ORIGIN = 4  # offset of the message, after two bytes of encoding and two of options
_STAMP = struct.Struct("=iI")
_DIGITS = _ORIGIN + 8  # offset of a torque's label, which begins with the stamp in digits


class StateReader:
    """Serialised JointState -> reading of a `JointStateReader`, which reads every new layout."""

    def __init__(self, reader: JointStateReader) -> None:
        self._reader = reader
        self._layout: _Layout | None = None  # of the last message that held our joints

    def __call__(self, data: bytes) -> JointReading | None:
        """Read one message; see `JointStateReader`.

        Raises:
            ValueError: As there, and for bytes that are not a JointState.
        """
        numbers = None if self._layout is None else self._layout.numbers(data)
        if numbers is not None:
            return self._reader.reading(*numbers)
        try:
            message = deserialize_message(data, JointState)
        except Exception as error:  # of a kind that rclpy does not export
            raise ValueError(f"{len(data)} bytes are not a JointState: {error}") from None
        known, self._layout = (
            self._layout,
            None,
        )  # None if this one is refused: its names may be new
        reading = self._reader(message)
        if reading is None:
            self._layout = known
        elif (layout := _Layout(message, data)).reads(data, message):
            self._layout = layout
        return reading


class _Layout:
    """Offsets of the numbers in messages that equal this one, of bytes `data`, in all else."""

    def __init__(self, message: JointState, data: bytes) -> None:
        self._format, self._size = "=2s2xiI", _ORIGIN + _STAMP.size
        self._fixed: list[object] = [data[:2]]  # all that is neither stamp nor numbers
        self._text(message.header.frame_id)
        self._count(len(message.name))
        for name in message.name:
            self._text(name)
        self._q = self._doubles(len(message.position))
        self._qd = self._doubles(len(message.velocity))
        self._doubles(len(message.effort))
        self._struct = struct.Struct(self._format)

    def _count(self, count: int) -> None:
        self._pad(4)
        self._format, self._size = self._format + "I", self._size + 4
        self._fixed.append(count)

    def _text(self, text: str) -> None:
        coded = text.encode() + b"\0"
        self._count(len(coded))
        self._format, self._size = f"{self._format}{len(coded)}s", self._size + len(coded)
        self._fixed.append(coded)

    def _doubles(self, count: int) -> tuple[int, int]:
        """Append an array of doubles; returns its length and offset."""
        self._count(count)
        if count:
            self._pad(8)
        at = self._size
        self._format, self._size = f"{self._format}{8 * count}x", at + 8 * count
        return count, at

    def _pad(self, alignment: int) -> None:
        gap = (_ORIGIN - self._size) % alignment  # padding is not cleared by senders
        self._format, self._size = f"{self._format}{gap}x", self._size + gap

    def numbers(self, data: bytes) -> tuple[int, np.ndarray, np.ndarray | None] | None:
        """Stamp [ns], positions, and velocities or None; None when the layout differs."""
        if len(data) < self._size:  # it may be longer, for senders do not trim it
            return None
        encoding, sec, nanosec, *fixed = self._struct.unpack_from(data)
        if [encoding, *fixed] != self._fixed:
            return None
        q, qd = (np.frombuffer(data, float, *where) for where in (self._q, self._qd))
        return sec * 1_000_000_000 + nanosec, q, qd if len(qd) else None

    def reads(self, data: bytes, message: JointState) -> bool:
        """Whether the numbers equal those that rclpy has read."""
        numbers = self.numbers(data)
        if numbers is None:
            return False
        _, q, qd = numbers
        found = [q.tobytes(), b"" if qd is None else qd.tobytes()]
        return found == [message.position.tobytes(), message.velocity.tobytes()]


class TorqueSerializer:
    """Torques -> serialised message of a `TorqueWriter`, which writes the first of every label."""

    def __init__(self, writer: TorqueWriter) -> None:
        self._writer = writer
        self._in_header = writer.message_type is JointState
        self._bytes = bytearray()  # of the last message
        self._at = 0  # offset of its torques
        self._label, self._digits = "", 0  # number of digits of its stamp

    def __call__(self, stamp_ns: int, label: str, tau: np.ndarray) -> bytes:
        """Serialise one message with tau (nj,) [N m]; see `TorqueWriter`."""
        data, digits, numbers = self._bytes, str(stamp_ns).encode(), tau.tobytes()
        if label != self._label or len(digits) != self._digits:
            found = np.arange(1.0, len(tau) + 1.0)  # numbers that occur nowhere else
            data[:] = serialize_message(self._writer(stamp_ns, label, found))
            self._at = data.index(found.tobytes())
            self._label, self._digits = label, len(digits)
        if self._in_header:
            _STAMP.pack_into(data, _ORIGIN, *divmod(stamp_ns, 1_000_000_000))
        else:
            data[_DIGITS : _DIGITS + len(digits)] = digits
        data[self._at : self._at + len(numbers)] = numbers
        return bytes(data)
