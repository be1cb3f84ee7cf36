"""Missing libraries are named all at once, with the command that installs them."""

from __future__ import annotations

import importlib
import sys
import sysconfig
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


def in_debian_python(monkeypatch: pytest.MonkeyPatch, folder: Path) -> None:
    """Python as Debian 12 and Ubuntu 24.04 install it: pip refuses to install into it."""
    if not Path("/usr/bin/apt").exists():
        pytest.skip("apt is not installed")
    (folder / "EXTERNALLY-MANAGED").touch()
    monkeypatch.setattr(sysconfig, "get_path", lambda name: str(folder))
    monkeypatch.setattr(sys, "prefix", sys.base_prefix)


def test_where_pip_may_not_install_the_line_has_the_packages_of_apt(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    in_debian_python(monkeypatch, tmp_path)
    assert missing_text(["cbor2", "rich"]) == "cbor2, rich are not installed: apt install python3-cbor2 python3-rich"
    packages = missing_text(["PyYAML", "prometheus_client"]).partition(": ")[2]
    assert packages == "apt install python3-yaml python3-prometheus-client"


def test_what_debian_does_not_have_comes_from_pip(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    in_debian_python(monkeypatch, tmp_path)
    assert missing_text(["mcap", "numpy"]) == "mcap, numpy are not installed: pip install mcap numpy"


def test_in_a_virtual_environment_pip_installs_on_debian_too(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    in_debian_python(monkeypatch, tmp_path)
    monkeypatch.setattr(sys, "prefix", str(tmp_path))
    assert missing_text(["rich"]) == "rich is not installed: pip install rich"
