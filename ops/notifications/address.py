"""The address of a target: given in ops.yaml, or read from a file because it contains a secret."""

from __future__ import annotations

import os
import re
import stat
from typing import Tuple
from urllib.parse import urlsplit

from ..configuration import TargetSettings
from .sender import DeliveryError

_LONGEST = 4096  # bytes


class Address:
    """An address that may be secret. A file is read before each use, so that a secret can be replaced at any time."""

    def __init__(self, settings: TargetSettings) -> None:
        """Reads nothing yet."""
        self._url = settings.url
        self._file = settings.url_file
        self.place = settings.url_file or shown(settings.url)
        """The address as it may be shown: scheme and host; before the file has been read, the name of the file."""
        self.is_secret = bool(settings.url_file)
        """Whether the path of the address must not be shown."""
        self.warning = ""
        """One line if other users may read the file; empty: they may not, as far as is known."""

    def lines(self) -> Tuple[str, ...]:
        """Returns the lines of the file that are neither empty nor comments (`#`), or the given address.

        Raises:
            DeliveryError: the file cannot be read or is empty.
        """
        if not self._file:
            return (self._url,)
        try:
            mode = os.stat(self._file).st_mode
            if not stat.S_ISREG(mode):  # opening a named pipe would wait for a writer
                raise ValueError("expected a file, got something else")
            with open(self._file, "rb") as stream:
                contents = stream.read(_LONGEST + 1)
        except (OSError, ValueError) as error:
            problem = error.strerror if isinstance(error, OSError) else str(error)
            raise DeliveryError(f"{self._file}: cannot be read: {problem}", may_have_arrived=False) from None
        is_open = mode & stat.S_IROTH
        advice = "every user of this machine can read this address; protect it with chmod 600"
        self.warning = f"{self._file}: {advice}" if is_open else ""
        if len(contents) > _LONGEST:
            problem = f"expected at most {_LONGEST} bytes, got more"
            raise DeliveryError(f"{self._file}: {problem}", may_have_arrived=False)
        lines = [line.strip() for line in contents.decode("utf-8", "replace").splitlines()]
        found = tuple(line for line in lines if line and not line.startswith("#"))
        if not found:
            raise DeliveryError(f"{self._file}: expected an address, got an empty file", may_have_arrived=False)
        self.place = ", ".join(dict.fromkeys(shown(line) for line in found))
        return found

    def http(self) -> str:
        """Returns an address of HTTP.

        Raises:
            DeliveryError: the file cannot be read, or holds something else.
        """
        url, *others = self.lines()
        try:
            parts = urlsplit(url)
            fits = parts.scheme in ("http", "https") and bool(parts.hostname) and parts.port != 0
        except ValueError:
            fits = False
        if others or not fits or not all("!" <= letter <= "~" for letter in url):
            self.place = self._file or self.place
            problem = "expected one address, http://... or https://..., without blanks"
            raise DeliveryError(f"{self._file or 'url'}: {problem}", may_have_arrived=False)
        return url


def shown(url: str) -> str:
    """Returns scheme, host and port of an address: the rest may be a secret.

    >>> shown("https://user:password@chat.example:8443/hooks/secret?key=secret")
    'https://chat.example:8443'
    """
    scheme, separator, rest = url.partition("://")
    if not separator:
        return "an address without a scheme"
    if scheme.lower() not in ("http", "https"):
        return f"{scheme[:20]}://..."  # apprise puts secrets in place of the host
    host = re.split(r"[/?#\\]", rest, maxsplit=1)[0]
    if "@" in rest[len(host) :]:  # a password that contains one of these characters
        return f"{scheme}://..."
    return f"{scheme}://{host.rpartition('@')[2][:200]}"
