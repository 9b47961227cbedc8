# SPDX-License-Identifier: Apache-2.0
"""A service on this machine, started from an environment of Python that has the product."""

from __future__ import annotations

import atexit
import os
import re
import subprocess
import sys
import tempfile
from pathlib import Path

from .service_calls import Refusal

CURE = "Name the environment in which drape and its service are installed, in the preferences of the add-on."


def python_of(environment: str) -> Path:
    """Returns the path of the interpreter that ``environment`` names: itself, or a virtual environment's folder, or a
    folder that has one as ``.venv``.

    Refuses (``Refusal``) one without an interpreter.
    """
    given = Path(environment.strip() or os.devnull).expanduser()
    inside = "Scripts/python.exe" if sys.platform == "win32" else "bin/python"
    for path in (given, given / inside, given / ".venv" / inside):
        if path.is_file():
            return path
    raise Refusal("environment", expected="one of Python", got=environment.strip() or "none", cure=CURE)


class LocalService:
    """A service on this machine, started from ``environment`` (``python_of``). It runs until ``end``, or Blender's end.
    ``url`` is its address, empty until ``ready``."""

    def __init__(self, environment: str) -> None:
        self.url, self._log = "", Path(tempfile.gettempdir()) / f"drape-service-{os.getpid()}.log"
        hidden = ("PYTHONHOME", "PYTHONPATH")  # they are set for Blender's Python
        variables = {name: value for name, value in os.environ.items() if name not in hidden}
        command = [str(python_of(environment)), "-P", "-m", "service", "--port", "0"]
        try:
            with self._log.open("wb") as log:
                self._process = subprocess.Popen(
                    command, env=variables, stdin=subprocess.DEVNULL, stdout=log, stderr=subprocess.STDOUT
                )
        except OSError as error:
            expected, got = "a Python that starts", f"{command[0]}: {error.strerror}"
            raise Refusal("environment", expected=expected, got=got, cure=CURE) from error
        atexit.register(self.end)

    def ready(self) -> bool:
        """Returns whether it listens; refuses (``Refusal``) where it has ended."""
        ended, output = self._process.poll() is not None, self._log.read_text(encoding="utf-8", errors="replace")
        if ended:
            got = f'"{(output.split(chr(10))[-2:] or [""])[0][:200]}"'
            raise Refusal("service", expected="one that runs", got=got, cure=f"{CURE} Its log is {self._log}.")
        if address := re.search(r"drape on (http://\S+)", output):
            self.url = address[1]
        return bool(self.url)

    def end(self) -> None:
        """Ends the service, and waits for its end."""
        atexit.unregister(self.end)
        self._process.terminate()
        self._process.wait()  # a service ends within 15 s, whatever hangs
