"""Work that must end in time, and cancellations that must not be lost."""

from __future__ import annotations

import asyncio
from typing import Any, List

import pytest
from harness.rosbridge_client import scenario

from robot_health_monitor.rosbridge.client.timeouts import within


@pytest.mark.parametrize("error", [None, ConnectionRefusedError()])
def test_a_cancellation_is_not_lost_when_the_attempt_ends_at_the_same_moment(error: Any) -> None:
    @scenario
    async def run() -> None:
        attempt = asyncio.get_event_loop().create_future()
        waiting: List[bool] = []

        async def work() -> None:
            waiting.append(True)
            await attempt

        task = asyncio.ensure_future(within(10.0, work()))
        while not waiting:
            await asyncio.sleep(0)
        if error is None:
            attempt.set_result(None)
        else:
            attempt.set_exception(error)
        task.cancel()
        await asyncio.wait({task})
        assert task.cancelled()

    run()


@scenario
async def test_an_attempt_that_takes_too_long_is_given_up() -> None:
    work = asyncio.ensure_future(asyncio.sleep(60.0))

    async def wait_for_work() -> None:
        await work

    with pytest.raises(asyncio.TimeoutError):
        await within(0.01, wait_for_work())
    await asyncio.wait({work})
    assert work.cancelled()
