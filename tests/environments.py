"""The virtual environments under .venv/: made when they are missing, kept while their requirements stay the same.

Run as a command, it makes the one in which `make run` runs the monitor.
"""

from __future__ import annotations

import ast
import glob
import json
import os
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any, Dict, Iterable, List, Optional, Sequence, Tuple

ROOT = Path(__file__).resolve().parent.parent
FOLDER = ROOT / ".venv"

Version = Tuple[int, int]

_ASK = (
    "import json, sys; print(json.dumps([sys.version_info[:3], sys.version_info[3], sys.base_prefix, sys.executable]))"
)
_PLACES = (
    "/usr/bin",
    "/usr/local/bin",
    "~/.pyenv/versions/*/bin",
    "~/.local/share/uv/python/*/bin",
    "~/.local/bin",
    "/opt/python/*/bin",
)


class Unavailable(Exception):
    """Something that this machine does not have. `str()` says what, and what would help."""


def find_pythons() -> Dict[Version, str]:
    """Returns the released CPython interpreters of this machine, 3.8 or newer: one path per minor version."""
    folders = os.environ.get("PATH", "").split(os.pathsep)
    for place in _PLACES:
        folders += glob.glob(os.path.expanduser(place))
    files = {os.path.realpath(sys.executable): None}
    for folder in folders:
        for file in sorted(glob.glob(os.path.join(folder, "python3*"))):
            if os.path.basename(file)[6:].replace(".", "").isdigit():
                files.setdefault(os.path.realpath(file) if "shims" not in folder else file)
    found: Dict[Version, Tuple[Tuple[int, ...], str]] = {}
    for file in files:
        answer = ask(file, _ASK)
        if answer is None:
            continue
        version, release, _, executable = json.loads(answer)
        minor = (version[0], version[1])
        if release == "final" and minor >= (3, 8) and (minor not in found or tuple(version) > found[minor][0]):
            found[minor] = (tuple(version), executable)
    return {minor: found[minor][1] for minor in sorted(found)}


def ask(python: str, code: str, environment: Optional[Dict[str, str]] = None) -> Optional[str]:
    """Runs `code` and returns what it prints, None when it fails."""
    try:
        done = subprocess.run(
            [python, "-c", code], env=environment, stdin=subprocess.DEVNULL, capture_output=True, text=True, timeout=60
        )
    except (OSError, subprocess.TimeoutExpired):
        return None
    return done.stdout.strip() if done.returncode == 0 else None


def runtime_requirements() -> List[str]:
    """Returns what setup.py says the package needs."""
    requirements: List[str] = _setup_argument("install_requires")
    return requirements


def requirements_of_tests() -> List[str]:
    """Returns what setup.py says its tests need besides."""
    requirements: List[str] = _setup_argument("extras_require")["test"]
    return requirements


def _setup_argument(name: str) -> Any:
    for node in ast.walk(ast.parse((ROOT / "setup.py").read_text(encoding="utf-8"))):
        if isinstance(node, ast.keyword) and node.arg == name:
            return ast.literal_eval(node.value)
    raise AssertionError(f"setup.py has no {name}")


def environment(
    name: str,
    python: str,
    requirements: Sequence[str],
    *,
    system_packages: bool = False,
    run_with: Optional[Dict[str, str]] = None,
) -> Path:
    """Returns the Python of the environment `name`; makes it when it is missing or no longer what is asked for.

    Args:
        name: folder below .venv/.
        python: the interpreter it is made of.
        requirements: what pip installs into it.
        system_packages: whether modules of `python` itself are seen too.
        run_with: variables for pip, os.environ when left out.

    Raises:
        Unavailable: it cannot be made here.
    """
    folder = FOLDER / name
    made = folder / "bin" / "python"
    wanted = json.dumps([python, ask(python, "import sys; print(sys.version)"), sorted(requirements), system_packages])
    stamp = folder / "made_of.json"
    if stamp.exists() and stamp.read_text() == wanted and ask(str(made), "") is not None:
        return made
    print(f"setting up {folder.relative_to(ROOT)}", flush=True)
    shutil.rmtree(folder, ignore_errors=True)
    _make(folder, python, system_packages)
    install = [str(made), "-m", "pip", "install", "--quiet", "--disable-pip-version-check", *requirements]
    done = subprocess.run(
        install, env=run_with, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True
    )
    if done.returncode:
        raise Unavailable(f"pip cannot install {' '.join(requirements)}: {_last_line(done.stdout)}")
    stamp.write_text(wanted)
    return made


def _make(folder: Path, python: str, system_packages: bool) -> None:
    """Makes an environment that has pip, by the first tool that can."""
    option = ["--system-site-packages"] if system_packages else []
    tools = [[python, "-m", "venv", *option, str(folder)]]
    if shutil.which("virtualenv"):
        tools.append(["virtualenv", "--quiet", "--python", python, *option, str(folder)])
    if shutil.which("uv"):
        tools.append(["uv", "venv", "--quiet", "--seed", "--python", python, *option, str(folder)])
    reason = ""
    for tool in tools:
        done = subprocess.run(
            tool, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True
        )
        if done.returncode == 0 and ask(str(folder / "bin" / "python"), "import pip") is not None:
            return
        reason = reason or ("ensurepip is missing" if "ensurepip" in done.stdout else _last_line(done.stdout))
        shutil.rmtree(folder, ignore_errors=True)
    raise Unavailable(f"{python} cannot make a virtual environment ({reason}); python3-venv may help")


def install_with_apt(packages: Iterable[str]) -> None:
    """Installs those of Debian's or Ubuntu's packages that are missing.

    Raises:
        Unavailable: some are missing, and this user cannot install them or the machine does not know them.
    """
    missing = [package for package in packages if not _is_installed(package)]
    if not missing:
        return
    if not shutil.which("apt-get"):
        raise Unavailable(f"not a Debian or Ubuntu machine, so {', '.join(missing)} cannot be installed here")
    if os.geteuid() != 0:
        raise Unavailable(f"missing packages, which root can install: apt-get install {' '.join(missing)}")
    apt = ["apt-get", "-qq", "-o", "DPkg::Lock::Timeout=300"]
    quiet: Dict[str, Any] = {
        "stdin": subprocess.DEVNULL,
        "stdout": subprocess.PIPE,
        "stderr": subprocess.STDOUT,
        "text": True,
        "env": {**os.environ, "DEBIAN_FRONTEND": "noninteractive"},
    }
    subprocess.run([*apt, "update"], **quiet)
    done = subprocess.run([*apt, "install", "-y", "--no-install-recommends", *missing], **quiet)
    if done.returncode:
        raise Unavailable(f"apt-get install {' '.join(missing)} failed: {_last_line(done.stdout)}")


def _is_installed(package: str) -> bool:
    try:
        done = subprocess.run(["dpkg-query", "-W", "-f=${Status}", package], capture_output=True, text=True)
    except OSError:
        return False
    return done.stdout.endswith("ok installed")


def _last_line(output: str) -> str:
    lines = [line for line in output.splitlines() if line.strip()]
    return lines[-1].strip() if lines else "no output"


def prepare_run() -> None:
    """Makes the environment of `make run`.

    Where no environment with pip can be made, one without pip does, if this machine has the packages already.

    Raises:
        Unavailable: neither works.
    """
    requirements = runtime_requirements()
    name = "run"
    try:
        if os.geteuid() == 0 and ask(sys.executable, "import ensurepip, venv") is None:
            install_with_apt(["python3-venv"])
        environment(name, sys.executable, requirements)
    except Unavailable as problem:
        folder = FOLDER / name
        subprocess.run([sys.executable, "-m", "venv", "--without-pip", "--system-site-packages", str(folder)])
        if ask(str(folder / "bin" / "python"), "import yaml") is None:
            shutil.rmtree(folder, ignore_errors=True)
            raise Unavailable(f"{problem}, or at least python3-yaml") from None


if __name__ == "__main__":
    try:
        prepare_run()
    except Unavailable as problem:
        sys.exit(f"make run: {problem}")
    except KeyboardInterrupt:
        sys.exit(130)
