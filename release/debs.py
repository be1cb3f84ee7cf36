"""Builds the Debian packages; `make deb` calls it.

    python3 release/debs.py FOLDER [NAME...]      builds the packages (default: all) into FOLDER

`robot-health` is the command line without ROS, from release/debian. `jazzy`, `one` (ROS One) and `debian` (Debian's own
ROS 1) are the nodes, made with bloom as the ROS build farm does it, but with the index in release/index. What is built
is the last commit.
"""

from __future__ import annotations

import os
import shutil
import sys
import tempfile
from email.utils import formatdate
from pathlib import Path
from typing import Mapping

ROOT = Path(__file__).resolve().parents[1]
sys.path[:0] = [str(ROOT)]

from release import manifest  # noqa: E402  # found through the line above
from robot_health_monitor.cli.arguments import complete_parser  # noqa: E402

COMMAND_LINE = "robot-health"

DISTROS = {
    "jazzy": ("ubuntu", "noble", "rosdebian"),
    "one": ("ubuntu", "noble", "rosdebian"),
    "debian": ("debian", "bookworm", "debian"),
}
"""System, its release, and bloom's generator: rosdebian installs to /opt/ros, debian to /usr."""
PACKAGES = (COMMAND_LINE, *DISTROS)


def write_debian_folder(source: Path, date_s: float) -> None:
    """Writes debian/ of robot-health into a copy of the source tree, with the version and the date in its changelog."""
    shutil.copytree(ROOT / "release" / "debian", source / "debian")
    replace(source / "debian" / "changelog", "@VERSION@", manifest.text("version"))
    replace(source / "debian" / "changelog", "@DATE@", formatdate(date_s))


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
    manifest.run(source, "bloom-generate", generator, *options, env=variables)
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
    manifest.run(source, "dpkg-buildpackage", "-d", "-us", "-uc", "-b", env={**system, **without_tests})


def main() -> None:
    """Builds packages and names them."""
    if not set(sys.argv[2:]) <= set(PACKAGES):
        sys.exit(f"debs.py: expected names of {', '.join(PACKAGES)}, got {', '.join(sys.argv[2:])}")
    target, names = Path(sys.argv[1]), sys.argv[2:] or PACKAGES
    date_s = float(os.environ.get("SOURCE_DATE_EPOCH") or manifest.git(ROOT, "log", "-1", "--format=%ct"))
    target.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(prefix="robot-health-debs-") as temporary:
        work = Path(temporary)
        variables = index_variables(work)
        if [*names] != [COMMAND_LINE]:
            manifest.run(work, "rosdep", "update", "--include-eol-distros", env=variables)
        for name in names:
            source = manifest.unpack_sources(ROOT, work / name, f"robot-health-{manifest.text('version')}")
            if name == COMMAND_LINE:
                write_debian_folder(source, date_s)
                write_completions(source / "debian")
            else:
                generate(source, name, variables)
            build(source)
            for package in sorted(source.parent.glob("*.deb")):
                for old in target.glob(f"{package.name.partition('_')[0]}_*.deb"):
                    old.unlink()
                print(shutil.move(str(package), str(target / package.name)))


if __name__ == "__main__":
    main()
