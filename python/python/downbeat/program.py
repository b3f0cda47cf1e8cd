"""Running robots: the command line, and the same from a script or a test."""

import os
import signal
import sys
import threading
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager

from downbeat import _core
from downbeat.module import Module

Kinds = Mapping[str, type[Module]]


def main(kinds: Kinds | None = None, arguments: Sequence[str] | None = None) -> int:
    """Runs the command line of ``downbeat``, with ``kinds`` as kinds of modules that robot files can name.

    Returns the exit code. ``arguments`` are those of the process unless given.
    """
    line = ["downbeat", *(sys.argv[1:] if arguments is None else arguments)]
    with _signals_to_the_program():
        return _core.main(dict(kinds or {}), line)


def run(
    robot: str | os.PathLike[str],
    kinds: Kinds | None = None,
    *,
    record: str | os.PathLike[str] | None = None,
    duration: float | None = None,
    domain: int | None = None,
    fast: bool = False,
) -> None:
    """Runs the robot of a robot file until it is interrupted, as ``downbeat run`` does.

    ``kinds`` are classes of modules by the names that the robot file gives as ``kind``. ``record`` is the directory of a new bag,
    ``duration`` a time in seconds, ``domain`` the DDS domain. With ``fast`` the robot runs in simulated time.

    Raises ``SystemExit`` if the robot cannot run; the reason is on standard error.
    """
    arguments = ["run", os.fspath(robot)]
    if record is not None:
        arguments += ["--record", os.fspath(record)]
    if duration is not None:
        arguments += ["--duration", f"{duration}s"]
    if domain is not None:
        arguments += ["--domain", str(domain)]
    if fast:
        arguments.append("--fast")
    if code := main(kinds, arguments):
        raise SystemExit(code)


def start(robot: str | os.PathLike[str], kinds: Kinds | None = None) -> _core.Robot:
    """Starts the robot of a robot file beside the script, with its node in ROS 2: for tests and notebooks.

    The result is a context manager that stops the robot at its end.
    """
    return _core.start(dict(kinds or {}), os.fspath(robot))


def replay(
    robot: str | os.PathLike[str], bag: str | os.PathLike[str], kinds: Kinds | None = None
) -> _core.ReplayReport:
    """Runs the modules of a robot with the messages of a bag and compares what they publish with it, bit for bit.

    In a test: ``downbeat.replay("robot.toml", "tests/field_run").assert_same()``.
    """
    return _core.replay(dict(kinds or {}), os.fspath(robot), os.fspath(bag))


@contextmanager
def _signals_to_the_program() -> Iterator[None]:
    """The program stops the robot on SIGINT and SIGTERM; Python would only note them until a callback of it runs."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = signal.signal(signal.SIGINT, signal.SIG_DFL)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)
