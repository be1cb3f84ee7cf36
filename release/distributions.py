"""Builds the wheel and the source distribution of the last commit; `make dist` calls it.

    python3 release/distributions.py FOLDER      builds both into FOLDER, and checks them

The same commit gives the same bytes: times are those of the commit, and archives have sorted members without owners.
The source distribution holds all files of the commit. The wheel has a CycloneDX SBOM (PEP 770).
"""

from __future__ import annotations

import gzip
import hashlib
import io
import os
import subprocess
import sys
import tarfile
import tempfile
import time
import zipfile
from pathlib import Path
from typing import IO, List, Optional, Sequence

from wheel.wheelfile import WheelFile

ROOT = Path(__file__).resolve().parents[1]
sys.path[:0] = [str(ROOT)]

from release import manifest  # noqa: E402  # found through the line above
from release.sbom import sbom_json  # noqa: E402

NAME = "robot_health_monitor"
_FIRST_ZIP_S = 315_532_800
"""Archives of this format begin in 1980."""


def build(folder: Path, repository: Path = ROOT) -> List[Path]:
    """Builds the last commit into a folder; returns the source distribution and the wheel."""
    folder.mkdir(parents=True, exist_ok=True)
    os.umask(0o022)
    time_s = max(int(_git(repository, "log", "-1", "--format=%ct")), _FIRST_ZIP_S)
    os.environ["SOURCE_DATE_EPOCH"] = str(time_s)  # for setuptools and wheel
    archive = subprocess.run(
        ["git", "-C", str(repository), "archive", "HEAD"], check=True, stdout=subprocess.PIPE
    ).stdout
    with tempfile.TemporaryDirectory() as place:
        source = Path(place, "source")
        _extract(archive, source)
        wheel = _with_sbom(_built_wheel(source, Path(place)), folder, time_s)
    with zipfile.ZipFile(wheel) as archived:
        (metadata,) = (archived.read(name) for name in archived.namelist() if name.endswith(".dist-info/METADATA"))
    return [_source_distribution(archive, metadata, folder, time_s), wheel]


def _git(repository: Path, *arguments: str) -> str:
    done = subprocess.run(["git", "-C", str(repository), *arguments], check=True, stdout=subprocess.PIPE, text=True)
    return done.stdout.strip()


def _built_wheel(source: Path, folder: Path) -> Path:
    """Returns the wheel that the build backend makes of a source tree."""
    variables = {
        **os.environ,
        "PYTHONHASHSEED": "0",
        "TZ": "UTC",
        "LC_ALL": "C.UTF-8",
    }
    code = f"import setuptools.build_meta as backend; print(backend.build_wheel({str(folder)!r}))"
    command = [sys.executable, "-c", code]
    done = subprocess.run(command, cwd=source, env=variables, capture_output=True, text=True)
    if done.returncode:
        sys.exit(f"the wheel could not be built:\n{done.stderr}")
    return folder / done.stdout.split()[-1]


def _extract(archive: bytes, folder: Path) -> None:
    """Extracts a tar archive with the usual modes, whatever those of its members are."""
    with tarfile.open(fileobj=io.BytesIO(archive)) as members:
        members.extraction_filter = lambda member, path: member  # it is our own
        for member in members.getmembers():
            member.mode = _mode(member)
        members.extractall(folder)


def _mode(member: tarfile.TarInfo) -> int:
    return 0o755 if member.isdir() or member.mode & 0o100 else 0o644


def _source_distribution(archive: bytes, metadata: bytes, folder: Path, time_s: int) -> Path:
    """Writes the files of a tar archive and PKG-INFO: sorted, with one time, and without owners."""
    base = f"{NAME}-{manifest.text('version')}"
    content = io.BytesIO()
    with tarfile.open(fileobj=io.BytesIO(archive)) as committed, tarfile.open(
        fileobj=content, mode="w", format=tarfile.PAX_FORMAT
    ) as written:

        def add(name: str, member: tarfile.TarInfo, stream: Optional[IO[bytes]]) -> None:
            plain = tarfile.TarInfo(f"{base}/{name}")
            plain.type, plain.linkname, plain.size = member.type, member.linkname, member.size
            plain.mode, plain.mtime = _mode(member), time_s
            written.addfile(plain, stream)

        information = tarfile.TarInfo()
        information.size = len(metadata)
        add("PKG-INFO", information, io.BytesIO(metadata))
        for member in sorted(committed.getmembers(), key=lambda each: each.name):
            add(member.name, member, committed.extractfile(member) if member.isfile() else None)
    target = folder / f"{base}.tar.gz"
    with target.open("wb") as stream, gzip.GzipFile("", "wb", fileobj=stream, mtime=time_s) as packed:
        packed.write(content.getvalue())
    return target


def _with_sbom(wheel: Path, folder: Path, time_s: int) -> Path:
    """Rewrites a wheel: sorted, with one time, and with an SBOM in its metadata."""
    date_time = time.gmtime(time_s)[:6]
    target = folder / wheel.name
    with zipfile.ZipFile(wheel) as built, WheelFile(str(target), "w", compression=zipfile.ZIP_DEFLATED) as written:

        def add(name: str, content: bytes) -> None:
            info = zipfile.ZipInfo(name, date_time)
            info.external_attr = (0o755 if content.startswith(b"#!") else 0o644) << 16 | 0o100000 << 16
            info.compress_type = zipfile.ZIP_DEFLATED
            written.writestr(info, content)

        names = sorted(name for name in built.namelist() if not name.endswith(("/", ".dist-info/RECORD")))
        for name in names:
            add(name, built.read(name))
        metadata = next(name for name in names if name.endswith(".dist-info/METADATA"))
        sbom = sbom_json(built.read(metadata).decode("utf-8"), manifest.urls(), time_s)
        add(f"{metadata.rpartition('/')[0]}/sboms/{NAME}.cdx.json", sbom.encode("utf-8"))
    return target


def check(files: Sequence[Path]) -> None:
    """Checks files as the package index does, and the content of wheels; ends the process if there is a mistake."""
    wheels = [str(file) for file in files if file.suffix == ".whl"]
    for command in (["twine", "check", "--strict", *map(str, files)], ["check_wheel_contents", *wheels]):
        done = subprocess.run(
            [sys.executable, "-m", *command], stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True
        )
        if done.returncode:
            sys.exit(done.stdout)


def main() -> None:
    """Builds and checks both; prints their sizes and hashes."""
    changed = _git(ROOT, "status", "--porcelain")
    if changed:
        print("WARN: builds the last commit; uncommitted changes are not included", file=sys.stderr)
    files = build(Path(sys.argv[1]))
    check(files)
    for file in files:
        content = file.read_bytes()
        print(f"{hashlib.sha256(content).hexdigest()}  {file.name}  {len(content) / 1e6:.2f} MB")


if __name__ == "__main__":
    main()
