"""Every module has a test file of the same name in the mirrored folder, and lists of folders agree."""

from __future__ import annotations

import ast
import functools
import importlib
import os
import re
from pathlib import Path
from typing import Iterator, Mapping

import pytest
from harness.packaging_workspace import FOLDERS, NAME

pytestmark = pytest.mark.newest_python

ROOT = Path(__file__).resolve().parents[1]

TESTED_ELSEWHERE = {
    "core/port/middleware.py": "an interface: harness/port_conformance.py tests each implementation",
    "core/sensors/source.py": "an interface: tests/core/sensors tests each implementation",
    "runtime/bridge/connection.py": "the base of the bridges' connections: tests/rosbridge/client/test_connection.py",
    "runtime/bridge/node.py": "the base of the bridges' nodes: tests/rosbridge/test_conformance.py",
    "runtime/native_node.py": "the base of the adapters over ROS: tests/ros1 and tests/ros2 test each of them",
    "cli/ros1_executables.py": "needs ROS 1: tests/ros1/test_executables.py",
    "cli/ros2_executables.py": "needs ROS 2: tests/ros2/test_executables.py",
}
"""Modules without a test file, with the reason."""


def modules() -> list[Path]:
    """Returns the modules of the package, relative to the repository."""
    files = [file for folder in (*FOLDERS, NAME) for file in sorted((ROOT / folder).rglob("*.py"))]
    return [file.relative_to(ROOT) for file in files if file.name != "__init__.py"]


def expected_test_file(module: Path) -> Path:
    """Returns the test file that belongs to a module: core/nodes/x.py is tested by core/nodes/test_x.py in tests/."""
    folder = Path("cli") if module.parts[0] == NAME else module.parent
    return Path("tests") / folder / f"test_{module.stem.strip('_')}.py"


@pytest.mark.parametrize("module", modules(), ids=str)
def test_each_module_has_its_own_test_file(module: Path) -> None:
    assert module.as_posix() in TESTED_ELSEWHERE or (ROOT / expected_test_file(module)).exists(), expected_test_file(
        module
    )


def test_no_exemption_is_outdated() -> None:
    known = {module.as_posix(): expected_test_file(module) for module in modules()}
    assert [name for name in TESTED_ELSEWHERE if name not in known] == []


def test_both_builds_install_the_same_folders() -> None:
    in_cmake = re.search(r"set\(folders ([^)]*)\)", (ROOT / "CMakeLists.txt").read_text(encoding="utf-8"))
    assert in_cmake is not None
    assert in_cmake[1].split() == list(FOLDERS)


def test_the_coverage_of_every_folder_is_measured() -> None:
    settings = re.search(r"\[tool\.coverage\.run\]\nsource = \[(.*)\]", (ROOT / "pyproject.toml").read_text("utf-8"))
    assert settings is not None
    assert sorted(re.findall(r'"(\w+)"', settings[1])) == sorted([*FOLDERS, NAME])


def test_every_folder_of_modules_is_a_package() -> None:
    folders = {module.parent for module in modules()}
    assert [folder for folder in sorted(folders) if not (ROOT / folder / "__init__.py").exists()] == []


def test_the_root_package_links_to_every_folder() -> None:
    links = {path.name: os.readlink(path) for path in (ROOT / NAME).iterdir() if path.is_symlink()}
    assert links == {folder: f"../{folder}" for folder in FOLDERS}


def packages() -> list[str]:
    """Returns the packages of the project with names of their own, as paths relative to the repository."""
    files = [file for folder in (*FOLDERS, NAME) for file in sorted((ROOT / folder).rglob("__init__.py"))]
    with_names = [file for file in files if len(ast.parse(file.read_text("utf-8")).body) > 1]
    return [file.parent.relative_to(ROOT).as_posix() for file in with_names]


def module_name(folder: str) -> str:
    return folder.replace("/", ".") if folder.startswith(NAME) else f"{NAME}.{folder.replace('/', '.')}"


@functools.lru_cache(maxsize=None)
def imported_names() -> Mapping[str, set[str]]:
    """Returns the names that are imported from each module anywhere in the repository."""
    found: dict[str, set[str]] = {}
    for module, name in _imports():
        found.setdefault(module, set()).add(name)
    return found


def _imports() -> Iterator[tuple[str, str]]:
    """Yields (module, name) for each `from module import name` of the repository, with absolute names of modules."""
    folders = (*FOLDERS, NAME, "tests", "docs", "benchmarks", "examples", "launch")
    for file in (file for folder in folders for file in sorted((ROOT / folder).rglob("*.py"))):
        package = module_name(file.parent.relative_to(ROOT).as_posix()).split(".")
        for node in ast.walk(ast.parse(file.read_text("utf-8"))):
            if isinstance(node, ast.ImportFrom):
                above = package[: len(package) - node.level + 1] if node.level else []
                module = ".".join([*above, *filter(None, [node.module])])
                yield from ((module, alias.name) for alias in node.names)


def is_module(folder: str, name: str) -> bool:
    places = [ROOT / folder / name, ROOT / name] if folder == NAME else [ROOT / folder / name]
    return any(place.is_dir() or place.with_suffix(".py").exists() for place in places)


@pytest.mark.parametrize("folder", packages())
def test_a_package_lists_the_names_that_others_import_from_it(folder: str) -> None:
    package = importlib.import_module(module_name(folder))
    listed = getattr(package, "__all__", None)
    assert listed is not None, "has no __all__"
    assert [name for name in listed if not hasattr(package, name)] == []
    used = {name for name in imported_names().get(module_name(folder), ()) if not is_module(folder, name)}
    assert sorted(used - set(listed)) == []
