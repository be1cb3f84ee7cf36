"""What a report of `robot-health replay` may replace, and what it never does."""

from __future__ import annotations

import os
from pathlib import Path

import pytest
from harness.recorded import values, write_bag, write_folder

from robot_health_monitor.__main__ import main

THRESHOLDS = "alert_system: {ros__parameters: {signals: {battery: {warn_below: 20.0}}}}\n"


@pytest.fixture
def files(tmp_path: Path) -> Path:
    """Returns a folder with recordings and configurations, and links to them."""
    write_bag(tmp_path / "night.bag", values("/battery", [50.0] * 3))
    write_folder(tmp_path / "night", values("/battery", [50.0] * 3))
    for name in ("thresholds.yaml", "other.yaml"):
        (tmp_path / name).write_text(THRESHOLDS, encoding="utf-8")
    (tmp_path / "symbolic.html").symlink_to("night.bag")
    os.link(tmp_path / "night.bag", tmp_path / "hard.html")
    (tmp_path / "to_database.html").symlink_to(next((tmp_path / "night").glob("*.db3")))
    (tmp_path / "to_folder").symlink_to(".")
    return tmp_path


def replay(folder: Path, report: str, *options: str) -> int:
    """Replays both recordings with both configurations; returns the exit code."""
    recordings = [str(folder / "night.bag"), str(folder / "night")]
    files = ["--thresholds", str(folder / "thresholds.yaml"), "--against", str(folder / "other.yaml")]
    return main(["replay", *recordings, *files, "--report", str(folder / report), *options])


@pytest.mark.parametrize("options", [[], ["--force"]], ids=["", "force"])
@pytest.mark.parametrize(
    "report",
    [
        "night.bag",
        "night/metadata.yaml",
        "thresholds.yaml",
        "other.yaml",
        "symbolic.html",
        "hard.html",
        "to_database.html",
        "to_folder/night.bag",
        "./night/../night.bag",
    ],
)
def test_a_file_that_is_read_is_never_replaced(
    files: Path, capsys: pytest.CaptureFixture[str], report: str, options: list[str]
) -> None:
    before = {path: path.read_bytes() for path in files.rglob("*") if path.is_file()}
    assert replay(files, report, *options) == 2
    printed = capsys.readouterr()
    assert printed.err == f"{files / report}: --report: is one of the files that this command reads\n"
    assert printed.out == ""
    assert {path: path.read_bytes() for path in files.rglob("*") if path.is_file()} == before


def test_a_file_that_is_not_a_report_is_replaced_with_force_only(
    files: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    other = files / "page.html"
    for text in ("", "<!DOCTYPE html><title>mine</title>"):
        other.write_text(text, encoding="utf-8")
        assert replay(files, "page.html") == 2
        assert capsys.readouterr().err == (
            f"{other}: --report: exists and is not a report of robot-health; --force replaces it\n"
        )
        assert other.read_text(encoding="utf-8") == text
    assert replay(files, "page.html", "--force") == 0
    assert "<h1>Replay of night.bag, night</h1>" in other.read_text(encoding="utf-8")


def test_an_earlier_report_is_replaced(files: Path) -> None:
    assert replay(files, "report.html") == 0
    first = (files / "report.html").read_bytes()
    assert replay(files, "report.html", "--to", "1") == 0
    assert (files / "report.html").read_bytes() != first


def test_a_link_to_a_report_stays_a_link(files: Path) -> None:
    assert replay(files, "report.html") == 0
    (files / "latest.html").symlink_to("report.html")
    assert replay(files, "latest.html") == 0
    assert (files / "latest.html").is_symlink()
    assert not [path for path in files.iterdir() if "part" in path.name]


def test_an_alert_that_changes_its_level_is_one_in_the_verdict(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    falls = [50.0, 15.0, 5.0, 15.0, 50.0]
    write_bag(tmp_path / "night.bag", values("/battery", [*falls, *falls]))
    both = THRESHOLDS.replace("warn_below: 20.0", "warn_below: 20.0, error_below: 10.0")
    (tmp_path / "both.yaml").write_text(both, encoding="utf-8")
    main(["replay", str(tmp_path / "night.bag"), "--thresholds", str(tmp_path / "both.yaml")])
    assert capsys.readouterr().out.splitlines()[-1] == "2 alerts"
