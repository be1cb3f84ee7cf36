"""Calls that wait for a response: who may answer them, and what ends them."""

from __future__ import annotations

import asyncio
from typing import Any

import pytest
from harness.rosbridge_client import scenario

from robot_health_monitor.core.values.errors import LinkError, ServiceError
from robot_health_monitor.rosbridge.calls import PendingCalls
from robot_health_monitor.rosbridge.protocol.operations import ServiceResponse


class Bench:
    def __init__(self) -> None:
        self.calls = PendingCalls()
        self.sent: list[Any] = []

    async def start(self, peer: object, service: str = "/dock") -> asyncio.Task[Any]:
        call = asyncio.ensure_future(self.calls.call(self.sent.append, peer, service, {}, 30.0))
        await asyncio.sleep(0)
        return call


@scenario
async def test_only_the_peer_that_was_called_may_respond_and_only_once() -> None:
    bench = Bench()
    call = await bench.start("one")
    id = bench.sent[0]["id"]  # noqa: A001 - the protocol's word
    bench.calls.receive(ServiceResponse("/dock", {"ok": 0}, True, id), "other", "")
    bench.calls.receive(ServiceResponse("/dock", {"ok": 0}, True, "call:99"), "one", "")
    bench.calls.receive(ServiceResponse("/dock", {"ok": 1}, True, id), "one", "")
    bench.calls.receive(ServiceResponse("/dock", {"ok": 2}, True, id), "one", "")
    assert await call == {"ok": 1}


@scenario
async def test_a_service_that_failed_raises_the_text_of_the_caller() -> None:
    bench = Bench()
    call = await bench.start("one")
    bench.calls.receive(ServiceResponse("/dock", "jammed", False, bench.sent[0]["id"]), "one", "/dock: jammed")
    with pytest.raises(ServiceError, match=r"^/dock: jammed$"):
        await call


@scenario
async def test_the_calls_of_one_service_of_a_peer_end_when_it_leaves_others_go_on() -> None:
    bench = Bench()
    gone, stays, other = [await bench.start(*key) for key in (("a", "/x"), ("a", "/y"), ("b", "/x"))]
    bench.calls.fail(LinkError("gone"), "/x", "a")
    with pytest.raises(LinkError, match=r"^gone$"):
        await gone
    assert not stays.done() and not other.done()
    bench.calls.fail(LinkError("all"), peer="a")
    with pytest.raises(LinkError, match=r"^all$"):
        await stays
    assert not other.done()
    other.cancel()
