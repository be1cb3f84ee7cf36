"""Builds the wheel and the source distribution of the last commit; `make dist` calls it.

    python3 release/distributions.py FOLDER      builds both into FOLDER, and checks them

The same commit gives the same bytes: times are those of the commit, and archives have sorted members without owners.
The source distribution holds all files of the commit. The wheel has an SBOM of CycloneDX (PEP 770).
"""

from __future__ import annotations

import os
import sys
import tempfile
from email import message_from_string
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[1]
sys.path[:0] = [str(ROOT)]

from release import manifest  # noqa: E402  # found through the line above

NAME = "robot_health_monitor"


def build(folder: Path) -> list[Path]:
    """Builds the last commit into a folder; returns the source distribution and the wheel."""
    folder = folder.resolve()
    folder.mkdir(parents=True, exist_ok=True)
    os.umask(0o022)
    time_s = manifest.git(ROOT, "log", "-1", "--format=%ct")
    # For setuptools and wheel.
    os.environ.update(SOURCE_DATE_EPOCH=time_s, PYTHONHASHSEED="0", TZ="UTC", LC_ALL="C.UTF-8")
    version = manifest.text("version")
    base = f"{NAME}-{version}"
    with tempfile.TemporaryDirectory() as place:
        source, built = manifest.unpack_sources(ROOT, Path(place), "source"), Path(place, "built")
        _run("pip", "wheel", "--quiet", "--no-deps", "--no-build-isolation", "--wheel-dir", built, source)
        (wheel,) = built.iterdir()
        _run("wheel", "unpack", "--dest", place, wheel)
        information = Path(place, base, f"{base}.dist-info")
        _write_sbom(information, version)
        _run("wheel", "pack", "--dest-dir", folder, Path(place, base))
        metadata = (information / "METADATA").rename(Path(place, "PKG-INFO"))
        sdist = folder / f"{base}.tar.gz"
        options = [f"--prefix={base}/", f"--add-file={metadata}", f"--output={sdist}"]
        manifest.git(ROOT, *manifest.ARCHIVE, *options, "HEAD")
    return [sdist, folder / wheel.name]


def _write_sbom(information: Path, version: str) -> None:
    """Writes what the package is and requires below the metadata of its wheel; what pip chooses depends on the day."""
    required = message_from_string((information / "METADATA").read_text("utf-8")).get_all("Requires-Dist", [])
    folder = information / "sboms"
    folder.mkdir()
    with tempfile.NamedTemporaryFile("w", suffix=".toml") as project:
        project.write(f'[project]\nname = "{NAME}"\nversion = "{version}"\n')
        project.flush()
        options = ["--pyproject", project.name, "--output-reproducible", "-o", folder / f"{NAME}.cdx.json", "-"]
        _run("cyclonedx_py", "requirements", *options, stdin="\n".join(required))


def _run(*command: object, **options: Any) -> None:
    """Runs a tool of Python; ends the program if it fails."""
    manifest.run(ROOT, sys.executable, "-m", *command, **options)


def main() -> None:
    """Builds both, checks them as the package index does; prints their sizes."""
    if manifest.git(ROOT, "status", "--porcelain"):
        print("WARN: builds the last commit; uncommitted changes are not included", file=sys.stderr)
    files = build(Path(sys.argv[1]))
    _run("twine", "check", "--strict", *files)
    _run("check_wheel_contents", files[1])
    for file in files:
        print(f"{file.name}  {file.stat().st_size / 1e6:.2f} MB")


if __name__ == "__main__":
    main()
