"""What is fuzzed: everything that takes input from outside. Each target makes a case and uses it."""

from __future__ import annotations

import asyncio
import contextlib
import json
import math
import random
import struct
import tempfile
from abc import ABC, abstractmethod
from pathlib import Path
from typing import Any, Mapping, Sequence

import cbor2
import yaml
from fuzz.mutations import NUMBERS, any_text, any_value, mutate_bytes, mutate_tree
from fuzz.work import Work
from harness.rosbridge_operations import EXAMPLES

from robot_health_monitor.cli.commands.check_command import _check_file
from robot_health_monitor.cli.fleet_configuration import read_addresses
from robot_health_monitor.core import Level, Monitor, MonitorConfig, Sample, Transition, load_config
from robot_health_monitor.core.config.signal_config import SIGNAL_PARAMETERS
from robot_health_monitor.core.config.yaml_file import read_yaml
from robot_health_monitor.core.nodes import Aggregator, AlertSystem, BatterySensor
from robot_health_monitor.core.nodes.outlets import json_line
from robot_health_monitor.core.port.local import LocalBus, LogLine
from robot_health_monitor.core.values.errors import ConfigError, MessageError
from robot_health_monitor.core.values.patterns import matches_pattern
from robot_health_monitor.foxglove import FoxgloveClient
from robot_health_monitor.ops.configuration import read_ops, url_problem
from robot_health_monitor.ops.store.matchers import parse_matchers
from robot_health_monitor.ops.store.silences import parse_duration_s
from robot_health_monitor.rosbridge.client.connection import ServerConnection
from robot_health_monitor.rosbridge.protocol import Limits, ProtocolError, Wire, decode, encode, read_operation
from robot_health_monitor.rosbridge.protocol.codec import topic_of_message
from robot_health_monitor.rosbridge.protocol.definitions import parse, serializer
from robot_health_monitor.rosbridge.protocol.operations import COMPRESSIONS
from robot_health_monitor.rosbridge.server.server import Server
from robot_health_monitor.rosbridge.server.session import Session
from robot_health_monitor.runtime.access import Access, TokenCheck, is_loopback, matches
from robot_health_monitor.runtime.bridge.address import host_and_port, shown_address

ROOT = Path(__file__).resolve().parents[2]
FILES = [file.read_bytes() for file in sorted((ROOT / "config").glob("*.yaml"))]
CONTAINED = "=" * 80 + "\nMSG: a/C\nfloat64 d\nstring e\n"
"""A type, as a definition has those that it contains."""
TREES = [yaml.safe_load(data) for data in FILES]


class Target(ABC):
    """One thing to fuzz."""

    name = ""
    errors: tuple[type[Exception], ...] = ()
    """What it may raise."""
    longest_error = 600

    @abstractmethod
    def make(self, chance: random.Random) -> Any:
        """Makes the input of a case."""

    @abstractmethod
    def use(self, data: Any) -> None:
        """Uses the input. It fails if an error other than `errors` leaves it."""

    def allowed(self, data: Any) -> Work:
        """Returns the allowed work for the input."""
        size = size_of(data)
        return Work(5_000 + 300 * size, 1_000_000 + 1_000 * size)

    def close(self) -> None:  # noqa: B027 - most targets open nothing
        """Ends what it has opened."""


def check_text(text: str, longest: int) -> None:
    """Checks that a text is one short line."""
    assert text.isprintable() and len(text) < longest, text


def size_of(data: Any) -> int:
    """Returns the size of an input in characters, roughly."""
    if isinstance(data, (str, bytes)):
        return len(data) + 1
    if isinstance(data, dict):
        return 1 + sum(size_of(key) + size_of(value) for key, value in data.items())
    if isinstance(data, (list, tuple)):
        return 1 + sum(map(size_of, data))
    return 20


class YamlBytes(Target):
    """A file for `check`, and for the nodes."""

    name = "yaml"
    errors = (ConfigError,)
    pieces = (
        b"&a [*a]",
        b"<<: *a\n",
        b"&a {x: [1, 2, 3, 4, 5, 6, 7, 8, 9]}",
        b"[*a, *a, *a, *a, *a, *a, *a, *a, *a]",
        b"59:59:59:59:59:59",
        b"!!python/object:os.system x",
        b"!!binary x",
        b"!!int x",
        b"2020-13-45",
        b"---\n",
        b"? [a]\n: b\n",
        b"\xff\xfe",
        b"\x00",
        b"1" * 5_000,
        b"[" * 500,
        b"{a: " * 300,
        b"alert_system:\n  ros__parameters:\n",
        b"          ",
        b"\n",
        b": ",
        b"- ",
        *(parameter.name.encode() + b": " for parameter in SIGNAL_PARAMETERS),
    )

    def __init__(self) -> None:
        self._folder = tempfile.TemporaryDirectory()
        self._file = Path(self._folder.name) / "file.yaml"

    def make(self, chance: random.Random) -> bytes:
        if chance.random() < 0.1:
            return self._bomb(chance)
        return mutate_bytes(chance, chance.choice(FILES), self.pieces)

    def _bomb(self, chance: random.Random) -> bytes:
        """Aliases of aliases, in a random place of the configuration."""
        width, levels = chance.randrange(2, 12), chance.randrange(2, 30)
        lines = ["a0: &a0 [0]"]
        kind = chance.choice(("[{}]", "{{x: {}}}"))
        for level in range(1, levels):
            parts = ", ".join([f"*a{level - 1}"] * (width if kind[0] == "[" else 1))
            lines.append(f"a{level}: &a{level} {kind.format(parts)}")
        key = chance.choice([parameter.name for parameter in SIGNAL_PARAMETERS] + ["<<", "placeholders"])
        lines.append(f"alert_system: {{ros__parameters: {{signals: {{battery_level: {{{key}: *a{levels - 1}}}}}}}}}")
        return "\n".join(lines).encode()

    def use(self, data: bytes) -> None:
        self._file.write_bytes(data)
        summary, _, errors = _check_file(str(self._file))
        assert summary or errors
        for error in errors:
            assert "\n" not in str(error) and len(str(error)) < self.longest_error, error
        load_config(self._file)

    def allowed(self, data: bytes) -> Work:
        return Work(3_000_000 + 500 * len(data), 50_000_000 + 2_000 * len(data))

    def close(self) -> None:
        self._folder.cleanup()


class OpsBytes(YamlBytes):
    """An ops.yaml for `check`, and for the nodes."""

    name = "ops"
    seed = (
        b"history: {file: history.db, keep_days: 90, keep_mb: 100}\n"
        b"notify:\n"
        b"  pager: {type: alertmanager, url: 'http://10.0.0.2:9093', min_level: WARN}\n"
        b"  chat: {type: webhook, url_file: chat.url, robots: ['r*'], signals: [battery_level]}\n"
        b"  horn: {type: command, command: [./horn, --loud], timeout_s: 10}\n"
        b"  alive: {type: heartbeat, url: 'https://example.com/alive', every_s: 60}\n"
        b"server: {port: 9090, address: 127.0.0.1, tls_certificate: a, tls_key: b, allow_call: ['*']}\n"
    )

    def make(self, chance: random.Random) -> bytes:
        return mutate_bytes(chance, self.seed, self.pieces)

    def use(self, data: bytes) -> None:
        self._file.write_bytes(data)
        summary, _, errors = _check_file(str(self._file))
        assert summary or errors
        for error in errors:
            assert "\n" not in str(error) and len(str(error)) < self.longest_error, error
        read_ops(read_yaml(self._file))


class Mappings(Target):
    """Parameters of the nodes, as a middleware gives them."""

    name = "parameters"
    errors = (ConfigError,)

    def make(self, chance: random.Random) -> Any:
        tree = chance.choice(TREES)
        name = chance.choice(list(tree))
        if chance.random() < 0.5:
            return name, mutate_tree(chance, tree[name]["ros__parameters"], TREES)
        keys = chance.sample([parameter.name for parameter in SIGNAL_PARAMETERS], 4)
        return "alert_system", {"signals": {any_text(chance): {key: any_value(chance) for key in keys}}}

    def use(self, data: Any) -> None:
        name, tree = data
        classes: dict[str, Any] = {"aggregator": Aggregator, "battery_sensor": BatterySensor}
        bus = LocalBus()
        if isinstance(tree, dict):
            classes.get(name, AlertSystem)(bus.node(name, parameters=tree))
            bus.run_until(3.0)
            load_config(tree)

    def allowed(self, data: Any) -> Work:
        return Work(300_000 + 1_000 * size_of(data), 3_000_000 + 2_000 * size_of(data))


def wires(chance: random.Random) -> list[Wire]:
    """Returns messages of a peer: valid ones, and changed ones."""
    made: list[Wire] = []
    for _ in range(chance.randrange(1, 6)):
        fields = mutate_tree(chance, chance.choice(EXAMPLES), EXAMPLES)
        text = as_json(fields)
        kind = chance.randrange(5)
        if kind == 0:
            made.append(mutate_bytes(chance, as_cbor(fields), CBOR_PIECES))
        elif kind == 1:
            made.append(as_cbor(fields))
        elif kind == 2:
            made.append(mutate_bytes(chance, text.encode(), JSON_PIECES).decode("utf-8", "surrogateescape"))
        elif kind == 3:
            made.append(mutate_bytes(chance, text.encode(), JSON_PIECES))
        else:
            made.append(text)
    return made


JSON_PIECES = (
    b'"\\ud800"',
    b"[" * 100,
    b'{"a":' * 70,
    b"9" * 5_000,
    b"NaN",
    b"1e999",
    b'{"op":"png","data":"x"}',
    b"\xff",
)
CBOR_PIECES = (
    b"\xd8\x1c\x82\xd8\x1d\x00\xd8\x1d\x00",  # a list that contains itself twice
    b"\x9f\xff",
    b"\x81" * 100,
    b"\xc2\x58\x64" + b"\xff" * 100,
    b"\x9b\xff\xff\xff\xff\xff\xff\xff\xff",
    b"\x5b\x7f\xff\xff\xff\xff\xff\xff\xff",
    b"\xd8\x55\x44\x00\x00\x80\x7f",
    b"\xf9\x7e\x00",
    b"\x63\xed\xa0\x80",
)


def as_cbor(fields: Any) -> bytes:
    try:
        return cbor2.dumps(fields)
    except Exception:
        return as_json(fields).encode()


def as_json(fields: Any) -> str:
    try:
        return json.dumps(fields, default=repr, skipkeys=True)
    except ValueError:  # Python does not write such a long number
        return '{"op": "publish", "topic": "/in", "msg": {"data": %s}}' % ("9" * 5_000)


class Protocol(Target):
    """The messages of a peer, as client and server read them; what was read is written again."""

    name = "protocol"
    errors = (MessageError,)

    def make(self, chance: random.Random) -> list[Wire]:
        return wires(chance)

    def use(self, data: list[Wire]) -> None:
        for wire in data:
            topic_of_message(wire)
            try:
                fields = decode(wire, Limits())
                read_operation(fields)
            except ProtocolError as error:
                check_text(str(error), self.longest_error)
                continue
            for compression in COMPRESSIONS:
                with contextlib.suppress(MessageError):
                    encode(fields, compression)

    def allowed(self, data: Any) -> Work:
        return Work(20_000 + 300 * size_of(data), 3_000_000 + 1_000 * size_of(data))


class _Transport(asyncio.WriteTransport):
    """Takes what is written and keeps nothing."""

    def write(self, data: Any) -> None:
        pass

    def get_write_buffer_size(self) -> int:
        return 0

    def set_write_buffer_limits(self, high: Any = None, low: Any = None) -> None:
        pass

    def is_closing(self) -> bool:
        return False

    def abort(self) -> None:
        pass


class Sessions(Target):
    """A client of the server."""

    name = "server"

    def __init__(self) -> None:
        self._loop = asyncio.new_event_loop()
        asyncio.set_event_loop(self._loop)
        self._bus = LocalBus()
        AlertSystem(self._bus.node("alert_system"))
        access = Access(publish=["/in"], services=["/alert_system/*", "/reset"], offer=["/reset"], token="secret")
        self._server = Server(self._bus.node("rosbridge"), port=0, threads=False, access=access)
        self._loop.run_until_complete(self._server.start())

    def make(self, chance: random.Random) -> list[Wire]:
        return wires(chance)

    def use(self, data: list[Wire]) -> None:
        self._bus.log_lines.clear()
        self._loop.run_until_complete(self._talk(data))
        failures = [line.text for line in self._bus.log_lines if "failed: " in line.text]
        assert not failures, failures
        assert all("\n" not in line.text and len(line.text) < 2_000 for line in self._bus.log_lines)

    async def _talk(self, data: list[Wire]) -> None:
        server, cbor = self._server, size_of(data) % 2 == 0
        session = Session(server._node, server._topics, server.services, _Transport(), cbor=cbor)
        for wire in data:
            await session.receive(wire)
        for call in tuple(session._calls):
            call.cancel()
        await session.close()

    def allowed(self, data: Any) -> Work:
        return Work(30_000 + 500 * size_of(data), 5_000_000 + 2_000 * size_of(data))

    def close(self) -> None:
        self._loop.run_until_complete(self._server.close())
        self._loop.close()


class Clients(Target):
    """A server of the client."""

    name = "client"

    def make(self, chance: random.Random) -> list[Wire]:
        return wires(chance)

    def use(self, data: list[Wire]) -> None:
        lines: list[str] = []
        connection = ServerConnection(
            "ws://robot:9090",
            on_change=lambda up, cause: None,
            on_log=lambda severity, text: lines.append(text),
            clock=lambda: 0.0,
        )
        for wire in data:
            with contextlib.suppress(MessageError):  # becomes a log line
                connection._receive(wire)
        assert all(line.isprintable() and len(line) < 600 for line in lines), lines


class FoxgloveClients(Target):
    """A foxglove server of the client, which reads a field and whole messages of whatever is offered."""

    name = "foxglove"
    offered: Mapping[str, Any] = {
        "op": "advertise",
        "channels": [
            {"id": 0, "topic": "/a", "encoding": "cdr", "schemaName": "a/msg/B", "schema": "float32[] data\nstring c"},
            {"id": 1, "topic": "/a", "encoding": "ros1", "schemaName": "a/B", "schema": "a/C[] data\n" + CONTAINED},
            {"id": 2, "topic": "/a", "encoding": "json", "schemaName": "a/B", "schema": "{}"},
        ],
    }

    def make(self, chance: random.Random) -> list[Wire]:
        made: list[Wire] = [json.dumps(self.offered)]
        for _ in range(chance.randrange(1, 12)):
            if chance.random() < 0.3:
                text = as_json(mutate_tree(chance, self.offered, [self.offered]))
                made.append(mutate_bytes(chance, text.encode(), JSON_PIECES).decode("utf-8", "surrogateescape"))
            else:
                head = struct.pack("<BIQ", chance.choice((1, 1, 1, 1, 2)), chance.randrange(4), chance.getrandbits(64))
                made.append(head + mutate_bytes(chance, b"\x00\x01\x00\x00\x02\x00\x00\x00" * 3, JSON_PIECES))
        return made

    def use(self, data: list[Wire]) -> None:
        lines: list[LogLine] = []
        client = FoxgloveClient(
            "foxglove://robot:8765", clock=lambda: 0.0, on_log=lines.append, on_link=lambda up, cause: None
        )
        node = client.node("a")
        for field in ("data", "data[0]", "data[*].d", "", None):
            node.subscribe("/a", "", lambda value, now_s: None, field=field)
        node.subscribe_raw("/a", "", lambda value, now_s: None)
        for wire in data:
            if wire:
                with contextlib.suppress(MessageError):  # becomes a log line
                    client.connection._receive(wire)
        assert all(line.text.isprintable() and len(line.text) < 1000 for line in lines), lines
        client.close()


class Core(Target):
    """A monitor: any configuration that loads, and any calls."""

    name = "core"

    def make(self, chance: random.Random) -> Any:
        names = ["a", "b", "link"]
        trees: list[Any] = []
        for _ in range(2):
            signals = {name: self._signal(chance) for name in names[: chance.randrange(1, 3)]}
            trees.append({"signals": signals, "robot_name": chance.choice(("", "atlas", any_text(chance)))})
        calls: list[tuple[Any, ...]] = []
        now_s = 0.0
        for _ in range(chance.randrange(40)):
            now_s += chance.choice((0.0, 0.1, 1.0, 10.0, chance.random() * 5.0, -5.0, 1e6))
            odd_s = chance.choice((math.nan, math.inf, -math.inf, 1e308, -1e308, 5e-324))
            time_s = now_s if chance.random() < 0.97 else odd_s
            what = chance.choice(("observe",) * 6 + ("tick", "tick", "report", "reset", "configure", "link"))
            value = chance.gauss(50.0, 30.0) if chance.random() < 0.7 else any_value(chance)
            calls.append((what, time_s, chance.choice(("a", "a", "b", "unknown", any_text(chance))), value))
        return trees, calls

    def _signal(self, chance: random.Random) -> dict[str, Any]:
        given = {"warn_below": 50.0}
        for parameter in chance.sample(list(SIGNAL_PARAMETERS), chance.randrange(6)):
            value: Any = chance.choice((0.0, 1.0, 2.0, 30.0, 80.0, True, chance.choice(NUMBERS)))
            if parameter.choices:
                value = chance.choice(parameter.choices)
            elif parameter.kind is int:
                value = chance.choice((1, 2, 50))
            given[parameter.name] = value
            try:
                load_config({"signals": {"a": given}})
            except ConfigError:
                del given[parameter.name]
        return given

    def use(self, data: Any) -> None:
        trees, calls = data
        configs: list[MonitorConfig] = []
        for tree in trees:
            with contextlib.suppress(ConfigError):
                configs.append(load_config(tree))
        if not configs:
            return
        monitor = Monitor(configs[0])
        announced: dict[str, Level] = {}
        for what, time_s, name, value in calls:
            transitions: Sequence[Transition] = ()
            if what == "observe":
                transitions = monitor.observe(Sample(name, value, time_s))
            elif what == "link":
                transitions = monitor.set_link(bool(value), name[:100], time_s)
            elif what == "tick":
                transitions = monitor.tick(time_s)
            elif what == "reset":
                transitions = monitor.reset()
            elif what == "configure":
                transitions = monitor.configure(configs[-1])
            report = monitor.report(time_s)
            for each in transitions:
                assert each.from_level is announced.get(each.signal, Level.OK)
                assert (each.from_level is each.to_level) is each.repeat
                assert each.text.isprintable() and len(each.text) < 1_000
                assert json_line(each).isascii() and json.loads(json_line(each))["signal"] == each.signal
                announced[each.signal] = each.to_level
            for status in report.statuses.values():
                assert status.message.isprintable()
                assert all(text.isprintable() for pair in status.values.items() for text in pair)

    def allowed(self, data: Any) -> Work:
        return Work(100_000 + 5_000 * len(data[1]) + 100 * size_of(data), 5_000_000 + 1_000 * size_of(data))


class Addresses(Target):
    """Addresses of robots, and what the server reads in a request."""

    name = "addresses"
    errors = (ConfigError,)
    longest_error = 2_000  # 100 characters of an address, each as an escape sequence
    seeds = (
        b"ws://robot:9090",
        b"wss://user:secret@10.0.0.7:9090/path?token=secret#secret",
        b"husky=ws://[::1]:9090",
        b"http://127.0.0.1",
        b"localhost:9090",
    )
    pieces = (
        b"@",
        b"//",
        b"[",
        b"]",
        b":",
        b"?",
        b"#",
        b"=",
        b"ws://",
        b"\x1b[31m",
        b"99999",
        b"%00",
        b"\xe2\x80\xae",
        b"\n",
    )

    def make(self, chance: random.Random) -> list[str]:
        made = [mutate_bytes(chance, chance.choice(self.seeds), self.pieces) for _ in range(3)]
        return [data.decode("utf-8", "surrogateescape") for data in made] + [any_text(chance)]

    def use(self, data: list[str]) -> None:
        access = Access(origins=("https://studio.example.org",))
        tokens = TokenCheck("secret")
        for text in data:
            is_loopback(text)
            access.origin_allowed(text, data[0])
            tokens.judge(text)
            tokens.judge_cookie(text)
            matches(text, [data[0]])
            shown_address(text)
            for read in (host_and_port, parse_matchers, parse_duration_s, lambda url: url_problem(url, "webhook")):
                with contextlib.suppress(ConfigError):
                    read(text)
            matches_pattern(data[0], text)
        read_addresses(data[:-1])

    def allowed(self, data: Any) -> Work:
        return Work(100_000 + 300 * size_of(data), 2_000_000 + 1_000 * size_of(data))


class Messages(Target):
    """Message definitions, messages, and the paths of fields in them."""

    name = "messages"
    errors = (ConfigError, MessageError)
    texts = (
        b"float32 data\n",
        b"std_msgs/Header header\ngeometry_msgs/Point[3] points\nuint8[<=10] data\nstring<=5 name\nint32 A=1 # one\n",
        b"DiagnosticStatus[] status\n"
        + b"=" * 80
        + b"\nMSG: diagnostic_msgs/DiagnosticStatus\nbyte level\nstring name\n",
        b"x/A a\n" + b"=" * 80 + b"\nMSG: x/A\nx/A[] a\n",
    )
    messages = (
        {"data": 19.5},
        {"header": {"stamp": {"sec": 1, "nanosec": 2}, "frame_id": "x"}, "status": [{"level": 1, "name": "x"}]},
        {"level": 1, "name": "x", "message": "y", "hardware_id": "z", "values": [{"key": "a", "value": "1.5"}]},
    )
    types = (
        "std_msgs/Float32",
        "diagnostic_msgs/DiagnosticArray",
        "diagnostic_msgs/DiagnosticStatus",
        "x/A",
        "rosgraph_msgs/Log",
    )
    paths = (b"data", b"status[0].name", b"values[key=a].value", b"header.stamp.sec", b"transforms[0].x.y")
    pieces = (
        b"[",
        b"]",
        b".",
        b"[]",
        b"[-1]",
        b"[99999999999999]",
        b"=",
        b"\n",
        b"string ",
        b"MSG: ",
        b"=" * 80 + b"\n",
    )

    def make(self, chance: random.Random) -> Any:
        text = mutate_bytes(chance, chance.choice(self.texts), self.pieces).decode("utf-8", "replace")
        path = mutate_bytes(chance, chance.choice(self.paths), self.pieces).decode("utf-8", "replace")
        message = mutate_tree(chance, chance.choice(self.messages), self.messages)
        return chance.choice((*self.types, any_text(chance))), text, message, path

    def use(self, data: Any) -> None:
        type_name, text, message, path = data
        for try_it in (
            lambda: parse(type_name, text),
            lambda: (serializer(type_name) or (lambda message: b""))(message),
            lambda: deliver(path, message),
        ):
            if isinstance(message, dict):
                with contextlib.suppress(*self.errors):
                    try_it()  # type: ignore[no-untyped-call]


def deliver(path: str, message: Any) -> None:
    """Passes a message to a subscription of one of its fields."""
    LocalBus().node("x").subscribe("/in", "", lambda value, now_s: None, field=path).deliver(message)


TARGETS: Sequence[type[Target]] = (
    YamlBytes,
    OpsBytes,
    Mappings,
    Protocol,
    Sessions,
    Clients,
    FoxgloveClients,
    Core,
    Addresses,
    Messages,
)
