"""Tokens come from a file or the environment, and never appear in an error."""

from __future__ import annotations

import os
import threading
from pathlib import Path

import pytest

from robot_health_monitor.core.values.errors import ConfigError
from robot_health_monitor.runtime.tokens import LARGEST_TOKEN, TOKEN_VARIABLE, TokenFiles, read_token_file


def write(folder: Path, contents: bytes, mode: int = 0o600) -> str:
    file = folder / "token"
    file.write_bytes(contents)
    file.chmod(mode)
    return str(file)


def no_warning(text: str) -> None:
    raise AssertionError(text)


def test_a_token_is_read_without_the_white_space_around_it(tmp_path: Path) -> None:
    assert read_token_file(write(tmp_path, b"  s3cret\r\n"), no_warning) == "s3cret"


def test_the_longest_token_is_read(tmp_path: Path) -> None:
    token = "x" * LARGEST_TOKEN
    assert read_token_file(write(tmp_path, f"{token}\n".encode()), no_warning) == token


@pytest.mark.parametrize(
    ("contents", "problem"),
    [
        (b" \n", "expected a token, got an empty file"),
        (b"x" * (LARGEST_TOKEN + 1), "expected a token of at most 1024 bytes, got more"),
        (b"s3cret\nother\n", "expected one token of printable ASCII characters without blanks"),
        (b"s3c\x1bret", "expected one token of printable ASCII characters without blanks"),
        (b"s3cr\xff\xe9t", "expected one token of printable ASCII characters without blanks"),
    ],
)
def test_a_file_without_one_token_is_named_and_not_quoted(tmp_path: Path, contents: bytes, problem: str) -> None:
    file = write(tmp_path, contents)
    with pytest.raises(ConfigError) as caught:
        read_token_file(file, no_warning)
    assert str(caught.value) == f"{file}: {problem}"


def test_a_file_that_is_missing_is_named(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="nowhere: token cannot be read: No such file or directory"):
        read_token_file(str(tmp_path / "nowhere"), no_warning)


def test_a_device_without_an_end_is_refused() -> None:
    with pytest.raises(ConfigError, match="at most 1024 bytes"):
        read_token_file("/dev/zero", no_warning)


def test_a_file_that_every_user_may_read_is_a_warning(tmp_path: Path) -> None:
    warnings: list[str] = []
    file = write(tmp_path, b"s3cret", 0o644)
    assert read_token_file(file, warnings.append) == "s3cret"
    assert warnings == [f"{file}: every user of this machine can read this token; protect it with chmod 600"]


def test_the_file_comes_before_the_environment(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(TOKEN_VARIABLE, "other ")
    assert TokenFiles(no_warning).find(write(tmp_path, b"s3cret")) == "s3cret"
    assert TokenFiles(no_warning).find("") == "other"
    monkeypatch.delenv(TOKEN_VARIABLE)
    assert TokenFiles(no_warning).find("") == ""


def test_an_unusable_token_in_the_environment_is_not_quoted(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(TOKEN_VARIABLE, "s3c ret")
    with pytest.raises(ConfigError) as caught:
        TokenFiles(no_warning).find("")
    assert TOKEN_VARIABLE in str(caught.value) and "s3c" not in str(caught.value)


def test_a_file_is_read_again_but_a_pipe_only_once(tmp_path: Path) -> None:
    tokens = TokenFiles(no_warning)
    file = write(tmp_path, b"first")
    assert tokens.find(file) == "first"
    write(tmp_path, b"second")
    assert tokens.find(file) == "second"
    fifo = str(tmp_path / "fifo")
    os.mkfifo(fifo)
    writer = threading.Thread(target=Path(fifo).write_text, args=("s3cret\n",))
    writer.start()
    assert tokens.find(fifo) == "s3cret"
    writer.join()
    assert tokens.find(fifo) == "s3cret"  # nothing writes to it any more: reading it would wait for ever


def test_a_pipe_in_place_of_a_file_is_an_error_and_is_not_waited_for(tmp_path: Path) -> None:
    tokens = TokenFiles(no_warning)
    file = write(tmp_path, b"first")
    assert tokens.find(file) == "first"
    os.unlink(file)
    os.mkfifo(file)
    with pytest.raises(ConfigError, match="expected a file, as before, got a pipe"):
        tokens.find(file)
