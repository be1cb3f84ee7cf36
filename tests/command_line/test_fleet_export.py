"""Which robots have which thresholds, and how the files are written."""

from __future__ import annotations

from pathlib import Path

import pytest

from robot_health_monitor.core import ConfigError
from robot_health_monitor.fleet_export import read_fleet, write_files
from robot_health_monitor.ops.export.fleet import MADE

TEXT = "alert_system:\n  ros__parameters:\n    signals:\n      battery_level: {{warn_below: {}}}\n"


@pytest.fixture
def thresholds(tmp_path: Path) -> str:
    (tmp_path / "thresholds.yaml").write_text(TEXT.format(20.0))
    (tmp_path / "carter.yaml").write_text(TEXT.format(10.0))
    return str(tmp_path / "thresholds.yaml")


def fleet(folder: Path, text: str) -> str:
    (folder / "fleet.yaml").write_text(text)
    return str(folder / "fleet.yaml")


def test_without_a_fleet_file_all_robots_have_the_thresholds_and_none_must_report(thresholds: str) -> None:
    judged, expected = read_fleet(thresholds)

    assert [(each.name, each.robots) for each in judged] == [("robot_health", ())]
    assert expected is None


def test_robots_that_push_need_no_url(thresholds: str, tmp_path: Path) -> None:
    judged, expected = read_fleet(thresholds, fleet(tmp_path, "robots: {husky1: {}, r2: {url: 'ws://r2:9090'}}"))

    assert [each.robots for each in judged] == [()]
    assert expected == ["husky1", "r2"]


def test_robots_are_grouped_by_their_thresholds(thresholds: str, tmp_path: Path) -> None:
    text = "defaults: {thresholds: thresholds.yaml}\nrobots: {a: {}, b: {thresholds: carter.yaml}, c: {}}"

    judged, expected = read_fleet(thresholds, fleet(tmp_path, text))

    bounds = [each.config.signals["battery_level"].warn_below for each in judged]
    assert [list(each.robots) for each in judged] == [["a", "c"], ["b"]]
    assert bounds == [20.0, 10.0]
    assert expected == ["a", "b", "c"]


def test_if_all_robots_have_another_file_it_counts(thresholds: str, tmp_path: Path) -> None:
    judged, _ = read_fleet(thresholds, fleet(tmp_path, "defaults: {thresholds: carter.yaml}\nrobots: {a: {}, b: {}}"))

    assert [each.config.signals["battery_level"].warn_below for each in judged] == [10.0]


def test_a_mistake_in_a_fleet_file_names_file_and_line(thresholds: str, tmp_path: Path) -> None:
    with pytest.raises(ConfigError) as caught:
        read_fleet(thresholds, fleet(tmp_path, "robots:\n  'a b': {}\n"))
    assert f"{tmp_path / 'fleet.yaml'}:2: " in str(caught.value)


def test_files_replace_those_of_an_earlier_export(tmp_path: Path) -> None:
    write_files(str(tmp_path / "out"), {"robot/a.yml": "old", "README.md": f"{MADE} Old."})
    write_files(str(tmp_path / "out"), {"robot/a.yml": "new", "README.md": f"{MADE} New."})

    written = {str(path.relative_to(tmp_path)): path.read_text() for path in tmp_path.rglob("*") if path.is_file()}
    assert written == {"out/robot/a.yml": "new", "out/README.md": f"{MADE} New."}


def test_the_readme_of_a_project_is_not_replaced(tmp_path: Path) -> None:
    (tmp_path / "README.md").write_text("# My robots\n")

    with pytest.raises(ConfigError, match=r"README\.md: is not from an earlier export; expected another folder"):
        write_files(str(tmp_path), {"robot/a.yml": "new", "README.md": f"{MADE} New."})

    assert [file.name for file in tmp_path.rglob("*")] == ["README.md"]
    assert (tmp_path / "README.md").read_text() == "# My robots\n"


def test_an_empty_folder_name_is_refused_and_nothing_is_written(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)

    with pytest.raises(ConfigError, match="expected a folder, got ''"):
        write_files("", {"robot/a.yml": "new", "README.md": MADE})
    assert list(tmp_path.iterdir()) == []


def test_a_folder_that_cannot_be_written_is_one_clear_line(tmp_path: Path) -> None:
    (tmp_path / "out").write_text("a file")

    with pytest.raises(ConfigError, match=r"out/README\.md: cannot be written: "):
        write_files(str(tmp_path / "out"), {"README.md": ""})
