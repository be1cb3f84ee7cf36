"""Missing libraries are named all at once, with the command that installs them."""

from __future__ import annotations

import importlib
import sys

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
