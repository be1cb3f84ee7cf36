"""Prometheus' remote write 1.0 as a client: samples with any stamps, as an agent sends them after an outage."""

from __future__ import annotations

import base64
import struct
import urllib.error
import urllib.request
from typing import Iterable, Mapping, Tuple

Samples = Iterable[Tuple[float, float]]
"""Times in s since 1970, and values."""


def _varint(number: int) -> bytes:
    written = b""
    while number > 127:
        written += bytes([number & 127 | 128])
        number >>= 7
    return written + bytes([number])


def _field(number: int, data: bytes) -> bytes:
    return _varint(number << 3 | 2) + _varint(len(data)) + data


def time_series(labels: Mapping[str, str], samples: Samples) -> bytes:
    """Returns a TimeSeries of prompb."""
    names = [_field(1, name.encode()) + _field(2, value.encode()) for name, value in sorted(labels.items())]
    found = b"".join(_field(1, name) for name in names)
    for time_s, value in samples:
        found += _field(2, b"\x09" + struct.pack("<d", value) + b"\x10" + _varint(round(time_s * 1000.0)))
    return _field(1, found)


def _snappy(data: bytes) -> bytes:
    """Returns the block format of Snappy, with literals only."""
    pieces = [data[begin : begin + 60] for begin in range(0, len(data), 60)]
    return _varint(len(data)) + b"".join(bytes([len(piece) - 1 << 2]) + piece for piece in pieces)


def remote_write(port: int, password: str, *series: bytes) -> int:
    """Sends series to a receiver on this machine; returns the status of its answer."""
    headers = {
        "Authorization": f"Basic {base64.b64encode(f'robots:{password}'.encode()).decode()}",
        "Content-Encoding": "snappy",
        "Content-Type": "application/x-protobuf",
        "X-Prometheus-Remote-Write-Version": "0.1.0",
    }
    url = f"http://127.0.0.1:{port}/api/v1/write"
    request = urllib.request.Request(url, data=_snappy(b"".join(series)), headers=headers)
    try:
        with urllib.request.build_opener(urllib.request.ProxyHandler({})).open(request, timeout=30.0) as answer:
            return int(answer.status)
    except urllib.error.HTTPError as error:
        return error.code
