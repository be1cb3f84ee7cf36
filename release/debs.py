"""Builds the Debian packages; `make deb` calls it.

    python3 release/debs.py FOLDER [NAME...]      builds the packages (default: all) into FOLDER

`robot-health` is the command line without ROS, from release/debian. `jazzy`, `one` (ROS One) and `debian` (Debian's own
ROS 1) are the nodes, made with bloom as the ROS build farm does it, but with the index in release/index.
"""

from __future__ import annotations

import argparse
import os
import re
import shutil
import subprocess
import sys
import tempfile
import time
from email.utils import formatdate
from pathlib import Path
from typing import Mapping, Sequence
from xml.etree import ElementTree

ROOT = Path(__file__).resolve().parents[1]
sys.path[:0] = [str(ROOT), str(ROOT / "tests")]

from harness.requirements import runtime_requirements  # noqa: E402  # found through the line above

from release import manifest  # noqa: E402
from robot_health_monitor.cli.arguments import complete_parser  # noqa: E402
from robot_health_monitor.runtime.libraries import debian_package  # noqa: E402

COMMAND_LINE = "robot-health"


DISTROS = {
    "jazzy": ("ubuntu", "noble", "rosdebian"),
    "one": ("ubuntu", "noble", "rosdebian"),
    "debian": ("debian", "bookworm", "debian"),
}
"""System, its release, and bloom's generator: rosdebian installs to /opt/ros, debian to /usr."""
PACKAGES = (COMMAND_LINE, *DISTROS)


def dependencies() -> tuple[Sequence[str], Sequence[str]]:
    """Returns what the package robot-health depends on and what it recommends.

    Names and oldest versions are those of setup.py; package.xml has which of them are needed.
    """
    needed = [each.text for each in ElementTree.parse(manifest.MANIFEST).findall("exec_depend")]
    packages: tuple[list[str], list[str]] = ([], [])
    for requirement in runtime_requirements():
        name, relation, version = re.fullmatch(r"([\w-]+)(?:(>=)([\d.]+))?", requirement).groups()  # type: ignore[union-attr]
        package = debian_package(name)
        packages[package not in needed].append(f"{package} (>= {version})" if relation else package)
    return packages


def fields(date_s: float) -> Mapping[str, str]:
    """Returns what stands for @NAME@ in the files of release/debian."""
    maintainer = ElementTree.parse(manifest.MANIFEST).find("maintainer")
    assert maintainer is not None
    depends, recommends = dependencies()
    return {
        "AUTHOR": manifest.text("author"),
        "DATE": formatdate(date_s),
        "DEPENDS": ", ".join(depends),
        "HOMEPAGE": manifest.urls()["website"],
        "MAINTAINER": f"{maintainer.text} <{maintainer.get('email')}>",
        "RECOMMENDS": ", ".join(recommends),
        "REPOSITORY": manifest.urls()["repository"],
        "VERSION": manifest.text("version"),
        "YEAR": time.strftime("%Y", time.gmtime(date_s)),
    }


def write_debian_folder(source: Path, date_s: float) -> None:
    """Writes debian/ of robot-health into a copy of the source tree."""
    shutil.copytree(ROOT / "release" / "debian", source / "debian")
    known = fields(date_s)
    for file in (source / "debian").iterdir():
        if file.is_file():
            text = re.sub(r"@([A-Z]+)@", lambda field: known.get(field[1], field[0]), file.read_text("utf-8"))
            file.write_text(text, "utf-8")


def write_completions(folder: Path) -> None:
    """Writes what completes the arguments of robot-health in bash and zsh."""
    import shtab

    for shell, name in (("bash", "robot-health.bash"), ("zsh", "_robot-health")):
        (folder / name).write_text(shtab.complete(complete_parser(), shell), "utf-8")


def index_variables(folder: Path) -> dict[str, str]:
    """Returns the variables with which bloom and rosdep read release/index, an index of distributions and rosdep keys.

    Every ROS package that package.xml names is in every distribution, and the other keys are Debian's packages. A key
    that the public rosdep installs with pip must not be in package.xml. What they need is written to `folder`.
    """
    index = f"file://{ROOT}/release/index"
    (folder / "local.list").write_text(f"yaml {index}/rosdep.yaml\n")
    return {
        **os.environ,
        "ROSDISTRO_INDEX_URL": f"{index}/index.yaml",
        "ROSDEP_SOURCE_PATH": str(folder),
        "ROS_HOME": str(folder / "home"),
    }


def generate(source: Path, name: str, variables: Mapping[str, str]) -> None:
    """Writes debian/ of the nodes into a copy of the source tree, with bloom."""
    system, codename, generator = DISTROS[name]
    options = ["--ros-distro", name, "--os-name", system, "--os-version", codename]
    run(["bloom-generate", generator, *options], source, variables)
    if generator == "debian":  # modules in /usr are compiled when they are installed, and cleaned when removed
        replace(source / "debian" / "rules", "dh $@ -v ", "dh $@ -v --with python3 ")
        replace(source / "debian" / "control", "${shlibs:Depends}", "${python3:Depends}")
    else:
        package = f"ros-{name}-{manifest.text('name').replace('_', '-')}"
        shutil.copy(ROOT / "release" / "lintian-overrides", source / "debian" / f"{package}.lintian-overrides")


def replace(file: Path, old: str, new: str) -> None:
    """Replaces a text that must be in a file."""
    text = file.read_text("utf-8")
    assert old in text, f"{file} has no {old}"
    file.write_text(text.replace(old, new), "utf-8")


def build(source: Path) -> None:
    """Builds the packages of a source tree with debian/, in its parent folder."""
    system = {"PATH": "/usr/sbin:/usr/bin:/sbin:/bin", "HOME": str(source.parent), "LC_ALL": "C.UTF-8"}
    without_tests = {"DEB_BUILD_OPTIONS": "nocheck", "DEB_BUILD_PROFILES": "nocheck"}
    # -d: the packages of ROS are not installed, and neither build needs more than Debian's catkin and setuptools.
    run(["dpkg-buildpackage", "-d", "-us", "-uc", "-b"], source, {**system, **without_tests})


def run(command: Sequence[str], folder: Path, variables: Mapping[str, str]) -> None:
    """Runs a command and shows its output only if it fails."""
    done = subprocess.run(
        command, cwd=folder, env=variables, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.STDOUT
    )
    if done.returncode:
        sys.exit(f"{done.stdout.decode(errors='replace')}\n{' '.join(command)} exited with {done.returncode}")


def copy_sources(folder: Path) -> Path:
    """Copies the files that git knows, as they are in the work tree; returns the copy."""
    copy = folder / f"robot-health-{manifest.text('version')}"
    copy.mkdir(parents=True)
    names = filter(None, manifest.git(ROOT, "ls-files", "-z").split("\0"))
    subprocess.run(["cp", "--parents", "--no-dereference", "--preserve", "-t", copy, *names], cwd=ROOT, check=True)
    return copy


def main() -> None:
    """Builds packages and names them."""
    parser = argparse.ArgumentParser(description="Builds the Debian packages.")
    parser.add_argument("folder", type=Path, help="where the packages go")
    parser.add_argument("names", nargs="*", metavar="NAME", help=f"of {', '.join(PACKAGES)} (default: all)")
    arguments = parser.parse_args()
    unknown = set(arguments.names) - set(PACKAGES)
    if unknown:
        parser.error(f"expected names of {', '.join(PACKAGES)}, got {', '.join(sorted(unknown))}")
    date_s = float(os.environ.get("SOURCE_DATE_EPOCH") or manifest.git(ROOT, "log", "-1", "--format=%ct"))
    arguments.folder.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(prefix="robot-health-debs-") as temporary:
        work = Path(temporary)
        variables: dict[str, str] = {}
        for name in arguments.names or PACKAGES:
            folder = work / name
            source = copy_sources(folder)
            if name == COMMAND_LINE:
                write_debian_folder(source, date_s)
                write_completions(source / "debian")
            else:
                if not variables:
                    variables = index_variables(work)
                    run(["rosdep", "update", "--include-eol-distros"], work, variables)
                generate(source, name, variables)
            build(source)
            for package in sorted(folder.glob("*.deb")):
                for old in arguments.folder.glob(f"{package.name.partition('_')[0]}_*.deb"):
                    old.unlink()
                target = shutil.move(str(package), str(arguments.folder / package.name))
                print(target)


if __name__ == "__main__":
    main()
