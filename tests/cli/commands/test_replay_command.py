"""`robot-health replay`: what it prints, writes and returns."""

from __future__ import annotations

import contextlib
import json
import os
import sqlite3
import subprocess
from pathlib import Path
from typing import Any

import pytest
from harness.recorded import ROS1, ROS2, START_NS, Recorded, values, write_bag, write_folder, write_mcap
from harness.requirements import recordings_requirements

from robot_health_monitor.__main__ import main

THRESHOLDS = """
alert_system:
  ros__parameters:
    signals:
      battery: {type: std_msgs/Float32, unit: "%", warn_below: 20.0, error_below: 10.0}
"""
WITH_GPS = f"{THRESHOLDS}      gps: {{type: std_msgs/Float32, warn_below: 1.0}}\n"
FALLING = [50.0] * 10 + [15.0] * 10 + [50.0] * 10
"""OK, at 10 s WARN, at 20 s OK."""


@pytest.fixture(autouse=True)
def utc(monkeypatch: pytest.MonkeyPatch) -> None:
    """Makes local time UTC."""
    monkeypatch.setenv("TZ", "UTC")
    import time

    time.tzset()


@pytest.fixture
def thresholds(tmp_path: Path) -> str:
    """Returns the path of a configuration."""
    file = tmp_path / "thresholds.yaml"
    file.write_text(THRESHOLDS, encoding="utf-8")
    return str(file)


def bag(folder: Path, numbers: list[float], name: str = "test.bag") -> str:
    """Returns the path of a recording of a battery, one sample per second."""
    return write_bag(folder / name, values("/battery", numbers))


def test_alerts_have_the_wall_time_of_the_recording(
    tmp_path: Path, thresholds: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["replay", bag(tmp_path, FALLING), "--thresholds", thresholds]) == 1
    printed = capsys.readouterr()
    assert printed.out.splitlines() == [
        "2023-11-14 22:13:30 battery WARN: 15 % is below 20 % (was OK for 10 s)",
        "2023-11-14 22:13:40 battery OK: 50 % is no longer below 20 % (was WARN for 10 s)",
        "",
        "signal   samples  bad      OK    WARN  ERROR  STALE  unknown  alerts   min     mean   max  longest gap",
        "battery       30    0  65.5 %  34.5 %    0 %    0 %      0 %       1  15 %  38.33 %  50 %          1 s",
        "1 alert",
    ]
    assert printed.err == ""


@pytest.mark.parametrize(
    ("lowest", "fail_on", "code"),
    [
        (50.0, "warn", 0),
        (15.0, "warn", 1),
        (15.0, "error", 0),
        (5.0, "error", 1),
        (5.0, "never", 0),
    ],
)
def test_the_code_follows_the_worst_level(
    tmp_path: Path, thresholds: str, lowest: float, fail_on: str, code: int
) -> None:
    recording = bag(tmp_path, [50.0, 50.0, lowest, 50.0])
    assert main(["replay", recording, "--thresholds", thresholds, "--fail-on", fail_on]) == code


@pytest.mark.parametrize(("fail_on", "code"), [("warn", 1), ("error", 0)])
def test_stale_is_below_error(tmp_path: Path, thresholds: str, fail_on: str, code: int) -> None:
    messages = [*values("/battery", [50.0]), *values("/other", [0.0] * 20)]
    recording = write_bag(tmp_path / "test.bag", messages)
    assert main(["replay", recording, "--thresholds", thresholds, "--fail-on", fail_on]) == code


def test_json_is_one_object_per_transition(tmp_path: Path, thresholds: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["replay", bag(tmp_path, FALLING), "--thresholds", thresholds, "--json"]) == 1
    printed = capsys.readouterr()
    first, second = map(json.loads, printed.out.splitlines())
    assert (first["signal"], first["from_level"], first["to_level"], first["bound"]) == ("battery", "OK", "WARN", 20.0)
    assert first["now_s"] == 1_700_000_010.0
    assert second["to_level"] == "OK"
    assert "file" not in first
    assert printed.err.endswith("1 alert\n")


def test_against_shows_only_what_differs(tmp_path: Path, thresholds: str, capsys: pytest.CaptureFixture[str]) -> None:
    other = tmp_path / "other.yaml"
    other.write_text(THRESHOLDS.replace("error_below: 10.0", "error_below: 18.0"), encoding="utf-8")
    # 19 is a WARN for both, 15 an ERROR for the other only.
    recording = bag(tmp_path, [50.0, 19.0, 19.0, 15.0, 50.0])
    command = ["replay", recording, "--thresholds", thresholds, "--against", str(other)]
    assert main([*command, "--json"]) == 1
    found = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    assert [(each["file"], each["from_level"], each["to_level"]) for each in found] == [
        (str(other), "WARN", "ERROR"),
        (thresholds, "WARN", "OK"),
        (str(other), "ERROR", "OK"),
    ]
    assert main(command) == 1
    lines = capsys.readouterr().out.splitlines()
    assert lines[0] == (f"2023-11-14 22:13:23 {other}: battery ERROR: 15 % is below 18 % (was WARN for 2 s)")
    assert lines[-1] == "3 differences"
    assert [line.split()[:2] for line in lines[-3:-1]] == [["battery", thresholds], ["battery", str(other)]]
    assert main([*command, "--fail-on", "never"]) == 0


def test_against_the_same_rules_nothing_differs(
    tmp_path: Path, thresholds: str, capsys: pytest.CaptureFixture[str]
) -> None:
    recording = bag(tmp_path, FALLING)
    assert main(["replay", recording, "--thresholds", thresholds, "--against", thresholds]) == 0
    printed = capsys.readouterr().out
    assert printed.startswith("\nsignal ")
    assert printed.endswith("no differences\n")


def test_from_and_to_are_seconds_since_the_start(
    tmp_path: Path, thresholds: str, capsys: pytest.CaptureFixture[str]
) -> None:
    command = ["replay", bag(tmp_path, FALLING), "--thresholds", thresholds, "--json"]
    assert main([*command, "--from", "12", "--to", "18"]) == 1
    (only,) = map(json.loads, capsys.readouterr().out.splitlines())
    assert (only["to_level"], only["now_s"]) == ("WARN", 1_700_000_012.0)
    assert main([*command, "--to", "9"]) == 0
    assert main([*command, "--from", "21"]) == 0


def test_several_recordings_are_one_timeline(
    tmp_path: Path, thresholds: str, capsys: pytest.CaptureFixture[str]
) -> None:
    later = write_bag(tmp_path / "later.bag", values("/battery", [50.0], start_s=4.0))
    earlier = bag(tmp_path, [50.0, 15.0, 15.0, 15.0])
    assert main(["replay", later, earlier, "--thresholds", thresholds, "--json"]) == 1
    levels = [json.loads(line)["to_level"] for line in capsys.readouterr().out.splitlines()]
    assert levels == ["WARN", "OK"]


@pytest.mark.newest_python
def test_skipped_times_are_no_late_ticks(tmp_path: Path, thresholds: str, capsys: pytest.CaptureFixture[str]) -> None:
    messages = values("/battery", [50.0] * 10)
    first = write_bag(tmp_path / "first.bag", messages)
    second = write_bag(tmp_path / "second.bag", [each._replace(time_s=each.time_s + 1e5 + 0.4) for each in messages])
    both = write_bag(tmp_path / "both.bag", [*messages, *values("/battery", [50.0] * 10, start_s=1e5)])
    assert main(["replay", first, second, "--thresholds", thresholds, "--report", str(tmp_path / "a.html")]) == 0
    assert capsys.readouterr().err == ""
    start_s, report = START_NS / 1e9, (tmp_path / "a.html").read_text(encoding="utf-8")
    assert f'"levels":[[{start_s:.1f},"OK"],[{start_s + 9:.1f},""],[{start_s + 100_000.4:.1f},"OK"]]' in report
    assert main(["replay", both, "--thresholds", thresholds]) == 1
    assert capsys.readouterr().err == "WARN: no messages for more than 24 h: 13590 s skipped\n"


def test_a_namespace_is_where_the_topics_are(tmp_path: Path, thresholds: str) -> None:
    recording = write_bag(tmp_path / "test.bag", values("/robot1/battery", [5.0]))
    assert main(["replay", recording, "--thresholds", thresholds, "--namespace", "robot1"]) == 1


@pytest.fixture
def with_gps(tmp_path: Path) -> str:
    """Returns the path of a configuration with a second signal."""
    file = tmp_path / "with_gps.yaml"
    file.write_text(WITH_GPS, encoding="utf-8")
    return str(file)


@pytest.mark.parametrize(
    ("options", "code"),
    [
        ([], 1),
        (["--fail-on", "error"], 1),
        (["--fail-on", "never"], 0),
        (["--allow-missing"], 0),
        (["--against", "{file}"], 1),
        (["--against", "{file}", "--allow-missing"], 0),
    ],
)
@pytest.mark.parametrize("other", [[], [(1.0, "/gps", "std_msgs/msg/Int32")]], ids=["no topic", "another type"])
def test_a_signal_that_is_not_judged_is_no_success(
    tmp_path: Path,
    with_gps: str,
    capsys: pytest.CaptureFixture[str],
    options: list[str],
    code: int,
    other: list[Any],
) -> None:
    gps = [Recorded(at_s, topic, ROS1.types[name](data=5)) for at_s, topic, name in other]
    recording = write_bag(tmp_path / "test.bag", [*values("/battery", [50.0] * 3), *gps])
    given = [option.replace("{file}", with_gps) for option in options]
    assert main(["replay", recording, "--thresholds", with_gps, *given]) == code
    printed = capsys.readouterr()
    reason = "/gps is recorded as std_msgs/Int32, configured as std_msgs/Float32" if gps else "/gps is not recorded"
    assert printed.err == f"WARN: not judged: gps ({reason})\n"
    assert any(line.startswith("gps ") and line.endswith("not recorded") for line in printed.out.splitlines())
    assert printed.out.splitlines()[-1] in ("no alerts; 1 signal not judged", "no differences; 1 signal not judged")


def test_a_signal_with_undecodable_messages_only_is_not_judged_and_not_stale(
    tmp_path: Path, with_gps: str, capsys: pytest.CaptureFixture[str]
) -> None:
    Path(with_gps).write_text(WITH_GPS.replace("gps: {type: std_msgs/Float32", "gps: {type: std_msgs/Int32"))
    gps = [Recorded(float(at_s), "/gps", ROS2.types["std_msgs/msg/Int32"](data=5)) for at_s in range(30)]
    too_long = {"std_msgs/msg/Int32": ("ros2msg", "int64 data")}
    recording = write_mcap(tmp_path / "test.mcap", [*values("/battery", [50.0] * 30), *gps], definitions=too_long)
    command = ["replay", recording, "--thresholds", with_gps]
    assert main(command) == 1
    printed = capsys.readouterr()
    assert "STALE: " not in printed.out
    assert printed.err == (
        "WARN: /gps: 30 messages could not be decoded and were left out\n"
        "WARN: not judged: gps (no message on /gps can be decoded)\n"
    )
    assert main([*command, "--allow-missing"]) == 0


def test_the_graph_is_no_recorded_topic_named_once_and_not_missing(
    tmp_path: Path, thresholds: str, capsys: pytest.CaptureFixture[str]
) -> None:
    keys = ("node", "publishers", "subscribers", "lifecycle")
    lines = [f"      {key}_watched: {{{key}: /scan}}\n" for key in keys]
    with open(thresholds, "a", encoding="utf-8") as file:
        file.writelines(lines)
    assert main(["replay", bag(tmp_path, [50.0] * 10), "--thresholds", thresholds]) == 0
    printed = capsys.readouterr()
    unknown = "the robot's graph is not known here"
    named = [line for line in printed.out.splitlines() if "watched" in line]
    begin = "2023-11-14 22:13:20 [INFO] alert_system: "
    assert named == [f"{begin}{key}_watched is not watched: {unknown}" for key in sorted(keys)]
    assert printed.out.splitlines()[-1] == "no alerts"
    assert printed.err == ""


def flip_bits(file: str, at: int) -> None:
    """Changes a byte of the compressed data of a file."""
    data = bytearray(Path(file).read_bytes())
    data[at] ^= 0xFF
    Path(file).write_bytes(bytes(data))


def chunks_of(file: str) -> list[Any]:
    from mcap.reader import make_reader

    with open(file, "rb") as stream:
        summary = make_reader(stream).get_summary()
        assert summary is not None
        return sorted(summary.chunk_indexes, key=lambda each: each.chunk_start_offset)


def test_a_recording_of_which_nothing_can_be_read_raises_no_alert(
    tmp_path: Path, thresholds: str, capsys: pytest.CaptureFixture[str]
) -> None:
    recording = write_mcap(tmp_path / "test.mcap", values("/battery", FALLING), compression="zstd")
    (chunk,) = chunks_of(recording)
    flip_bits(recording, chunk.chunk_start_offset + chunk.chunk_length // 2)
    assert main(["replay", recording, "--thresholds", thresholds]) == 2
    printed = capsys.readouterr()
    assert printed.out == ""
    assert printed.err.startswith(f"{recording}: has no message that can be read: damaged at byte ")
    # Beside another recording, too.
    other = bag(tmp_path, [50.0] * 20)
    assert main(["replay", other, recording, "--thresholds", thresholds]) == 2
    assert capsys.readouterr().out == ""


def test_a_signal_in_a_damaged_chunk_only_is_not_judged_and_not_stale(
    tmp_path: Path, with_gps: str, capsys: pytest.CaptureFixture[str]
) -> None:
    """The chunk size ends a chunk after each message of 900 characters."""
    text = ROS2.types["std_msgs/msg/String"](data="x" * 900)
    between = [Recorded(5.0, "/log", text), Recorded(10.0, "/log", text)]
    messages = [*values("/battery", [50.0] * 30), *values("/gps", [2.0] * 4, start_s=6.0), *between]
    messages.sort(key=lambda each: each.time_s)
    recording = write_mcap(tmp_path / "test.mcap", messages, compression="zstd", chunk_size=900)
    _, second, _ = chunks_of(recording)
    flip_bits(recording, second.chunk_start_offset + second.chunk_length // 2)
    assert main(["replay", recording, "--thresholds", with_gps]) == 1
    printed = capsys.readouterr()
    assert not [line for line in printed.out.splitlines() if " gps STALE: " in line]
    assert "WARN: not judged: gps (/gps is in damaged parts only)\n" in printed.err
    assert printed.out.splitlines()[-1].endswith("; 1 signal not judged")


def test_where_no_signal_is_recorded_nothing_helps(
    tmp_path: Path, thresholds: str, capsys: pytest.CaptureFixture[str]
) -> None:
    options = ["--thresholds", thresholds, "--allow-missing", "--fail-on", "never"]
    report = tmp_path / "report.html"
    other = write_bag(tmp_path / "test.bag", values("/robot1/battery", [5.0]))
    assert main(["replay", other, *options, "--report", str(report)]) == 2
    assert capsys.readouterr().err == (
        "robot-health replay: no signal is recorded: battery (/battery is not recorded); "
        "the recordings have /robot1/battery; is a --namespace missing?\n"
    )
    number = ROS1.types["std_msgs/msg/Int32"](data=5)
    wrong = write_bag(tmp_path / "wrong.bag", [Recorded(0.0, "/battery", number)])
    assert main(["replay", wrong, *options]) == 2
    assert capsys.readouterr().err == (
        "robot-health replay: no signal is recorded: battery (/battery is recorded as std_msgs/Int32, configured as "
        "std_msgs/Float32); the recordings have /battery; is a --namespace missing?\n"
    )
    late = write_bag(tmp_path / "late.bag", [*values("/battery", [5.0]), *values("/other", [0.0] * 3, start_s=1.0)])
    assert main(["replay", late, *options, "--from", "1"]) == 2
    assert capsys.readouterr().err == ("robot-health replay: no signal was judged: battery (/battery has no samples)\n")
    assert not report.exists()


def test_a_second_configuration_without_a_recorded_signal_is_an_error(
    tmp_path: Path, thresholds: str, capsys: pytest.CaptureFixture[str]
) -> None:
    other = tmp_path / "other.yaml"
    other.write_text(THRESHOLDS.replace("battery:", "voltage:"), encoding="utf-8")
    command = ["replay", bag(tmp_path, FALLING), "--thresholds", thresholds, "--against", str(other)]
    assert main([*command, "--allow-missing"]) == 2
    assert (
        "no signal is recorded: voltage (/voltage is not recorded); the recordings have /battery;"
        in capsys.readouterr().err
    )


def unreadable(folder: Path, kind: str) -> str:
    """Returns the path of a recording from which nothing can be read."""
    if kind == "undecodable":
        too_long = {"std_msgs/msg/Float32": ("ros2msg", "float64 data")}
        return write_mcap(folder / "a.mcap", values("/battery", [50.0] * 99), definitions=too_long)
    if kind == "empty.bag":
        return write_bag(folder / kind, [])
    if kind == "damaged.bag":
        found = Path(bag(folder, [50.0] * 99, kind))
        found.write_bytes(found.read_bytes().replace(b"compression=none", b"compression=nope"))
        return str(found)
    if kind.endswith(".db3"):
        found = next(Path(write_folder(folder / "rosbag2", values("/battery", [50.0]))).glob("*.db3"))
        with contextlib.closing(sqlite3.connect(found)) as database:
            database.execute(f"DROP TABLE {kind[:-4]}")
        return str(found)
    whole = Path(bag(folder, [50.0]) if kind == "cut.bag" else write_mcap(folder / "a.mcap", values("/battery", [5.0])))
    path = folder / kind
    path.write_bytes(whole.read_bytes()[: 13 if kind == "cut.bag" else 8])
    return str(path)


@pytest.mark.parametrize(
    "kind", ["undecodable", "empty.bag", "damaged.bag", "messages.db3", "topics.db3", "cut.bag", "cut.mcap"]
)
def test_a_recording_from_which_nothing_can_be_read_is_an_error_whatever_the_options(
    tmp_path: Path, thresholds: str, capsys: pytest.CaptureFixture[str], kind: str
) -> None:
    (tmp_path / "other").mkdir()
    path, good = unreadable(tmp_path / "other", kind), bag(tmp_path, [50.0] * 99, "good.bag")
    for recordings in ([path], [good, path]):
        options = ["--thresholds", thresholds, "--allow-missing", "--fail-on", "never"]
        assert main(["replay", *recordings, *options]) == 2
        printed = capsys.readouterr()
        assert (printed.err.count("\n"), printed.err.startswith(f"{path}: ")) == (1, True)
        assert "alerts" not in printed.out  # neither the table nor a verdict


def test_messages_that_cannot_be_decoded_are_reported(
    tmp_path: Path, thresholds: str, capsys: pytest.CaptureFixture[str]
) -> None:
    recording = Path(bag(tmp_path, [50.0] * 3))
    data = recording.read_bytes()
    recording.write_bytes(data[: len(data) - 20])
    main(["replay", str(recording), "--thresholds", thresholds])
    assert capsys.readouterr().err.startswith("WARN: ")


@pytest.mark.parametrize(
    ("arguments", "expected"),
    [
        (["missing.bag"], "missing.bag"),
        (["{bag}", "--from", "100"], "no signal was judged: battery (/battery has no samples)"),
        (["{bag}", "--from", "2", "--to", "1"], "no signal was judged: battery (/battery has no samples)"),
        (["{bag}", "--from", "soon"], "expected a number of seconds, 0 or more, got 'soon'"),
        (["{bag}", "--report", "/nowhere/report.html"], "there is no such folder that can be written"),
        (["{bag}", "--report", "/dev/null"], "is not a file"),
        (["{bag}", "--thresholds", "missing.yaml"], "missing.yaml"),
        (["{bag}", "--use-sim-time"], "/clock"),
    ],
)
def test_wrong_usage_is_one_line(
    tmp_path: Path, thresholds: str, capsys: pytest.CaptureFixture[str], arguments: list[str], expected: str
) -> None:
    recording = bag(tmp_path, [50.0] * 4)
    given = [argument.replace("{bag}", recording) for argument in arguments]
    if "--thresholds" not in given:
        given += ["--thresholds", thresholds]
    assert main(["replay", *given]) == 2
    printed = capsys.readouterr()
    assert (printed.out, printed.err.count("\n")) == ("", 1)
    assert expected in printed.err


def test_an_error_in_the_second_file_names_file_and_line(
    tmp_path: Path, thresholds: str, capsys: pytest.CaptureFixture[str]
) -> None:
    other = tmp_path / "other.yaml"
    other.write_text(
        WITH_GPS.replace("std_msgs/Float32, warn_below: 1.0", "std_msgs/Float32, field: x"), encoding="utf-8"
    )
    recording = write_bag(tmp_path / "test.bag", [*values("/gps", [5.0]), *values("/battery", [5.0])])
    assert main(["replay", recording, "--thresholds", thresholds, "--against", str(other)]) == 2
    assert capsys.readouterr().err.startswith(f"{other}:6: alert_system.ros__parameters.signals.gps: ")


def test_the_report_is_one_file_and_readable_by_others(tmp_path: Path, thresholds: str) -> None:
    report = tmp_path / "report.html"
    main(["replay", bag(tmp_path, FALLING), "--thresholds", thresholds, "--report", str(report)])
    page = report.read_text(encoding="utf-8")
    assert "<h1>Replay of test.bag</h1>" in page
    assert "battery WARN: 15 % is below 20 % (was OK for 10 s)" in page
    assert [file.name for file in tmp_path.iterdir() if ".html" in file.name] == ["report.html"]
    assert os.stat(report).st_mode & 0o044 == 0o044 & ~_umask()


def _umask() -> int:
    mask = os.umask(0)
    os.umask(mask)
    return mask


def test_simulated_time_is_that_of_the_recorded_clock(
    tmp_path: Path, thresholds: str, capsys: pytest.CaptureFixture[str]
) -> None:
    clock, stamp = ROS1.types["rosgraph_msgs/msg/Clock"], ROS1.types["builtin_interfaces/msg/Time"]
    # Simulated time runs at half speed: 100 s at the start.
    ticks = [
        Recorded(second - 0.5, "/clock", clock(clock=stamp(sec=100 + second // 2, nanosec=0))) for second in range(30)
    ]
    recording = write_bag(tmp_path / "test.bag", [*ticks, *values("/battery", FALLING)])
    main(["replay", recording, "--thresholds", thresholds, "--use-sim-time", "--json"])
    first, _ = map(json.loads, capsys.readouterr().out.splitlines())
    assert (first["now_s"], first["since_s"]) == (105.0, 100.0)


@pytest.mark.parametrize(
    ("library", "form"),
    [
        ("rosbags", "without_definitions"),
        ("lz4", "lz4.bag"),
        ("mcap", "none.mcap"),
        ("zstandard", "zstd.mcap"),
    ],
)
def test_a_missing_library_is_named_with_the_command_that_installs_it(
    tmp_path: Path, thresholds: str, command: list[str], environment: dict[str, str], library: str, form: str
) -> None:
    path, messages = tmp_path / form, values("/battery", [50.0])
    if path.suffix == ".bag":
        recording = write_bag(path, messages, path.stem)
    else:
        is_mcap = bool(path.suffix)
        recording = write_mcap(path, messages, compression=path.stem) if is_mcap else write_folder(path, messages)
        for file in path.glob("*.db3"):
            with contextlib.closing(sqlite3.connect(file)) as database:
                database.execute("DROP TABLE IF EXISTS message_definitions")
    code = (
        f"import sys; sys.modules[{library!r}] = None; from robot_health_monitor.__main__ import main; "
        f"sys.exit(main(['replay', {recording!r}, '--thresholds', {thresholds!r}]))"
    )
    ended = subprocess.run([command[0], "-c", code], env=environment, stderr=subprocess.PIPE, text=True, timeout=60)
    assert (ended.returncode, ended.stderr.count("\n")) == (3, 1)
    assert ended.stderr == f"robot-health: {library} is not installed: pip install {library}\n"


def test_a_bag_with_definitions_needs_none_of_the_libraries(
    tmp_path: Path, thresholds: str, command: list[str], environment: dict[str, str]
) -> None:
    recording = write_bag(tmp_path / "a.bag", values("/battery", FALLING), "bz2")
    arguments = ["replay", recording, "--thresholds", thresholds, "--report", str(tmp_path / "report.html")]
    code = (
        "import sys; sys.modules.update(dict.fromkeys(['lz4', 'mcap', 'numpy', 'rosbags', 'zstandard'])); "
        f"from robot_health_monitor.__main__ import main; sys.exit(main({arguments!r}))"
    )
    ended = subprocess.run([command[0], "-c", code], env=environment, stdout=subprocess.PIPE, text=True, timeout=60)
    assert ended.returncode == 1
    assert ended.stdout.endswith("1 alert\n")


def test_all_missing_libraries_are_named_at_once(
    tmp_path: Path, command: list[str], environment: dict[str, str]
) -> None:
    recording = tmp_path / "a.mcap"
    recording.write_bytes(b"")
    names = sorted(requirement.partition(">=")[0] for requirement in recordings_requirements())
    code = (
        f"import sys; sys.modules.update(dict.fromkeys({names!r})); "
        f"from robot_health_monitor.__main__ import main; sys.exit(main(['replay', {str(recording)!r}]))"
    )
    ended = subprocess.run([command[0], "-c", code], env=environment, stderr=subprocess.PIPE, text=True, timeout=60)
    assert ended.returncode == 3
    assert ended.stderr == (
        "robot-health: lz4, mcap, rosbags, zstandard are not installed: pip install lz4 mcap rosbags zstandard\n"
    )


def test_an_interrupt_is_no_success(
    tmp_path: Path, thresholds: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def interrupt(*_: Any, **__: Any) -> None:
        raise KeyboardInterrupt

    recording = bag(tmp_path, FALLING)
    monkeypatch.setattr("robot_health_monitor.recordings.judging.Judge.run", interrupt)
    assert main(["replay", recording, "--thresholds", thresholds]) == 3
    assert capsys.readouterr().err == "robot-health: interrupted before the end of the recordings\n"


def test_output_that_cannot_be_written_is_a_failure(
    tmp_path: Path, thresholds: str, command: list[str], environment: dict[str, str]
) -> None:
    recording = bag(tmp_path, [50.0, 5.0] * 2000)
    with open("/dev/full", "w", encoding="utf-8") as full:
        ended = subprocess.run(
            [*command, "replay", recording, "--thresholds", thresholds],
            stdout=full,
            stderr=subprocess.PIPE,
            env=environment,
            text=True,
            timeout=60,
        )
    assert ended.returncode == 3
    assert ended.stderr == "robot-health: the output cannot be written: No space left on device\n"


@pytest.mark.newest_python
@pytest.mark.parametrize(
    "name", [b"caf\xe9", b"esc\x1b[31m", b"two\nlines", "r\u202eev".encode(), b" ", b"?#%41&"], ids=repr
)
@pytest.mark.parametrize("kind", [".bag", ".mcap", ".db3", ""])
def test_a_recording_may_have_any_name(
    tmp_path: Path, thresholds: str, capfd: pytest.CaptureFixture[str], name: bytes, kind: str
) -> None:
    messages = values("/battery", [50.0, 15.0, *[50.0] * 20])  # suggest needs 20 messages
    folder = tmp_path / "folder"
    if kind in (".bag", ".mcap"):
        folder.mkdir()
        source = (write_bag if kind == ".bag" else write_mcap)(folder / f"a{kind}", messages)
    else:
        source = write_folder(folder, messages)
        source = str(next(folder.glob("*.db3"))) if kind else source
    path = os.fsdecode(os.path.join(os.fsencode(tmp_path), name + kind.encode()))
    os.rename(source, path)
    report = tmp_path / "report.html"
    assert main(["replay", path, "--thresholds", thresholds, "--report", str(report)]) == 1
    printed = capfd.readouterr()
    assert printed.err == ""
    assert "battery WARN: 15 % is below 20 %" in printed.out
    assert "battery WARN" in report.read_text(encoding="utf-8")
    assert main(["replay", path, "--thresholds", thresholds, "--json"]) == 1
    first = json.loads(capfd.readouterr().out.splitlines()[0])
    assert first["robot"].isprintable()
    assert first["robot"]
    assert main(["suggest", path]) == 0
    assert capfd.readouterr().out.startswith("# Suggested by")
