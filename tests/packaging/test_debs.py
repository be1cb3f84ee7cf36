"""The metadata of the Debian packages agrees with package.xml, setup.py and the systemd units; `make deb` builds."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path
from xml.etree import ElementTree

import pytest
import yaml
from harness.packaging_workspace import ROOT, version
from harness.requirements import runtime_requirements

from release import debs
from robot_health_monitor.cli.arguments import COMMANDS
from robot_health_monitor.runtime.libraries import debian_package

FOCAL = {
    "python3-aiohttp": (3, 6, 2),
    "python3-psutil": (5, 5, 1),
    "python3-yaml": (5, 3, 1),
}
"""What Ubuntu 20.04 has, the oldest system of the package: the others have newer ones."""
UNITS = [file.read_text("utf-8") for file in sorted((ROOT / "resource").glob("robot-health*.service"))]


@pytest.fixture(scope="module")
def debian(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Returns debian/ of robot-health, as it is built on the first day of 2027."""
    folder = tmp_path_factory.mktemp("source")
    debs.write_debian_folder(folder, 1_798_761_600.0)
    return folder / "debian"


def paragraphs(control: str) -> list[dict[str, str]]:
    """Returns the fields of each paragraph, continued lines joined."""
    return [
        dict(line.split(": ", 1) for line in re.sub(r"\n ", " ", text).splitlines() if line)
        for text in control.split("\n\n")
    ]


def test_the_package_needs_what_the_nodes_need_and_recommends_the_rest(debian: Path) -> None:
    """Names and oldest versions are those of setup.py; package.xml has which of them are needed."""
    source, package = paragraphs((debian / "control").read_text("utf-8"))
    assert (source["Source"], package["Package"], package["Architecture"]) == ("robot-health", "robot-health", "all")
    needed = [each.text for each in ElementTree.parse(ROOT / "package.xml").findall("exec_depend")]
    packages: dict[bool, list[str]] = {True: [], False: []}
    for requirement in runtime_requirements():
        name, _, oldest = requirement.partition(">=")
        packages[debian_package(name) in needed].append(debian_package(name) + (f" (>= {oldest})" if oldest else ""))
    variables = ["adduser", "${python3:Depends}", "${misc:Depends}"]
    assert package["Depends"].split(", ") == [*variables, *packages[True]]
    assert package["Recommends"].split(", ") == packages[False]
    assert len(packages[True]) == 3 and len(packages[False]) == 2


def test_what_it_needs_is_in_the_oldest_ubuntu(debian: Path) -> None:
    _, package = paragraphs((debian / "control").read_text("utf-8"))
    oldest = {}
    for each in package["Depends"].split(", ")[3:]:
        name, _, number = each.rstrip(")").partition(" (>= ")
        oldest[name] = tuple(map(int, number.split(".")))
    assert set(oldest) == set(FOCAL)
    assert [name for name in oldest if oldest[name] > FOCAL[name]] == []


def test_names_and_addresses_are_those_of_package_xml(debian: Path) -> None:
    manifest = ElementTree.parse(ROOT / "package.xml")
    maintainer = manifest.find("maintainer")
    assert maintainer is not None
    source, _ = paragraphs((debian / "control").read_text("utf-8"))
    address = f"{maintainer.text} <{maintainer.get('email')}>"
    assert (source["Maintainer"], source["Homepage"]) == (address, manifest.findtext("url[@type='website']"))
    assert f"\n -- {address}  " in (debian / "changelog").read_text("utf-8")
    repository = manifest.findtext("url[@type='repository']")
    lines = (debian / "copyright").read_text("utf-8").splitlines()
    assert f"Source: {repository}" in lines
    assert f"Copyright: {manifest.findtext('author')}" in lines


def test_no_field_is_left_open(debian: Path) -> None:
    texts = {file.name: file.read_text("utf-8") for file in debian.iterdir() if file.is_file()}
    assert [name for name, text in texts.items() if name != "rules" and re.search(r"@[A-Z]+@", text)] == []
    assert texts["changelog"].splitlines()[0] == f"robot-health ({version()}) unstable; urgency=medium"
    assert texts["changelog"].endswith(">  Fri, 01 Jan 2027 00:00:00 -0000\n")


def test_the_units_use_the_user_and_the_folders_that_the_package_makes(debian: Path) -> None:
    postinst, rules = ((debian / name).read_text("utf-8") for name in ("robot-health.postinst", "rules"))
    service, instances = UNITS
    for unit in UNITS:
        assert "\nUser=robot-health\nGroup=robot-health\n" in unit
        assert re.search(r"^ExecStart=/opt/robot-health/bin/robot-health ", unit, re.MULTILINE)
    assert "\nStateDirectory=robot-health\nStateDirectoryMode=0770\n" in service
    assert "install -d -o robot-health -g robot-health -m 770 /var/lib/robot-health\n" in postinst
    assert "\nStateDirectory=robot-health-%i\n" in instances
    started = next(line for line in service.splitlines() if line.startswith("ExecStart="))
    files = re.findall(r"/etc/robot-health/[\w.]+", started)
    assert len(files) == 2
    assert [file for file in files if f"$(package){file}\n" not in rules] == []


@pytest.fixture(scope="module")
def completions(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Returns the folder with what completes in bash and zsh."""
    pytest.importorskip("shtab")
    folder = tmp_path_factory.mktemp("completions")
    debs.write_completions(folder)
    return folder


COMPLETE = """
source "$1"; shift
COMP_WORDS=("$@"); COMP_CWORD=$(($# - 1))
$(complete -p robot-health | sed 's/.*-F \\(.*\\) .*/\\1/')
printf '%s\\n' "${COMPREPLY[@]}"
"""
"""What bash does when Tab is pressed behind words."""


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        (["su"], {"suggest"}),
        (["silence", "ad"], {"add"}),
        (["replay", "--thr"], {"--thresholds"}),
        (["init", "--ros"], {"--ros1", "--ros2"}),
        (["check", "/etc/hostn"], {"/etc/hostname"}),
    ],
)
def test_bash_completes_commands_options_and_files(completions: Path, words: list[str], expected: set[str]) -> None:
    command = ["bash", "-c", COMPLETE, "bash", str(completions / "robot-health.bash"), "robot-health", *words]
    found = subprocess.run(command, check=True, stdout=subprocess.PIPE, text=True).stdout.split()
    assert set(found) == expected


def test_zsh_has_every_command_and_option(completions: Path) -> None:
    text = (completions / "_robot-health").read_text("utf-8")
    assert text.startswith("#compdef robot-health\n")
    quotes = "['\"]?"  # as the version of shtab has them
    assert [name for name, line in COMMANDS.items() if not re.search(rf"\b{name}:{quotes}{line}", text)] == []
    assert "--thresholds[" in text and ":_files" in text


def test_purge_deletes_the_states_of_its_own_units_only(debian: Path, tmp_path: Path) -> None:
    """Run on a folder in place of /, with no user to delete."""
    others = [f"robot-health-{name}" for name in ("agent", "alertmanager", "north-backup", "prometheus", "vmagent")]
    for folder in ("robot-health", "robot-health-north", *others):
        (tmp_path / "var/lib" / folder).mkdir(parents=True)
    (tmp_path / "etc/robot-health/north").mkdir(parents=True)
    (tmp_path / "etc/robot-health/north/fleet.yaml").touch()
    script = (debian / "robot-health.postrm").read_text("utf-8").replace("/var/lib/", f"{tmp_path}/var/lib/")
    no_user = "getent() { return 1; }\n"
    purge = ["sh", "-c", no_user + script.replace("/etc/", f"{tmp_path}/etc/"), "postrm", "purge"]
    assert subprocess.run(purge, check=True, stdout=subprocess.PIPE).stdout == b""
    assert sorted(file.name for file in (tmp_path / "var/lib").iterdir()) == others
    assert list((tmp_path / "etc").iterdir()) == []


def test_the_configuration_of_the_package_is_valid(debian: Path, tmp_path: Path) -> None:
    """The history is in a folder of the package, here in another one."""
    file = tmp_path / "ops.yaml"
    text = (debian / "ops.yaml").read_text("utf-8")
    assert "file: /var/lib/robot-health/history.db\n" in text
    file.write_text(text.replace("/var/lib/robot-health/", f"{tmp_path}/"))
    check = [sys.executable, "-m", "robot_health_monitor", "check", str(file), str(ROOT / "config" / "host.yaml")]
    done = subprocess.run(check, cwd=ROOT, stdout=subprocess.PIPE, text=True, timeout=60.0, check=False)
    assert done.returncode == 0, done.stdout


def test_bloom_finds_every_key_of_package_xml(tmp_path: Path) -> None:
    variables = debs.index_variables(tmp_path)
    index = Path(variables["ROSDISTRO_INDEX_URL"].partition("://")[2])
    (source,) = Path(variables["ROSDEP_SOURCE_PATH"]).glob("*.list")
    rosdep = yaml.safe_load(Path(source.read_text().split("://")[1].strip()).read_text())
    packages: dict[str, set[str]] = {}
    for name, entry in yaml.safe_load(index.read_text())["distributions"].items():
        packages[name] = set(yaml.safe_load((index.parent / entry["distribution"][0]).read_text())["repositories"])
    assert list(packages) == list(debs.DISTROS)
    depends = [element for element in ElementTree.parse(ROOT / "package.xml").getroot() if "depend" in element.tag]
    assert {"rospy", "rclpy", "python3-yaml"} <= {element.text for element in depends}
    assert set(rosdep) == {*(element.text for element in depends), "robot-health"}
    for element in depends:
        name = element.text or ""
        if name.startswith("python3"):
            assert rosdep[name] == {"ubuntu": [name], "debian": [name]}
        else:
            assert name in packages["jazzy"] and name in packages["one"]
            assert list(rosdep[name]) == ["debian"]
    assert rosdep["diagnostic_msgs"] == {"debian": ["python3-diagnostic-msgs"]}
    assert rosdep["catkin"] == {"debian": ["catkin"]}
    assert rosdep["robot-health"] == {"debian": ["robot-health"]}
    assert packages["debian"] == set()


def test_an_unknown_package_is_one_clear_line() -> None:
    build = [sys.executable, str(ROOT / "release" / "debs.py"), "/nonexistent", "noetic"]
    done = subprocess.run(build, stderr=subprocess.PIPE, text=True, timeout=60.0, check=False)
    assert done.returncode == 1
    assert done.stderr == "debs.py: expected names of robot-health, jazzy, one, debian, got noetic\n"
