"""Text as a PNG picture: rosbridge's compression `png`, which is zlib in a picture's clothes.

The bytes of the text, padded with line feeds, are the pixels of an RGB image of about equal sides; the file is
base64. Written here in full because a robot should not need an imaging library for it: 8 bits per sample, RGB, not
interlaced, which is what rosbridge peers send.
"""

from __future__ import annotations

import base64
import binascii
import math
import struct
import zlib
from typing import Iterator, Tuple

from .errors import ProtocolError

_SIGNATURE = b"\x89PNG\r\n\x1a\n"
_HEADER = struct.Struct(">IIBBBBB")
_BYTES_PER_PIXEL = 3


def encode_png(text: str) -> str:
    """Returns `text` as a base64 PNG file."""
    data = text.encode("utf-8")
    width = max(1, math.isqrt(len(data) // _BYTES_PER_PIXEL))
    stride = width * _BYTES_PER_PIXEL
    height = max(1, -(-len(data) // stride))
    data = data.ljust(stride * height, b"\n")
    rows = b"".join(b"\0" + data[start : start + stride] for start in range(0, len(data), stride))
    header = _HEADER.pack(width, height, 8, 2, 0, 0, 0)
    chunks = _chunk(b"IHDR", header) + _chunk(b"IDAT", zlib.compress(rows)) + _chunk(b"IEND", b"")
    return base64.b64encode(_SIGNATURE + chunks).decode("ascii")


def decode_png(data: str, largest: int) -> str:
    """Returns the text in a base64 PNG file, without its padding.

    Args:
        data: the file.
        largest: bound of the unpacked size, in bytes.

    Raises:
        ProtocolError: it is no such picture, or unpacks to more than `largest`.
    """
    try:
        file = base64.b64decode(data, validate=True)
    except (binascii.Error, ValueError):
        raise ProtocolError("the picture is not base64", "png") from None
    header = b""
    packed = b""
    for kind, body in _chunks(file):
        if kind == b"IHDR":
            header = body
        elif kind == b"IDAT":
            packed += body
    width, height = _size(header)
    stride = width * _BYTES_PER_PIXEL
    expected = (stride + 1) * height
    if width * height == 0 or expected > largest + height + stride:
        raise ProtocolError(f"a picture of {width} x {height} is not between 1 and {largest} bytes", "png")
    unpacker = zlib.decompressobj()
    try:
        rows = unpacker.decompress(packed, expected)
    except zlib.error:
        raise ProtocolError("the picture's data are broken", "png") from None
    if len(rows) != expected:
        raise ProtocolError("the picture's data are not as long as its size says", "png")
    pixels = _unfilter(rows, stride)
    try:
        return pixels.decode("utf-8").rstrip("\n")
    except UnicodeDecodeError:
        raise ProtocolError("the picture does not hold UTF-8", "png") from None


def _chunk(kind: bytes, body: bytes) -> bytes:
    return struct.pack(">I", len(body)) + kind + body + struct.pack(">I", zlib.crc32(kind + body))


def _chunks(file: bytes) -> Iterator[Tuple[bytes, bytes]]:
    if not file.startswith(_SIGNATURE):
        raise ProtocolError("the picture is not a PNG file", "png")
    at = len(_SIGNATURE)
    while at + 12 <= len(file):
        length = int.from_bytes(file[at : at + 4], "big")
        yield file[at + 4 : at + 8], file[at + 8 : at + 8 + length]
        at += 12 + length


def _size(header: bytes) -> Tuple[int, int]:
    if len(header) != _HEADER.size:
        raise ProtocolError("the picture has no header", "png")
    width, height, *form = _HEADER.unpack(header)
    if form != [8, 2, 0, 0, 0]:
        raise ProtocolError("the picture is not 8-bit RGB without interlacing", "png")
    return width, height


def _unfilter(rows: bytes, stride: int) -> bytes:
    """Undoes the five row filters of the PNG specification (section 9, Filtering)."""
    pixels = bytearray()
    above = bytes(stride)
    for start in range(0, len(rows), stride + 1):
        kind = rows[start]
        row = bytearray(rows[start + 1 : start + 1 + stride])
        if kind == 2:
            row = bytearray((value + up) & 255 for value, up in zip(row, above))
        elif kind != 0:
            _unfilter_row(kind, row, above)
        pixels += row
        above = bytes(row)
    return bytes(pixels)


def _unfilter_row(kind: int, row: bytearray, above: bytes) -> None:
    if kind not in (1, 3, 4):
        raise ProtocolError(f"the picture uses the unknown filter {kind}", "png")
    for index in range(len(row)):
        inside = index >= _BYTES_PER_PIXEL
        left = row[index - _BYTES_PER_PIXEL] if inside else 0
        up = above[index]
        if kind == 1:
            guess = left
        elif kind == 3:
            guess = (left + up) // 2
        else:
            guess = _paeth(left, up, above[index - _BYTES_PER_PIXEL] if inside else 0)
        row[index] = (row[index] + guess) & 255


def _paeth(left: int, up: int, corner: int) -> int:
    estimate = left + up - corner
    distances = abs(estimate - left), abs(estimate - up), abs(estimate - corner)
    nearest = min(distances)
    return (left, up, corner)[distances.index(nearest)]
