"""Robots for the tests: each test has a folder, a DDS domain and a process of its own."""

import itertools
import os
import re
import subprocess
import sys
import textwrap
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

os.environ.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")

#: Seconds after which a robot that should have done something has failed; generous, for machines that are busy.
PATIENCE = 60.0

_domains = itertools.count(60 + os.getpid() % 80)


class Program:
    """The command ``downbeat`` in a process of its own, and what it prints."""

    def __init__(self, folder: Path, *arguments: str) -> None:
        self.log = folder / "log.txt"
        environment = {**os.environ, "ROS_DOMAIN_ID": str(next(_domains) % 101), "PYTHONDONTWRITEBYTECODE": "1"}
        self.domain = environment["ROS_DOMAIN_ID"]
        with self.log.open("wb") as log:
            self.process = subprocess.Popen(
                [sys.executable, "-m", "downbeat", *arguments], cwd=folder, env=environment, stdout=log, stderr=log
            )

    def text(self) -> str:
        return self.log.read_text()

    def wait_for(self, pattern: str, times: int = 1) -> None:
        """Waits until the output has matches of a pattern."""
        end = time.monotonic() + PATIENCE
        while len(re.findall(pattern, self.text(), re.DOTALL)) < times:
            assert time.monotonic() < end, f"no {pattern!r} in\n{self.text()}"
            assert self.process.poll() is None, f"it ended without {pattern!r}:\n{self.text()}"
            time.sleep(0.05)

    def wait(self) -> int:
        return self.process.wait(PATIENCE)

    def stop(self) -> int:
        if self.process.poll() is None:
            self.process.terminate()
        return self.process.wait(PATIENCE)


@pytest.fixture
def program(tmp_path: Path) -> Iterator[Callable[..., Program]]:
    """Starts the program in the folder of the test."""
    started: list[Program] = []

    def start(*arguments: str) -> Program:
        started.append(Program(tmp_path, *arguments))
        return started[-1]

    yield start
    for each in started:
        if each.process.poll() is None:
            each.process.kill()
            each.process.wait()


@pytest.fixture
def write(tmp_path: Path) -> Callable[[str, str], Path]:
    """Writes a file into the folder of the test."""

    def write_file(name: str, text: str) -> Path:
        path = tmp_path / name
        # In one step: a robot that is reloading must not see half of it.
        part = tmp_path / f"{name}.part"
        part.write_text(textwrap.dedent(text))
        part.replace(path)
        return path

    return write_file
