"""Robots for the tests, each with a folder, a DDS domain and a process of its own, and random messages of any type."""

from __future__ import annotations

import os
import re
import socket
import subprocess
import sys
import textwrap
import time
import zlib
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from downbeat import _core, msgs

os.environ.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")

#: Seconds after which a robot that should have done something has failed; generous, for machines that are busy.
PATIENCE = 60.0

#: The ROS domains whose default ports Linux gives to nobody who asks for any port.
_DOMAINS = [*range(1, 102), *range(215, 233)]


class Domain:
    """A domain that no other test of this machine uses, taken by the same TCP port as in ``tests/machine``."""

    def __init__(self) -> None:
        end = time.monotonic() + 5 * PATIENCE
        begin = os.getpid() * 37 % len(_DOMAINS)
        while time.monotonic() < end:
            for number in _DOMAINS[begin:] + _DOMAINS[:begin]:
                if self._take(number):
                    return
            time.sleep(0.1)
        raise TimeoutError("no ROS domain became free")

    def _take(self, number: int) -> bool:
        self._lock, self.number = socket.socket(), number
        port = 7400 + 250 * number
        try:
            self._lock.bind(("127.0.0.1", port))
            self._lock.listen()
            for offset in (0, 1, *range(10, 20)):
                with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as participant:
                    participant.bind(("", port + offset))
        except OSError:
            self._lock.close()
            return False
        return True

    def release(self) -> None:
        self._lock.close()


#: The domain of robots to which a test gives no other.
_own_domain = Domain()
os.environ["ROS_DOMAIN_ID"] = str(_own_domain.number)


@pytest.fixture
def domain(monkeypatch: pytest.MonkeyPatch) -> Iterator[int]:
    """A free domain, also for nodes of this process."""
    taken = Domain()
    monkeypatch.setenv("ROS_DOMAIN_ID", str(taken.number))
    yield taken.number
    taken.release()


#: What the pages tell a reader to type: seconds, page and command.
_steps: list[tuple[float, str, str]] = []

#: Where the steps of all pages of the repository are collected.
_STEPS = Path(__file__).parents[2] / "target" / "first_hour" / "steps"


@pytest.fixture
def new_user(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, request: pytest.FixtureRequest) -> Path:
    """A reader of the page that the test module names: an empty home, and nothing of ROS in the environment."""
    home = tmp_path / "home"
    home.mkdir()
    for name in os.environ:
        if name.startswith(("AMENT_", "COLCON_", "DOWNBEAT_", "LD_LIBRARY_PATH", "PYTHONPATH", "RMW_", "ROS_", "XDG_")):
            monkeypatch.delenv(name)
    monkeypatch.setenv("HOME", str(home))
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(home))
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    monkeypatch.setenv("ROS_DOMAIN_ID", str(_own_domain.number))
    monkeypatch.setattr(Program, "page", request.module.PAGE_NAME)
    return home


#: Why a test is skipped although every tool is installed; such a skip does not fail a strict run.
CANNOT_BE_HAD = "the packages of rclpy on PyPI lack this interface"

#: The tests that are skipped, by reason.
_skipped: dict[str, list[str]] = {}


def pytest_runtest_logreport(report: pytest.TestReport) -> None:
    _note_skip(report)


def pytest_collectreport(report: pytest.CollectReport) -> None:
    _note_skip(report)


def _note_skip(report: pytest.TestReport | pytest.CollectReport) -> None:
    if report.skipped and isinstance(report.longrepr, tuple):
        reason = report.longrepr[2].removeprefix("Skipped: ")
        _skipped.setdefault(reason, []).append(report.nodeid)


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter) -> None:
    """Prints each reason for skipped tests, and appends them to the list of ``cargo xtask test``."""
    lines = []
    for reason, tests in sorted(_skipped.items()):
        file = tests[0].partition("::")[0]
        which = f"{len(tests)} tests of {file}" if reason == CANNOT_BE_HAD else ", ".join(tests)
        terminalreporter.write_line(f"skipped: {reason}: {which}")
        lines += [f"{reason}\tpytest {test}\n" for test in ([which] if reason == CANNOT_BE_HAD else tests)]
    if named := os.environ.get("DOWNBEAT_SKIPS"):
        with Path(named).open("a") as file_of_skips:
            file_of_skips.writelines(lines)


def pytest_sessionfinish(session: pytest.Session) -> None:
    lacking = _skipped.keys() - {CANNOT_BE_HAD}
    if lacking and os.environ.get("DOWNBEAT_STRICT", "") not in ("", "0"):
        print(f"\nfails because DOWNBEAT_STRICT is set: {'; '.join(sorted(lacking))}", file=sys.stderr)
        session.exitstatus = pytest.ExitCode.TESTS_FAILED
    if _steps and _STEPS.parent.exists():
        _STEPS.mkdir(exist_ok=True)
        lines = [f"{seconds:>7.1f} s  {page}: {command}\n" for seconds, page, command in _steps]
        (_STEPS / "python.txt").write_text("".join(lines))


class Program:
    """The command ``downbeat`` in a process of its own, and what it prints."""

    #: The page whose commands are typed, if any.
    page = ""

    def __init__(self, folder: Path, *arguments: str) -> None:
        self.typed, self.began = " ".join(("downbeat", *arguments)), time.monotonic()
        self.log = folder / "log.txt"
        self.taken = Domain()
        self.domain = str(self.taken.number)
        environment = {**os.environ, "ROS_DOMAIN_ID": self.domain, "PYTHONDONTWRITEBYTECODE": "1"}
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
        code = self.process.wait(PATIENCE)
        if self.page:
            _steps.append((time.monotonic() - self.began, self.page, self.typed))
        return code

    def stop(self) -> int:
        if self.process.poll() is None:
            self.process.terminate()
        return self.wait()


def run_script(page: str, script: Path) -> subprocess.CompletedProcess[str]:
    """Runs a program of a page, as its reader does."""
    began = time.monotonic()
    ran = subprocess.run([sys.executable, script], cwd=script.parent, capture_output=True, text=True, timeout=PATIENCE * 2)
    _steps.append((time.monotonic() - began, page, f"python {script.name}"))
    return ran


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
        each.taken.release()


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


_FIELD = re.compile(r"(?P<element>[\w/]+)(<=(?P<length>\d+))?(\[(?P<most><=)?(?P<count>\d*)\])?")
_TEXT = "aB9_-/ äß€漢"


class Values:
    """Random values of fields, the same for each run and type."""

    def __init__(self, seed: str) -> None:
        self.random = np.random.default_rng(zlib.crc32(seed.encode()))

    def message(self, name: str) -> Any:
        fields = {
            field: self.field(element, declared) for field, element, _, declared, _ in _core.describe_fields(name)
        }
        return msgs.message_class(name)(**fields)

    def field(self, element: str, declared: str) -> Any:
        matched = _FIELD.fullmatch(declared)
        assert matched, declared
        length = int(matched["length"] or 12)
        if matched["count"] is None:
            return self.one(element, length)
        most = int(matched["count"] or 3)
        count = int(self.random.integers(most + 1)) if matched["most"] or not matched["count"] else most
        return [self.one(element, length) for _ in range(count)]

    def one(self, element: str, length: int) -> Any:
        if "/" in element:
            return self.message(element)
        if element == "string":
            count = int(self.random.integers(length // 3 + 1))
            return "".join(self.random.choice(list(_TEXT), count))
        if element == "bool":
            return bool(self.random.integers(2))
        if element.startswith("float"):
            return float(np.float32(self.random.normal() * 1e3))
        info = np.iinfo({"byte": "uint8", "char": "uint8"}.get(element, element))
        return int(self.random.integers(info.min, info.max, dtype=info.dtype, endpoint=True))


@pytest.fixture
def random_message() -> Callable[..., Any]:
    """A random message of the type of this name."""
    return lambda name, seed="": Values(name + seed).message(name)


def message_names() -> list[str]:
    """Every message of every interface that downbeat carries."""
    names = []
    for package in _core.interface_packages():
        for kind, name in _core.interfaces(package):
            parts = {"msg": [""], "srv": ["_Request", "_Response"], "action": ["_Goal", "_Result", "_Feedback"]}[kind]
            names += [f"{package}/{kind}/{name}{part}" for part in parts]
    return names
