"""The server beside the monitor: what clients see, what they may do, and what happens if it cannot start."""

from __future__ import annotations

import asyncio
import json
import platform
import socket
import ssl
from contextlib import closing
from dataclasses import replace
from pathlib import Path
from typing import Any, Awaitable, Callable

import pytest

pytest.importorskip("aiohttp", reason="aiohttp, which carries the WebSockets, is not installed")

import aiohttp
from harness.rosbridge_peer import Peer

from robot_health_monitor.cli.embedded import EmbeddedMonitor
from robot_health_monitor.cli.operations import Operations
from robot_health_monitor.cli.serving import ServerSettings, page_address, serve, server_settings, stop_serving
from robot_health_monitor.core.config.monitor_config import MonitorConfig
from robot_health_monitor.core.port.local import LogLine
from robot_health_monitor.core.port.middleware import Severity
from robot_health_monitor.core.values.errors import ConfigError
from robot_health_monitor.ops.configuration import OpsConfig, ServerOptions
from robot_health_monitor.runtime.tokens import TokenFiles

LOCAL = ServerSettings(port=0)
NO_OPERATIONS = Operations(OpsConfig())
NO_PARAMETERS = MonitorConfig({})


def with_client(settings: ServerSettings, use: Callable[[EmbeddedMonitor, Peer], Awaitable[None]]) -> None:
    """Serves a monitor without sensors and runs `use` with a client."""

    async def run() -> None:
        monitor = EmbeddedMonitor(robot="atlas", source="none", outlet=lambda event: None, on_log=lambda line: None)
        server = await serve(monitor, settings, NO_OPERATIONS, required=True)
        assert server is not None
        try:
            async with aiohttp.ClientSession() as session:
                url = f"ws://127.0.0.1:{server.port}"
                async with session.ws_connect(url, headers={"Authorization": f"Bearer {settings.token}"}) as connection:
                    await use(monitor, Peer(connection))
        finally:
            await stop_serving(server)
            monitor.close()

    asyncio.run(run())


def publish_here(monitor: EmbeddedMonitor, topic: str, value: float) -> None:
    outside = monitor.bus.node("outside")
    outside.advertise(topic, "std_msgs/Float32")
    outside.publish(topic, {"data": value})


def test_an_alert_is_one_line_on_rosout() -> None:
    async def use(monitor: EmbeddedMonitor, peer: Peer) -> None:
        await peer.subscribe("/rosout", type="rosgraph_msgs/Log")
        publish_here(monitor, "battery_level", 15.0)
        monitor.bus.node("outside").log(Severity.INFO, "after it")
        lines: list[Any] = [(await peer.receive())["msg"] for _ in range(2)]
        assert lines[0]["msg"].startswith("battery_level WARN: 15 % is below 20 %")
        assert (lines[0]["name"], lines[0]["level"]) == ("/alert_system", 4)
        assert lines[1]["msg"] == "after it"

    with_client(LOCAL, use)


def test_watching_a_topic_does_not_open_it_for_publishing() -> None:
    async def use(monitor: EmbeddedMonitor, peer: Peer) -> None:
        await peer.send("publish", topic="/battery_level", type="std_msgs/Float32", msg={"data": 15.0})
        await peer.settle()
        assert monitor.alert_system.monitor.fresh_value("battery_level") is None

    with_client(LOCAL, use)


def test_what_is_allowed_is_open() -> None:
    async def use(monitor: EmbeddedMonitor, peer: Peer) -> None:
        await peer.send("advertise", topic="/battery_level", type="std_msgs/Float32")
        await peer.send("publish", topic="/battery_level", msg={"data": 15.0})
        await peer.settle()
        assert monitor.alert_system.monitor.fresh_value("battery_level") == 15.0
        assert (await peer.call("/alert_system/reset"))["result"] is True

    with_client(replace(LOCAL, allow_publish=("/battery_*",)), use)


def test_the_token_is_in_no_parameter() -> None:
    async def use(monitor: EmbeddedMonitor, peer: Peer) -> None:
        names = (await peer.call("/rosapi/get_param_names"))["values"]["names"]
        found = [await peer.call("/rosapi/get_param", {"name": name, "default": ""}) for name in names]
        assert names and "s3cret" not in json.dumps(found)

    with_client(replace(LOCAL, token="s3cret"), use)


def test_the_monitors_own_status_counts_the_clients() -> None:
    async def run() -> None:
        with closing(Operations(OpsConfig())) as operations:
            monitor = EmbeddedMonitor(
                source="none", outlet=lambda event: None, start_alert_system=operations.start_only
            )
            before = dict(monitor.alert_system.self_monitor.status().values)
            assert before["clients"] == "0" and "clients_dropped" not in before
            server = await serve(monitor, LOCAL, operations, required=True)
            assert server is not None
            url = f"ws://127.0.0.1:{server.port}"
            async with aiohttp.ClientSession() as session, session.ws_connect(url) as connection:
                await Peer(connection).settle()
                shown = monitor.alert_system.self_monitor.status().values
                assert (shown["clients"], shown["clients_dropped"]) == ("1", "0")
            await stop_serving(server)
            monitor.close()

    asyncio.run(run())


def test_a_port_in_use_is_a_fault_and_if_it_was_requested_an_error() -> None:
    async def run(port: int) -> None:
        monitor = EmbeddedMonitor(source="none")
        settings = ServerSettings(port=port)
        assert await serve(monitor, settings, NO_OPERATIONS, required=False) is None
        assert monitor.node.faults.current()["server"].text.startswith(
            f"web page and rosbridge are off: port {port} of 127.0.0.1 cannot be opened: "
        )
        with pytest.raises(ConfigError, match=f"port {port} of 127.0.0.1 cannot be opened"):
            await serve(monitor, settings, NO_OPERATIONS, required=True)

    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        asyncio.run(run(taken.getsockname()[1]))


def test_an_address_that_others_can_reach_needs_a_token() -> None:
    async def run() -> None:
        with pytest.raises(ConfigError):
            await serve(
                EmbeddedMonitor(source="none"), replace(LOCAL, address="0.0.0.0"), NO_OPERATIONS, required=False
            )

    asyncio.run(run())


def test_the_address_of_the_page_is_logged() -> None:
    lines: list[str] = []

    async def run() -> None:
        monitor = EmbeddedMonitor(robot="atlas", source="none", on_log=lambda line: lines.append(line.text))
        server = await serve(monitor, LOCAL, NO_OPERATIONS, required=True)
        assert server is not None
        port = server.port
        await stop_serving(server)
        monitor.close()
        assert lines[-1] == f"web page: http://127.0.0.1:{port}/"

    asyncio.run(run())


@pytest.mark.parametrize(
    ("address", "shown"),
    [
        ("127.0.0.1", "http://127.0.0.1:9090/"),
        ("::1", "http://[::1]:9090/"),
        ("0.0.0.0", f"http://{platform.node()}:9090/"),
        ("::", f"http://{platform.node()}:9090/"),
    ],
)
def test_the_address_of_the_page_can_be_opened(address: str, shown: str) -> None:
    assert page_address(address, 9090) == shown


def merged(
    options: ServerOptions | None, config: MonitorConfig = NO_PARAMETERS, arguments: ServerOptions | None = None
) -> ServerSettings:
    return server_settings(config, options, arguments, tokens=TokenFiles(lambda text: None))


def test_the_command_line_comes_first_then_the_parameters_then_the_ops_yaml() -> None:
    assert merged(None) == ServerSettings(9090, "127.0.0.1")
    options = ServerOptions(port=1, address="localhost", allow_call=("/a",), allow_publish=("/b",))
    assert merged(options) == ServerSettings(1, "localhost", allow_call=("/a",), allow_publish=("/b",))
    assert merged(ServerOptions(port=0)).port == 0
    parameters = replace(NO_PARAMETERS, rosbridge_port=2, rosbridge_address="::1")
    of_parameters = merged(options, parameters)
    assert (of_parameters.port, of_parameters.address) == (2, "::1")
    settings = merged(options, parameters, ServerOptions(3, "127.0.0.2", allow_call=("/c",)))
    assert (settings.port, settings.address) == (3, "127.0.0.2")
    assert (settings.allow_call, settings.allow_publish) == (("/c",), ("/b",))
    assert merged(options, parameters, ServerOptions(port=0)).port == 0


def test_the_token_file_of_the_ops_yaml_is_used(tmp_path: Path) -> None:
    (tmp_path / "token").write_text("secret\n")
    assert merged(ServerOptions(token_file=str(tmp_path / "token"))).token == "secret"


@pytest.mark.parametrize(("length", "lines"), [(15, 1), (16, 0)])
def test_a_short_token_is_a_warning(tmp_path: Path, length: int, lines: int) -> None:
    file = tmp_path / "token"
    file.write_text("x" * length)
    file.chmod(0o600)
    warnings: list[str] = []
    server_settings(NO_PARAMETERS, ServerOptions(token_file=str(file)), tokens=TokenFiles(warnings.append))
    problem = "the token has fewer than 16 characters and can be guessed; make one: openssl rand -hex 16"
    assert warnings == [problem] * lines


def test_with_a_certificate_clients_connect_over_tls(tmp_path: Path) -> None:
    trustme = pytest.importorskip("trustme", reason="trustme, which makes certificates, is not installed")
    authority = trustme.CA()
    certificate = authority.issue_cert("localhost")
    certificate.cert_chain_pems[0].write_to_path(tmp_path / "certificate.pem")
    certificate.private_key_pem.write_to_path(tmp_path / "key.pem")
    trusting = ssl.create_default_context()
    authority.configure_trust(trusting)
    settings = ServerSettings(
        0, tls_certificate=str(tmp_path / "certificate.pem"), tls_key=str(tmp_path / "key.pem"), allow_publish=("*",)
    )
    lines: list[LogLine] = []

    async def run() -> None:
        monitor = EmbeddedMonitor(source="none", outlet=lambda event: None, on_log=lines.append)
        server = await serve(monitor, settings, NO_OPERATIONS, required=True)
        assert server is not None
        try:
            async with aiohttp.ClientSession() as session:
                async with session.ws_connect(f"wss://localhost:{server.port}", ssl=trusting) as connection:
                    await Peer(connection).settle()
                with pytest.raises(aiohttp.ClientError):
                    await session.ws_connect(f"ws://localhost:{server.port}")
        finally:
            await stop_serving(server)
            monitor.close()
        shown = [line.text for line in lines]
        assert f"serving on wss://127.0.0.1:{server.port}" in shown
        assert f"web page: https://127.0.0.1:{server.port}/" in shown

    asyncio.run(run())


@pytest.mark.parametrize(
    ("key", "problem"),
    [
        (None, "certificate.pem: cannot be used as a certificate with the key "),
        ("not a key", "certificate.pem: cannot be used as a certificate with the key "),
    ],
)
def test_a_certificate_that_cannot_be_used_is_one_line(tmp_path: Path, key: str | None, problem: str) -> None:
    (tmp_path / "certificate.pem").write_text("not a certificate")
    if key is not None:
        (tmp_path / "key.pem").write_text(key)
    files = {"tls_certificate": str(tmp_path / "certificate.pem"), "tls_key": str(tmp_path / "key.pem")}

    async def run() -> None:
        monitor = EmbeddedMonitor(source="none", outlet=lambda event: None, on_log=lambda line: None)
        try:
            await serve(monitor, ServerSettings(0, **files), NO_OPERATIONS, required=False)
        finally:
            monitor.close()

    with pytest.raises(ConfigError) as caught:
        asyncio.run(run())
    assert str(caught.value).startswith(f"{tmp_path}/{problem}")
