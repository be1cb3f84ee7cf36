from __future__ import annotations

import base64
import struct
import zlib

import pytest
from hypothesis import given
from hypothesis import strategies as st

from robot_health_monitor.rosbridge.protocol.png import encode_png


def decode(data: str) -> str:
    """Reads the text as roslibjs does, by the PNG specification: signature, chunks with CRC, rows with filter 0."""
    file = base64.b64decode(data, validate=True)
    assert file[:8] == b"\x89PNG\r\n\x1a\n"
    chunks = {}
    position = 8
    while position < len(file):
        (length,) = struct.unpack_from(">I", file, position)
        kind, body = file[position + 4 : position + 8], file[position + 8 : position + 8 + length]
        assert struct.unpack_from(">I", file, position + 8 + length) == (zlib.crc32(kind + body),)
        chunks[kind] = body
        position += 12 + length
    assert list(chunks) == [b"IHDR", b"IDAT", b"IEND"]
    width, height, *form = struct.unpack(">IIBBBBB", chunks[b"IHDR"])
    assert form == [8, 2, 0, 0, 0]  # 8 bits per sample, RGB, not interlaced
    rows = zlib.decompress(chunks[b"IDAT"])
    stride = 1 + 3 * width
    assert len(rows) == stride * height
    assert set(rows[::stride]) == {0}
    pixels = b"".join(rows[start + 1 : start + stride] for start in range(0, len(rows), stride))
    return pixels.decode().rstrip("\n")


@given(st.text())
def test_the_image_contains_the_text_and_line_feeds_at_its_end(text: str) -> None:
    text = text.encode("utf-8", "ignore").decode()
    assert decode(encode_png(text)) == text.rstrip("\n")


@pytest.mark.parametrize("length", [0, 1, 2, 3, 299, 300, 301, 1_000_000])
def test_every_length_fits(length: int) -> None:
    assert decode(encode_png("x" * length)) == "x" * length
