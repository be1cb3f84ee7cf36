"""Turns of a connection, and the size of a read."""

from __future__ import annotations

import asyncio

from robot_health_monitor.rosbridge.turns import READ_BYTES, Turns, limit_reads


def test_a_turn_is_over_after_ten_milliseconds_of_messages_that_already_waited() -> None:
    turns = Turns(0.0)
    over = []
    for message in range(1, 25):  # one each 1/1024 s
        turns.note_received((message - 0.9) / 1024)
        over.append(turns.is_over(message / 1024))
    assert [number for number, is_over in enumerate(over, 1) if is_over] == [11, 22]


def test_a_message_that_was_waited_for_begins_a_turn() -> None:
    """Other tasks ran meanwhile: a slow stream is not interrupted in addition."""
    turns = Turns(0.0)
    for message in range(1, 100):
        turns.note_received(0.01 * message)
        assert not turns.is_over(0.01 * message + 0.001)


def test_a_transport_without_a_size_of_reads_is_left_as_it_is() -> None:
    transport = asyncio.Transport()
    limit_reads(transport)
    assert not hasattr(transport, "max_size")


def test_asyncio_still_has_the_setting() -> None:
    class Transport(asyncio.selector_events._SelectorTransport):  # type: ignore[name-defined,misc]  # not in the stubs
        def __init__(self) -> None:
            """Without a socket."""

        def __del__(self) -> None:
            """There is nothing to close."""

    transport = Transport()
    assert transport.max_size > READ_BYTES
    limit_reads(transport)
    assert transport.max_size == READ_BYTES
