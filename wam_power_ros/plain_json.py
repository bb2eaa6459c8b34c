# SPDX-License-Identifier: Apache-2.0
"""Plain data from JSON that somebody may have been given; large, deep or ambiguous JSON is refused.

The limits are those of `plain_yaml`. Python's own reader ends with a RecursionError in deep JSON,
reads 1e400 as infinity, and silently keeps the last of two equal keys.
"""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

from wam_power_ros import durable_files

SIZE_MAX = 1_000_000  # largest text [byte]
DEPTH_MAX = 20  # largest number of nested levels
INTEGER_MAX = 2**128  # the largest are states of NumPy's generators in session logs


def read(file: Path, size_max: int = SIZE_MAX) -> Any:  # noqa: ANN401 - JSON is any of its types
    """Return the data in a JSON file.

    Raises:
        ValueError: As for `parse`, or it is not a regular file; the message names the file.
    """
    return parse(durable_files.read(file, size_max), str(file), size_max)


def parse(text: str | bytes, where: str, size_max: int = SIZE_MAX) -> Any:  # noqa: ANN401
    """Return the data in JSON text, as bytes in UTF-8; `where` is its origin, for messages.

    Raises:
        ValueError: It has more than `size_max` bytes, is nested too deeply, has a key twice in one
            object or a number that is not finite or beyond 128 bits, or is not JSON.
    """
    size = len(text if isinstance(text, bytes) else text.encode(errors="surrogatepass"))
    if size > size_max:
        raise ValueError(f"{where} has {size} bytes; at most {size_max} are allowed")
    try:
        data = json.loads(
            text.decode() if isinstance(text, bytes) else text,
            object_pairs_hook=_unique,
            parse_constant=_finite,
            parse_float=_finite,
            parse_int=_integer,
        )
        deep = _is_deeper(data, DEPTH_MAX)
    except ValueError as error:
        raise ValueError(f"{where} is not JSON: {error}") from None
    except RecursionError:
        deep = True
    if deep:
        raise ValueError(f"{where} is nested deeper than {DEPTH_MAX} levels")
    return data


def _is_deeper(data: object, levels: int) -> bool:
    """Whether data has more than this number of nested levels."""
    if not isinstance(data, dict | list):
        return False
    values = data.values() if isinstance(data, dict) else data
    return levels == 0 or any(_is_deeper(value, levels - 1) for value in values)


def _unique(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    found = dict(pairs)
    if len(found) != len(pairs):
        keys = [key for key, _ in pairs]
        repeated = next(key for key in keys if keys.count(key) > 1)
        raise ValueError(f"key {repeated[:80]!r} appears twice")
    return found


def _finite(text: str) -> float:
    if not math.isfinite(number := float(text)):
        raise ValueError(f"{text[:40]} is not a finite number")
    return number


def _integer(text: str) -> int:
    if len(text) > 40 or abs(number := int(text)) > INTEGER_MAX:
        raise ValueError(f"{text[:40]} is beyond 128 bits")
    return number
