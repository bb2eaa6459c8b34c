# SPDX-License-Identifier: Apache-2.0
"""The two messages of the 500 Hz loop as they travel, without rclpy's detour through objects.

To make a JointState of the bytes that came costs rclpy more than the control step takes, and bytes
of a torque half of that. So the loop takes and gives bytes. It knows no more of the format (CDR)
than it has checked: rclpy reads the first message of every shape and writes the first with every
label; only while all but the numbers stays the same are they read and written in place.
"""

from __future__ import annotations

import struct

import numpy as np
from rclpy.serialization import deserialize_message, serialize_message
from sensor_msgs.msg import JointState

from wam_power_ros.ros.joint_messages import JointReading, JointStateReader, TorqueWriter

_ORIGIN = 4  # where the message begins, behind two bytes that tell its encoding and two of options
_STAMP = struct.Struct("=iI")
_DIGITS = _ORIGIN + 8  # where the label of a torque begins, and with it the stamp in digits


class StateReader:
    """Serialised JointState -> what a `JointStateReader` makes of it.

    Args:
        reader: Reads whatever has a new shape.
    """

    def __init__(self, reader: JointStateReader) -> None:
        self._reader = reader
        self._layout: _Layout | None = None  # of the last message with our joints

    def __call__(self, data: bytes) -> JointReading | None:
        """Read one message; see `JointStateReader`.

        Raises:
            ValueError: as there, and for bytes that are no JointState.
        """
        numbers = None if self._layout is None else self._layout.numbers(data)
        if numbers is not None:
            return self._reader.reading(*numbers)
        try:
            message = deserialize_message(data, JointState)
        except Exception as error:  # of a kind that rclpy does not export
            raise ValueError(f"{len(data)} bytes are no JointState: {error}") from None
        known, self._layout = self._layout, None  # none if it is refused now: the names may be new
        reading = self._reader(message)
        if reading is None:
            self._layout = known
        elif (layout := _Layout(message, data)).reads(data, message):
            self._layout = layout
        return reading


class _Layout:
    """Where the numbers are in messages that share everything else with this one.

    Args:
        message: That was read.
        data: Its bytes.
    """

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
        """How many there are, and where."""
        self._count(count)
        if count:
            self._pad(8)
        at = self._size
        self._format, self._size = f"{self._format}{8 * count}x", at + 8 * count
        return count, at

    def _pad(self, alignment: int) -> None:
        gap = (_ORIGIN - self._size) % alignment  # what is there differs: nobody clears it
        self._format, self._size = f"{self._format}{gap}x", self._size + gap

    def numbers(self, data: bytes) -> tuple[int, np.ndarray, np.ndarray | None] | None:
        """Stamp [ns], positions and velocities (None without); None when it is not our layout."""
        if len(data) < self._size:  # longer it may be: nobody trims it either
            return None
        encoding, sec, nanosec, *fixed = self._struct.unpack_from(data)
        if [encoding, *fixed] != self._fixed:
            return None
        q, qd = (np.frombuffer(data, float, *where) for where in (self._q, self._qd))
        return sec * 1_000_000_000 + nanosec, q, qd if len(qd) else None

    def reads(self, data: bytes, message: JointState) -> bool:
        """Whether a message comes out with the numbers that rclpy has found in it."""
        numbers = self.numbers(data)
        if numbers is None:
            return False
        _, q, qd = numbers
        found = [q.tobytes(), b"" if qd is None else qd.tobytes()]
        return found == [message.position.tobytes(), message.velocity.tobytes()]


class TorqueSender:
    """Torques of doubles -> what a `TorqueWriter` makes of them, serialised.

    Args:
        writer: Writes the first with every label.
    """

    def __init__(self, writer: TorqueWriter) -> None:
        self._writer = writer
        self._in_header = writer.message_type is JointState
        self._bytes = bytearray()  # of the last message
        self._at = 0  # where its torques are
        self._label, self._digits = "", 0  # and how many digits its stamp had

    def __call__(self, stamp_ns: int, label: str, tau: np.ndarray) -> bytes:
        """One message with tau (nj,) [N m]; see `TorqueWriter`."""
        data, digits, numbers = self._bytes, str(stamp_ns).encode(), tau.tobytes()
        if label != self._label or len(digits) != self._digits:
            found = np.arange(1.0, len(tau) + 1.0)  # numbers that are nowhere else
            data[:] = serialize_message(self._writer(stamp_ns, label, found))
            self._at = data.index(found.tobytes())
            self._label, self._digits = label, len(digits)
        if self._in_header:
            _STAMP.pack_into(data, _ORIGIN, *divmod(stamp_ns, 1_000_000_000))
        else:
            data[_DIGITS : _DIGITS + len(digits)] = digits
        data[self._at : self._at + len(numbers)] = numbers
        return bytes(data)
