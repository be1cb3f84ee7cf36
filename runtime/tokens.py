"""Reads the token that protects a rosbridge server: from a file, or from an environment variable.

Never from an argument or a parameter: every user of the machine can read those.
"""

from __future__ import annotations

import os
import stat
from typing import Callable

from ..core.values import ConfigError

TOKEN_VARIABLE = "ROBOT_HEALTH_TOKEN"
SHORTEST_TOKEN = 16
"""A server's token of fewer characters can be guessed."""
LARGEST_TOKEN = 1024
"""Longest token in bytes; it travels in an HTTP header."""


class TokenFiles:
    """Finds tokens, again at each reload. A pipe gives its token once: that one is kept."""

    def __init__(self, warn: Callable[[str], object]) -> None:
        """Reads nothing yet; `warn` is called with one line if other users may read a file."""
        self._warn = warn
        self._known: dict[str, str] = {}
        """The tokens of pipes; empty for a file."""

    def find(self, file: str) -> str:
        """Returns the token in a file or, if `file` is empty, in the environment; empty if there is none.

        Raises ConfigError as `read_token_file` does, and if a pipe is in place of the file: reading it could take for
        ever.
        """
        if not file:
            token = os.environ.get(TOKEN_VARIABLE, "").strip()
            if token and _problem(token):
                raise ConfigError(f"{TOKEN_VARIABLE}: {_problem(token)}")
            return token
        if self._known.get(file):
            return self._known[file]
        is_pipe = _is_pipe(file)
        if is_pipe and file in self._known:
            raise ConfigError("expected a file, as before, got a pipe", file=file)
        token = read_token_file(file, self._warn)
        self._known[file] = token if is_pipe else ""
        return token

    def find_own(self, file: str) -> str:
        """Does the same for a token that clients of this process must present: a short one is reported."""
        token = self.find(file)
        if 0 < len(token) < SHORTEST_TOKEN:
            text = f"the token has fewer than {SHORTEST_TOKEN} characters and can be guessed; make one: "
            self._warn(f"{text}openssl rand -hex 16")
        return token


def read_token_file(file: str, warn: Callable[[str], object]) -> str:
    """Returns the token in a file, without the white space around it; `~` is the home directory.

    `warn` is called with one line if other users may read it. Raises ConfigError, which never names the contents, if
    it cannot be read, is empty, or holds more than one token.
    """
    path = os.path.expanduser(file)
    try:
        with open(path, "rb") as stream:
            mode = os.fstat(stream.fileno()).st_mode
            # More than the largest token, for the line end; a device such as /dev/zero has no end.
            contents = stream.read(LARGEST_TOKEN + 3)
    except (OSError, ValueError) as error:
        problem = error.strerror if isinstance(error, OSError) else str(error)
        raise ConfigError(f"token cannot be read: {problem}", file=file) from None
    token = contents.strip().decode("utf-8", "replace")
    problem = _problem(token)
    if problem:
        raise ConfigError(problem, file=file)
    if stat.S_ISREG(mode) and mode & stat.S_IROTH:
        warn(f"{file}: every user of this machine can read this token; protect it with chmod 600")
    return token


def _is_pipe(file: str) -> bool:
    """Returns whether what a file contains can be read only once; False if there is no file."""
    try:
        return not stat.S_ISREG(os.stat(os.path.expanduser(file)).st_mode)
    except (OSError, ValueError):
        return False


def _problem(token: str) -> str:
    """Returns what is wrong with a token; empty if nothing is."""
    if not token:
        return "expected a token, got an empty file"
    if len(token) > LARGEST_TOKEN:
        return f"expected a token of at most {LARGEST_TOKEN} bytes, got more"
    if not all("!" <= character <= "~" for character in token):
        return "expected one token of printable ASCII characters without blanks"
    return ""
