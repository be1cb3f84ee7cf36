from __future__ import annotations

import base64
import struct
import zlib

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from robot_health_monitor.rosbridge.protocol.errors import ProtocolError
from robot_health_monitor.rosbridge.protocol.png import decode_png, encode_png

# What Pillow, the imaging library of the reference server, makes of this text; its rows use the filters Sub and Up.
TEXT = '{"op":"publish","topic":"/battery_level","msg":{"data":19.5}}'
FROM_PILLOW = (
    "iVBORw0KGgoAAAANSUhEUgAAAAQAAAAGCAIAAABrW6giAAAAUUlEQVR4nGOsVsr/ynB6k5+1w58vTD/cNu9hsPJl+MK47SKjkn6SvasQyz/WX7/e"
    "MIWYcR3csY6D8d3hc2JMa/5/DTJlOLvvEs9vJoZaLgQAACCdHfFj2cS9AAAAAElFTkSuQmCC"
)


def picture(rows: bytes, width: int, height: int, form: bytes = bytes([8, 2, 0, 0, 0])) -> str:
    def chunk(kind: bytes, body: bytes) -> bytes:
        return struct.pack(">I", len(body)) + kind + body + struct.pack(">I", zlib.crc32(kind + body))

    header = struct.pack(">II", width, height) + form
    file = b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", header) + chunk(b"IDAT", zlib.compress(rows)) + chunk(b"IEND", b"")
    return base64.b64encode(file).decode()


@given(st.text())
def test_any_text_comes_back_but_for_line_feeds_at_its_end(text: str) -> None:
    text = text.encode("utf-8", "ignore").decode()
    assert decode_png(encode_png(text), 1_000_000) == text.rstrip("\n")


def test_the_reference_servers_pictures_are_read() -> None:
    assert decode_png(FROM_PILLOW, 1_000_000) == TEXT


def test_the_five_filters_of_the_specification_are_undone() -> None:
    """One row per filter; each is the text `abcdef` after the filter's formula, worked out by hand."""
    plain = b"abcdef"
    rows = b"\x00" + plain
    rows += b"\x01" + b"abc" + bytes([3, 3, 3])  # minus the pixel on the left
    rows += b"\x02" + bytes(6)  # minus the pixel above
    rows += b"\x03" + bytes([97 - 48, 98 - 49, 99 - 49]) + bytes([100 - 98, 101 - 99, 102 - 100])  # minus the mean
    rows += b"\x04" + bytes(3) + bytes([0, 0, 0])  # minus Paeth's choice, which is the pixel above
    assert decode_png(picture(rows, 2, 5), 1000) == "abcdef" * 5


@pytest.mark.parametrize(
    ("data", "problem"),
    [
        ("no base64!", "not base64"),
        (base64.b64encode(b"GIF89a").decode(), "not a PNG"),
        (base64.b64encode(b"\x89PNG\r\n\x1a\n").decode(), "no header"),
        (picture(b"\x00abc", 1, 1, bytes([8, 6, 0, 0, 0])), "not 8-bit RGB"),
        (picture(b"\x00abc", 1, 1, bytes([8, 2, 0, 0, 1])), "not 8-bit RGB"),
        (picture(b"\x05abc", 1, 1), "unknown filter 5"),
        (picture(b"\x00ab", 1, 1), "not as long"),
        (picture(b"\x00\xff\xff\xff", 1, 1), "UTF-8"),
        (picture(b"", 0, 0), "not between"),
        (picture(b"\x00abc", 100_000, 100_000), "not between"),
    ],
)
def test_what_is_no_such_picture_is_refused(data: str, problem: str) -> None:
    with pytest.raises(ProtocolError, match=problem):
        decode_png(data, 1_000_000)


def test_a_small_file_that_unpacks_to_much_is_refused() -> None:
    bomb = picture(b"\0" * (3001 * 1000), 1000, 1000)
    assert len(bomb) < 10_000
    with pytest.raises(ProtocolError, match="not between"):
        decode_png(bomb, 1_000_000)


@settings(max_examples=300, deadline=None)
@given(st.data())
def test_a_damaged_picture_raises_nothing_but_its_own_error(data: st.DataObject) -> None:
    file = bytearray(base64.b64decode(encode_png("x" * 100)))
    for _ in range(data.draw(st.integers(1, 3))):
        file[data.draw(st.integers(0, len(file) - 1))] = data.draw(st.integers(0, 255))
    try:
        decode_png(base64.b64encode(file).decode(), 10_000)
    except ProtocolError:
        pass
