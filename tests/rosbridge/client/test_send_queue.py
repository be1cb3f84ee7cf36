"""The queue of what is to be sent, bounded in bytes."""

from __future__ import annotations

import asyncio

from robot_health_monitor.rosbridge.client.send_queue import SendQueue


def test_messages_leave_in_the_order_in_which_they_came() -> None:
    async def scenario() -> None:
        queue = SendQueue()
        assert queue.put("one") and queue.put(b"two")
        assert [await queue.get(), await queue.get()] == ["one", b"two"]

    asyncio.run(scenario())


def test_what_does_not_fit_is_refused_and_counted_until_there_is_room() -> None:
    async def scenario() -> None:
        queue = SendQueue(bound_bytes=10)
        assert queue.put("123456")
        assert not queue.put("12345")
        assert queue.put("1234")
        assert queue.dropped == 1
        await queue.get()
        assert queue.put("123456")

    asyncio.run(scenario())


def test_a_reader_waits_for_the_next_message() -> None:
    async def scenario() -> None:
        queue = SendQueue()
        for text in ("first", "second"):
            reading = asyncio.ensure_future(queue.get())
            await asyncio.sleep(0)
            assert not reading.done()
            queue.put(text)
            assert await reading == text

    asyncio.run(scenario())
