"""Tests of modules without a robot: time stands still until the test advances it."""

from collections.abc import Mapping
from typing import Any

from downbeat import _core
from downbeat.module import Module, Refused, Time, duration


class Robot:
    """Modules under test, and a test in place of the rest of the robot::

        def test_the_head_turns_against_the_body():
            robot = db.test.Robot(level_head=LevelHead)
            robot.inject("imu/data_raw", angular_velocity={"y": 0.5})
            robot.advance("20ms")
            assert robot.expect("joint_commands").position[0] == pytest.approx(0.004)

    There is no network and no robot file, and nothing waits: every call runs the modules until none has anything to do at the time
    of the robot's clock. An exception in a module is one of the call that ran it, with the traceback of the module.
    """

    def __init__(self, **modules: type[Module] | str) -> None:
        """``modules`` are classes of modules, or kinds of modules such as ``"diff_drive"``, by the names of the modules."""
        self._probe = _core.Probe()
        for name, kind in modules.items():
            self.add(name, kind)

    def add(
        self, name: str, kind: type[Module] | str, /, *, remap: Mapping[str, str] | None = None, **settings: Any
    ) -> None:
        """Adds a module with values of its settings; for a kind in another language, of its keys too, as in
        ``robot.add("doubler", "library", path="libdoubler.so", factor=3.0)``."""
        self._probe.add(name, kind, settings, dict(remap or {}))

    def inject(self, topic: str, message: Any = None, /, **fields: Any) -> None:
        """Publishes a message, or one of the type of the topic with these fields."""
        self._probe.inject(topic, message, fields)

    def advance(self, time: float | str) -> None:
        """Lets time pass, in seconds or as in ``"20ms"``: timers and tasks run at their times, those at the end too."""
        self._probe.advance(duration(time))

    def expect(self, topic: str, within: float | str = 0) -> Any:
        """Takes the next message of a topic: one that was published since the robot began and not yet taken, or the first in the
        time ``within``. Raises ``AssertionError`` if there is none."""
        message = self._probe.next(topic, duration(within))
        if message is None:
            waiting = ", ".join(f"{name} ({count})" for name, count in self._probe.waiting().items())
            raise AssertionError(f"no message on {topic!r} within {within}; messages wait on [{waiting}]")
        return message

    def expect_none(self, topic: str, within: float | str = 0) -> None:
        """Raises ``AssertionError`` if a topic has a message that was not taken, or has one in the time ``within``."""
        message = self._probe.next(topic, duration(within))
        if message is not None:
            raise AssertionError(f"a message on {topic!r}: {message}")

    def heard(self, topic: str) -> list[Any]:
        """Takes all messages of a topic that were not taken yet."""
        return self._probe.heard(topic)

    def call(self, service: str, request: Any = None, /, **fields: Any) -> Any:
        """Calls a service with a request, or with one of these fields, and returns the response. Time advances until there is
        one, at most 5 s. Raises :class:`downbeat.Refused` if there is none."""
        response, problem = self._probe.call(service, request, fields)
        if response is None:
            raise Refused(problem)
        return response

    def set(self, module: str, setting: str, value: Any) -> None:
        """Changes a setting of a module. Raises ``ValueError`` if it is refused."""
        self._probe.set(module, setting, value)

    @property
    def now(self) -> Time:
        """The time that the modules see."""
        return Time(self._probe.now)
