from __future__ import annotations

import asyncio
import threading
from typing import Any, List

from robot_health_monitor.rosbridge.server.encoded_message import EncodedMessage, Encoding
from robot_health_monitor.rosbridge.server.encoding_queue import EncodingQueue
from robot_health_monitor.runtime.threads import ThreadPool

SIZE = 100_000


def message(number: int) -> EncodedMessage:
    return EncodedMessage("/a", {"data": f"{number:04d}" + "x" * SIZE})


class TestQueue:
    def run(self, scenario: Any, bound_bytes: int) -> None:
        async def run() -> None:
            pool = ThreadPool("encode", 1, 10)
            sent: List[int] = []
            problems: List[str] = []

            def send(frames: bytes, receivers: Any) -> None:
                sent.append(int(frames[frames.index(b'"data":"') + 8 :][:4]))

            queue: EncodingQueue[str] = EncodingQueue(Encoding(), pool, bound_bytes, send, problems.append)
            await asyncio.wait_for(scenario(pool, queue, sent, problems), 60.0)
            pool.close()

        asyncio.run(run())

    def test_messages_are_encoded_in_a_thread_and_sent_in_order(self) -> None:
        async def scenario(pool: ThreadPool, queue: Any, sent: List[int], problems: List[str]) -> None:
            threads = []
            first = message(0)
            encode = first.frames
            first.frames = lambda encoding: threads.append(threading.get_ident()) or encode(encoding)  # type: ignore[method-assign,func-returns-value]
            queue.put(first, ["client"])
            for number in range(1, 5):
                queue.put(message(number), ["client"])
            while queue.busy:
                await asyncio.sleep(0)
            assert sent == [0, 1, 2, 3, 4]
            assert threads != [threading.get_ident()]
            assert (queue._bytes, queue.dropped) == (0, 0)

        self.run(scenario, 10 * SIZE)

    def test_while_the_encoder_is_busy_the_newest_wait_within_the_bound(self) -> None:
        async def scenario(pool: ThreadPool, queue: Any, sent: List[int], problems: List[str]) -> None:
            released = threading.Event()
            busy = pool.submit(released.wait, 20.0)
            for number in range(100):
                queue.put(message(number), ["client"])
                assert queue._bytes <= 3.5 * SIZE
                await asyncio.sleep(0)
            released.set()
            await busy
            while queue.busy:
                await asyncio.sleep(0)
            assert sent == [0, 97, 98, 99]
            assert queue.dropped == 96

        self.run(scenario, int(3.5 * SIZE))

    def test_a_message_that_cannot_be_encoded_is_reported_and_the_next_is_sent(self) -> None:
        async def scenario(pool: ThreadPool, queue: Any, sent: List[int], problems: List[str]) -> None:
            queue.put(EncodedMessage("/a", {"data": object()}), ["client"])
            queue.put(message(1), ["client"])
            while queue.busy:
                await asyncio.sleep(0)
            assert sent == [1]
            assert problems == ["object cannot be encoded as JSON"]

        self.run(scenario, 10 * SIZE)
