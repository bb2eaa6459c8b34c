# SPDX-License-Identifier: Apache-2.0
"""Plain data from JSON that somebody may have been given; large, deep or ambiguous JSON is refused.

The limits are those of `plain_yaml`. Python's own reader ends with a RecursionError in deep JSON,
reads 1e400 as infinity, and silently keeps the last of two equal keys.
"""

from __future__ import annotations

import json
import math
import re
from pathlib import Path
from typing import Any

from wam_power_ros import durable_files

SIZE_MAX = 1_000_000  # largest text [byte]
DEPTH_MAX = 20  # largest number of nested levels
INTEGER_MAX = 2**128  # the largest are states of NumPy's generators in session logs
# Strings, also an unterminated one, so that the time is linear in the size; then the brackets.
_BRACKETS = re.compile(r'"[^"\\]*(?:\\.?[^"\\]*)*(?:"|\Z)|([\[{])|([\]}])', re.DOTALL)


def read(file: Path, size_max: int = SIZE_MAX) -> Any:  # noqa: ANN401 - JSON is any of its types
    """Return the data in a JSON file.

    Raises:
        ValueError: As for `parse`, or it is not a regular file; the message names the file.
    """
    durable_files.check_regular(file)
    if (size := file.stat().st_size) > size_max:
        raise ValueError(f"{file} has {size} bytes; at most {size_max} are allowed")
    return parse(file.read_bytes(), str(file), size_max)


def parse(text: str | bytes, where: str, size_max: int = SIZE_MAX) -> Any:  # noqa: ANN401
    """Return the data in JSON text.

    Args:
        text: Text, as bytes in UTF-8.
        where: Origin of the text, for messages.
        size_max: Largest size [byte].

    Raises:
        ValueError: It is too large, nested too deeply, has a key twice in one object or a number
            that is not finite or beyond 128 bits, or is not JSON; the message names its origin.
    """
    try:
        decoded = text.decode() if isinstance(text, bytes) else text
        size = len(text) if isinstance(text, bytes) else len(text.encode(errors="surrogatepass"))
    except UnicodeDecodeError as error:
        raise ValueError(f"{where} is not JSON: {error}") from None
    if size > size_max:
        raise ValueError(f"{where} has {size} bytes; at most {size_max} are allowed")
    depth = 0
    for bracket in _BRACKETS.finditer(decoded):
        depth += bracket.lastindex == 1
        depth -= bracket.lastindex == 2
        if depth > DEPTH_MAX:
            raise ValueError(f"{where} is nested deeper than {DEPTH_MAX} levels")
    try:
        return json.loads(
            decoded,
            object_pairs_hook=_unique,
            parse_constant=_refuse_constant,
            parse_float=_finite,
            parse_int=_integer,
        )
    except (ValueError, RecursionError) as error:
        raise ValueError(f"{where} is not JSON: {error}") from None


def _unique(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    found = dict(pairs)
    if len(found) != len(pairs):
        keys = [key for key, _ in pairs]
        repeated = next(key for key in keys if keys.count(key) > 1)
        raise ValueError(f"key {repeated[:80]!r} appears twice")
    return found


def _refuse_constant(name: str) -> float:
    raise ValueError(f"{name} is not a finite number")


def _finite(text: str) -> float:
    if not math.isfinite(number := float(text)):
        raise ValueError(f"{text[:40]} is not a finite number")
    return number


def _integer(text: str) -> int:
    if len(text) > 40 or abs(number := int(text)) > INTEGER_MAX:
        raise ValueError(f"{text[:40]} is beyond 128 bits")
    return number
