"""Modules: what a user's class derives from, and how it declares what it publishes, receives and does."""

import random
import sys
from collections.abc import Callable, Mapping
from typing import Any, ClassVar, Generic, Self, TypeAlias, TypeVar, cast, overload

from downbeat import _core

T = TypeVar("T")
F = TypeVar("F", bound=Callable[..., Any])

_DECLARED = "__downbeat__"


class Refused(Exception):
    """Raised by a function that serves a service: the caller receives the text as the reason why there is no response."""


class Time(int):
    """A point in time: nanoseconds since the epoch, or since the start of a simulation."""

    @property
    def seconds(self) -> float:
        """The same in seconds; as a float, exact to about 0.2 µs today."""
        return self / 1e9

    def to_msg(self) -> Any:
        """Returns the ``builtin_interfaces/msg/Time`` for stamps."""
        from downbeat.msgs.builtin_interfaces.msg import Time as Stamp

        return Stamp(sec=self // 1_000_000_000, nanosec=self % 1_000_000_000)


def duration(value: float | str) -> float:
    """Returns seconds for a number of seconds, or a text such as ``"20ms"``, ``"1.5s"``, ``"250us"`` or ``"2min"``."""
    if isinstance(value, (int, float)):
        return float(value)
    units = {"ns": 1e-9, "us": 1e-6, "µs": 1e-6, "ms": 1e-3, "min": 60.0, "s": 1.0}
    text = value.strip()
    for unit, seconds in units.items():
        if text.endswith(unit):
            try:
                return float(text.removesuffix(unit)) * seconds
            except ValueError:
                break
    raise ValueError(f'{value!r} is no duration: write a number with ns, us, ms, s or min, as in "20ms"')


class setting(Generic[T]):
    """A setting of a module, which is a parameter in ROS 2.

    As an attribute of a class it declares the setting; in an instance it is the current value::

        gain = downbeat.setting(0.008, unit="s", range=(0, 1), about="of the tilt")

    The default determines the kind: bool, int, float, str, bytes, or a list of one of them.
    """

    def __init__(
        self,
        default: T,
        *,
        unit: str = "",
        range: tuple[float, float] | None = None,
        about: str = "",
        read_only: bool = False,
    ) -> None:
        self.default = default
        self.range = range
        self.about = ", ".join(part for part in (about, unit) if part)
        self.read_only = read_only
        self.name = ""

    def __set_name__(self, owner: type, name: str) -> None:
        self.name = name

    @overload
    def __get__(self, instance: None, owner: type) -> Self: ...
    @overload
    def __get__(self, instance: "Module", owner: type) -> T: ...
    def __get__(self, instance: "Module | None", owner: type) -> Self | T:
        if instance is None:
            return self
        return cast(T, instance._link.setting(self.name))

    def __set__(self, instance: "Module", value: T) -> None:
        raise AttributeError(
            f'a setting changes in the sync phase: write self.set("{self.name}", value), which other modules may too'
        )


#: The type of a topic, service or action: its name, such as ``sensor_msgs/msg/Imu``, or its class in :mod:`downbeat.msgs`.
Interface: TypeAlias = "str | type[Any]"


def _name_of(interface: Interface) -> str:
    if isinstance(interface, str):
        return interface
    name = getattr(interface, "TYPE_NAME", None)
    if isinstance(name, str):
        return name
    # A class of rclpy, such as sensor_msgs.msg._imu.Imu.
    parts = getattr(interface, "__module__", "").split(".")
    if len(parts) > 1 and parts[1] in ("msg", "srv", "action"):
        return "/".join((*parts[:2], interface.__name__))
    raise TypeError(f'a type is a text such as "sensor_msgs/msg/Imu", or a class of downbeat.msgs, not {interface!r}')


def subscribe(topic: str, type: Interface) -> Callable[[F], F]:
    """Declares that the method receives each message of a topic, as in ``@subscribe("imu", "sensor_msgs/msg/Imu")``."""
    return _declares(lambda module, method: module.subscribe(topic, type, method))


def every(period: float | str) -> Callable[[F], F]:
    """Declares that the method runs periodically, as in ``@every("20ms")``."""
    return _declares(lambda module, method: module.every(period, method))


def serve(service: str, type: Interface) -> Callable[[F], F]:
    """Declares that the method serves a service, see :meth:`Module.serve`."""
    return _declares(lambda module, method: module.serve(service, type, method))


def on_change(name: str) -> Callable[[F], F]:
    """Declares that the method runs when a setting has another value."""
    return _declares(lambda module, method: module.on_change(name, method))


def each_run(method: F) -> F:
    """Declares that the method runs at the end of each run of the module, after everything else."""
    return _declares(lambda module, bound: module.each_run(bound))(method)


def action(name: str, type: Interface) -> Callable[[F], F]:
    """Declares that the method takes the goals of an action, see :meth:`Module.act`."""
    return _declares(lambda module, method: module.act(name, type, method))


def _declares(declare: Callable[["Module", Callable[..., Any]], Any]) -> Callable[[F], F]:
    def mark(method: F) -> F:
        method.__dict__.setdefault(_DECLARED, []).append(declare)
        return method

    return mark


class Task:
    """Something that a module does once, at a time that it chooses; from :meth:`Module.task`."""

    def __init__(self, link: _core.Link, number: int) -> None:
        self._link = link
        self._number = number

    def after(self, delay: float | str) -> None:
        """Runs the task ``delay`` after the time of the cycle."""
        self._link.schedule(self._number, duration(delay))

    def cancel(self) -> None:
        """Forgets what the task was scheduled for."""
        self._link.cancel(self._number)


class Log:
    """Lines in the log of the program, under the name of the module; in ROS 2 on ``/rosout``.

    ``self.log.warning("servo 5 is silent", every="10s")`` writes the line of this place in the source at most once in ten
    seconds, and how often it was left out; with ``once=True`` it is written once in the life of the module. Times are those of
    cycles, so that a replay writes the same lines.
    """

    def __init__(self, link: _core.Link) -> None:
        self._link = link
        # By place in the source: when the line was written, and how often it was left out since.
        self._limits: dict[tuple[str, int], tuple[int, int]] = {}

    def debug(self, text: object, *, every: float | str | None = None, once: bool = False) -> None:
        self._write(10, text, every, once)

    def info(self, text: object, *, every: float | str | None = None, once: bool = False) -> None:
        self._write(20, text, every, once)

    def warning(self, text: object, *, every: float | str | None = None, once: bool = False) -> None:
        self._write(30, text, every, once)

    warn = warning

    def error(self, text: object, *, every: float | str | None = None, once: bool = False) -> None:
        self._write(40, text, every, once)

    def _write(self, level: int, text: object, every: float | str | None, once: bool) -> None:
        line, place = str(text), sys._getframe(2)
        if once or every is not None:
            key, now = (place.f_code.co_filename, place.f_lineno), self._link.now
            if key in self._limits:
                written, suppressed = self._limits[key]
                period = 0 if every is None else round(duration(every) * 1e9)
                if once or written <= now < written + period:
                    self._limits[key] = (written, suppressed + 1)
                    return
                if suppressed:
                    line += f" suppressed={suppressed}"
            self._limits[key] = (now, 0)
        code = place.f_code
        self._link.log(level, line, code.co_filename, place.f_lineno, code.co_name)


class Module:
    """A unit of robot software: state, and methods that the core calls one at a time.

    A module knows no other module, only names of topics, services and settings. What a method asks for (publish, call, set)
    takes effect in the sync phase that follows. Declarations belong into :meth:`setup` or are decorators of methods.

    An exception ends the module, and only it: the traceback is in the log, and ``restart`` in the robot file decides what
    follows. Use :meth:`now` and :attr:`random` in place of ``time`` and ``random``: with them a recorded run repeats.
    """

    _link: _core.Link
    #: Lines in the log.
    log: Log
    #: Random numbers that are the same in each run of the robot, and in a replay.
    random: random.Random

    def __new__(cls, *args: Any, **kwargs: Any) -> Self:
        self = super().__new__(cls)
        self._link = _core.Link()
        self.log = Log(self._link)
        self.random = random.Random(0)
        return self

    # What a user overrides.

    def setup(self) -> None:
        """Declares what the module publishes, receives and does. Settings have their values already."""

    def configure(self) -> None:
        """From unconfigured to inactive. An exception refuses the transition."""

    def activate(self) -> None:
        """From inactive to active, before every other method."""

    def deactivate(self) -> None:
        """From active to inactive."""

    def cleanup(self) -> None:
        """From inactive to unconfigured."""

    def shutdown(self) -> None:
        """The last method that is called, when the robot stops or the module is removed; not after an exception, and not
        when a newer version takes over."""

    def accept(self, name: str, value: Any) -> None:
        """Checks a value that a setting is about to have. An exception refuses it with its text."""

    def save(self) -> Any:
        """Returns the state for a newer version of the module, and releases what that opens again; see ``reload`` in the
        robot file. ``None`` for no state."""
        return None

    def restore(self, state: Any) -> None:
        """Takes over the state of the version before, after :meth:`setup`."""

    # What a user calls in `setup`.

    def publish(self, topic: str, type: Interface) -> _core.Publisher:
        """Declares that the module publishes on a topic. The result is called with a message or with its fields::

            self.out = self.publish("joint_commands", "sensor_msgs/msg/JointState")
            ...
            self.out(name=["head_tilt"], position=[0.1])
        """
        return self._link.publish(topic, _name_of(type))

    def subscribe(self, topic: str, type: Interface, callback: Callable[[Any], None]) -> None:
        """Calls ``callback`` with each message of a topic."""
        self._link.subscribe(topic, _name_of(type), callback)

    def every(self, period: float | str, callback: Callable[[], None]) -> None:
        """Calls ``callback`` periodically."""
        self._link.every(duration(period), callback)

    def task(self, callback: Callable[[], None]) -> Task:
        """Declares something to be done at a time that is chosen later."""
        return Task(self._link, self._link.task(callback))

    def each_run(self, callback: Callable[[], None]) -> None:
        """Calls ``callback`` at the end of each run."""
        self._link.each_run(callback)

    def on_change(self, name: str, callback: Callable[[], None]) -> None:
        """Calls ``callback`` when a setting has another value."""
        self._link.on_change(name, callback)

    def serve(self, service: str, type: Interface, callback: Callable[[Any], Any]) -> None:
        """Serves a service: ``callback`` takes a request and returns the response, as a message or as a mapping of fields.

        It raises :class:`Refused` where it has none.
        """

        def answer(request: Any, open: _core.Request) -> None:
            response = callback(request)
            if response is None or isinstance(response, Mapping):
                open.reply(**(response or {}))
            else:
                open.reply(response)

        self.serve_later(service, type, answer)

    def serve_later(self, service: str, type: Interface, callback: Callable[[Any, _core.Request], None]) -> None:
        """Serves a service whose requests are answered when the answer is there: ``callback`` takes a request, and something
        to answer it with: ``open.reply(field=value)`` or ``open.refuse(reason)``, once. Raising :class:`Refused` refuses it."""

        def take(request: Any, open: _core.Request) -> None:
            try:
                callback(request, open)
            except Refused as refused:
                open.refuse(str(refused))

        self._link.serve(service, _name_of(type), take)

    def client(self, service: str, type: Interface, timeout: float | str = "5s") -> _core.Client:
        """Declares that the module calls a service. The result is called with a request or with its fields, and with a
        function that takes the response, or ``None`` and the reason why there is none::

            self.enable = self.client("enable", "std_srvs/srv/SetBool", timeout="1s")
            ...
            self.enable(data=True, then=lambda response, problem: self.log.info(problem or response.message))
        """
        return self._link.client(service, _name_of(type), duration(timeout))

    def act(self, name: str, type: Interface, callback: Callable[["_Goal"], None]) -> None:
        """Serves an action: ``callback`` takes each goal, see :class:`downbeat.Goal`."""
        from downbeat.action import ActionServer

        ActionServer(self, name, _name_of(type), callback)

    def action_client(self, name: str, type: Interface, timeout: float | str = "5s") -> "_ActionClient":
        """Declares that the module sends goals to an action, see :class:`downbeat.ActionClient`."""
        from downbeat.action import ActionClient

        return ActionClient(self, name, _name_of(type), timeout)

    # What a user calls in every method.

    @property
    def name(self) -> str:
        """The name of the module in the robot file."""
        return self._link.module_name

    def now(self) -> Time:
        """The time of the cycle: the same for all methods that it calls."""
        return Time(self._link.now)

    def set(self, name: str, value: Any, module: str | None = None) -> None:
        """Changes a setting of this module or of another, in the sync phase. What the setting refuses is logged."""
        self._link.set(module or self.name, name, value)

    def transition(self, transition: str, module: str | None = None) -> None:
        """Asks for a transition of this module or of another, such as ``"deactivate"``."""
        self._link.transition(module or self.name, transition)

    def remove(self, module: str | None = None) -> None:
        """Removes this module or another."""
        self._link.remove(module or self.name)

    # What the core calls.

    _class_settings: ClassVar[dict[str, setting[Any]]] = {}

    def __init_subclass__(cls, **kwargs: Any) -> None:
        super().__init_subclass__(**kwargs)
        own = {name: value for name, value in vars(cls).items() if isinstance(value, setting)}
        cls._class_settings = {**cls._class_settings, **own}

    def _set_up(self) -> None:
        self.random.seed(self.name)
        for name, declared in self._class_settings.items():
            self._link.declare_setting(name, declared.default, declared.about, declared.range, declared.read_only)
        # In the order of the source, those of base classes first.
        methods: dict[str, None] = {}
        for ancestor in reversed(type(self).__mro__):
            methods.update(dict.fromkeys(vars(ancestor)))
        for method in methods:
            function = getattr(type(self), method, None)
            for declare in getattr(function, _DECLARED, ()):
                declare(self, getattr(self, method))
        self.setup()


# Only for annotations: `downbeat.action` needs this file.
_Goal = Any
_ActionClient = Any
