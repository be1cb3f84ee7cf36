"""Makes receiving small messages cheap.

asyncio passes `recv` a new buffer of 256 KiB for every message. glibc maps memory for blocks above 128 KiB and unmaps
it when they are freed, which takes longer than decoding and judging a small message. The limit rises to the size of any
larger block that is freed ("dynamic mmap threshold", mallopt(3)). Other C libraries are not affected.
"""

from __future__ import annotations

__all__ = ["keep_receive_buffers_on_heap"]

_BLOCK_BYTES = 512 * 1024


def keep_receive_buffers_on_heap() -> None:
    """Frees a block that is larger than asyncio's buffer. Holds for the process; may be called again."""
    bytes(_BLOCK_BYTES)
