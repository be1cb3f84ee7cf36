"""Missing libraries are named all at once, with the command that installs them."""

from __future__ import annotations

import importlib
import sys
from pathlib import Path

import pytest

from robot_health_monitor.runtime.libraries import MissingLibraryError, libraries, missing_libraries, missing_text


def without(monkeypatch: pytest.MonkeyPatch, *names: str) -> None:
    for name in names:
        monkeypatch.setitem(sys.modules, name, None)


def test_everything_that_is_missing_is_named_at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    without(monkeypatch, "cbor2", "aiohttp")
    with pytest.raises(MissingLibraryError) as raised, libraries("cbor2", "json", "aiohttp"):
        importlib.import_module("aiohttp")
    assert str(raised.value) == "aiohttp, cbor2 are not installed: pip install aiohttp cbor2"


def test_the_import_that_failed_is_named_although_it_is_not_listed(monkeypatch: pytest.MonkeyPatch) -> None:
    without(monkeypatch, "yaml")
    with pytest.raises(MissingLibraryError) as raised, libraries("json"):
        importlib.import_module("yaml")
    assert str(raised.value) == "PyYAML is not installed: pip install PyYAML"


def test_what_is_not_needed_may_be_missing(monkeypatch: pytest.MonkeyPatch) -> None:
    without(monkeypatch, "aiohttp")
    with libraries("aiohttp"):
        importlib.import_module("json")


def test_a_mistake_in_an_import_is_not_a_missing_library() -> None:
    with pytest.raises(ImportError, match="cannot import name"), libraries("json"):
        raise ImportError("cannot import name 'x' from 'json'", name="json")


def test_a_library_that_cannot_be_loaded_counts_as_missing(monkeypatch: pytest.MonkeyPatch) -> None:
    without(monkeypatch, "cbor2")
    assert missing_libraries(ImportError("libfoo.so: cannot open shared object file"), "cbor2", "json") == ["cbor2"]


def test_the_line_says_what_to_do() -> None:
    assert missing_text(["rich"]) == "rich is not installed: pip install rich"


def in_system_python(monkeypatch: pytest.MonkeyPatch) -> None:
    if not Path("/usr/bin/apt").exists():
        pytest.skip("apt is not installed")
    monkeypatch.setattr(sys, "base_prefix", "/usr")
    monkeypatch.setattr(sys, "prefix", "/usr")


def test_in_the_system_s_python_the_line_has_the_packages_of_apt(monkeypatch: pytest.MonkeyPatch) -> None:
    in_system_python(monkeypatch)
    assert missing_text(["aiohttp"]) == "aiohttp is not installed: apt install python3-aiohttp"
    packages = missing_text(["PyYAML", "prometheus_client"]).partition(": ")[2]
    assert packages == "apt install python3-yaml python3-prometheus-client"


def test_what_apt_does_not_have_comes_with_pipx(monkeypatch: pytest.MonkeyPatch) -> None:
    in_system_python(monkeypatch)
    hint = "apt does not have them all; install robot-health with pipx (docs/install.md)"
    assert missing_text(["lz4", "mcap", "rosbags"]) == f"lz4, mcap, rosbags are not installed: {hint}"


def test_what_pipx_installed_gets_more_by_pipx(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    venv = tmp_path / "robot-health-monitor"
    venv.mkdir()
    (venv / "pipx_metadata.json").write_text("{}")
    monkeypatch.setattr(sys, "prefix", str(venv))
    expected = "lz4, mcap are not installed: pipx inject robot-health-monitor lz4 mcap"
    assert missing_text(["lz4", "mcap"]) == expected


def test_in_a_virtual_environment_pip_installs(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    in_system_python(monkeypatch)
    monkeypatch.setattr(sys, "prefix", str(tmp_path))
    assert missing_text(["rich"]) == "rich is not installed: pip install rich"
