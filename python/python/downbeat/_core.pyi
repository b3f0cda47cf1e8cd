"""The Rust half of downbeat."""

import os
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any, ClassVar, Self

from downbeat._bags import BagMessage

class Message:
    """A message. Fields are decoded from bytes when they are read for the first time, and kept.

    Assigning a field checks its type and its range. A received message shares its bytes: arrays are read-only views of them, which
    stay valid when the message is gone. Nothing ever changes the bytes; what is assigned belongs to this message alone.
    """

    TYPE_NAME: ClassVar[str]
    """As in ``sensor_msgs/msg/Imu``."""
    TYPE_HASH: ClassVar[str]
    """``RIHS01_`` and 64 hexadecimal digits, as ROS 2 compares types."""
    DEFINITION: ClassVar[str]
    """The text of the definition with all it refers to, as in bags."""

    @classmethod
    def from_cdr(cls, data: bytes | bytearray | memoryview) -> Self:
        """Reads a message from its serialised form, CDR with its header of four bytes, without a copy if ``data`` is ``bytes``.

        Invalid bytes raise ``ValueError``: those of a field when it is read for the first time.
        """
    def to_cdr(self) -> bytes:
        """The serialised form: CDR, little-endian, with its header of four bytes."""
    @classmethod
    def get_fields_and_field_types(cls) -> dict[str, str]:
        """The names of the fields and their types in the words of rosidl, as in rclpy."""
    def __eq__(self, other: object) -> bool: ...

class Topic:
    """A topic of a bag."""

    @property
    def name(self) -> str: ...
    @property
    def type_name(self) -> str: ...
    @property
    def type_hash(self) -> str: ...
    @property
    def definition(self) -> str: ...
    @property
    def message_count(self) -> int: ...
    @property
    def message_class(self) -> type[Message]: ...

class Bag:
    def __init__(self, path: str | os.PathLike[str]) -> None: ...
    @property
    def path(self) -> Path: ...
    @property
    def topics(self) -> dict[str, Topic]:
        """The topics, by name, including those without messages."""
    @property
    def message_count(self) -> int: ...
    @property
    def start_time(self) -> int | None:
        """When the first message was received, in nanoseconds since the epoch."""
    @property
    def end_time(self) -> int | None:
        """When the last message was received, in nanoseconds since the epoch."""
    @property
    def duration(self) -> int:
        """From the first message to the last, in nanoseconds."""
    @property
    def missing(self) -> list[str]:
        """What is lost because recording was interrupted or a file was damaged."""
    def __len__(self) -> int: ...
    def __iter__(self) -> Iterator[BagMessage]: ...
    def messages(
        self, topics: list[str] | None = None, start: int | None = None, end: int | None = None
    ) -> Iterator[BagMessage]: ...
    def columns(
        self, topic: str, start: int | None = None, end: int | None = None
    ) -> tuple[bytearray, bytearray, list[tuple[str, str, bytearray | list[Any], bytearray | None]]]: ...

class Writer:
    """Writes a bag: a directory of rosbag2 with MCAP files, which must not exist yet.

    >>> with Writer("morning_run", compression="zstd") as bag:
    ...     bag.write("/imu", Imu(), time=1_000_000_000)

    What was written is readable at most a second later, even if the process is killed.
    Raises ``FileExistsError`` if the directory exists, ``OSError`` if it cannot be written.
    """

    def __init__(
        self,
        path: str | os.PathLike[str],
        *,
        compression: str = "none",
        custom_data: Mapping[str, str] | None = None,
    ) -> None:
        """``compression`` is ``none``, ``lz4`` or ``zstd``; ``custom_data`` is kept in the metadata of the bag."""
    @property
    def path(self) -> Path: ...
    def add_topic(self, topic: str, message_class: type[Any]) -> None:
        """Adds a topic, which may remain without messages."""
    def write(self, topic: str, message: Any, time: int | None = None, *, publish_time: int | None = None) -> None:
        """Writes a message of ours or of rclpy, whose type becomes that of the topic.

        ``time`` is when it was received, in nanoseconds since the epoch, by default now; ``publish_time`` is by default the same.
        """
    def close(self) -> None:
        """Finishes the bag. Does nothing if it is closed."""
    def __enter__(self) -> Self: ...
    def __exit__(self, *exception: object) -> None: ...

def message_class(name: str) -> type[Message]: ...
def search_interfaces(path: str) -> int: ...
def interface_packages() -> list[str]: ...
def interfaces(package: str) -> list[tuple[str, str]]: ...
def describe_fields(name: str) -> list[tuple[str, str, bool, str, str]]: ...
def constant_names(name: str) -> list[str]: ...
class Link:
    """The link of a module to its core; used by :class:`downbeat.Module`."""

    def __new__(cls) -> Link: ...
    @property
    def module_name(self) -> str: ...
    @property
    def now(self) -> int: ...
    def publish(self, topic: str, type_name: str) -> Publisher: ...
    def subscribe(self, topic: str, type_name: str, callback: Callable[[Any], None]) -> None: ...
    def serve(self, service: str, type_name: str, callback: Callable[[Any, Request], None]) -> None: ...
    def client(self, service: str, type_name: str, timeout: float) -> Client: ...
    def every(self, period: float, callback: Callable[[], None]) -> None: ...
    def task(self, callback: Callable[[], None]) -> int: ...
    def each_run(self, callback: Callable[[], None]) -> None: ...
    def declare_setting(
        self,
        name: str,
        default: Any,
        description: str,
        range: tuple[float, float] | None = None,
        read_only: bool = False,
    ) -> None: ...
    def on_change(self, setting: str, callback: Callable[[], None]) -> None: ...
    def setting(self, name: str) -> Any: ...
    def set(self, module: str, setting: str, value: Any) -> None: ...
    def schedule(self, task: int, delay: float) -> None: ...
    def cancel(self, task: int) -> None: ...
    def transition(self, module: str, transition: str) -> None: ...
    def remove(self, module: str) -> None: ...
    def log(self, level: int, text: str, file: str, line: int, function: str) -> None: ...

class Publisher:
    """Publishes the messages of one topic."""

    def __call__(self, message: Any = None, /, **fields: Any) -> None:
        """Publishes a message, or one with these fields."""

class Client:
    """Calls one service."""

    def __call__(
        self, request: Any = None, /, *, then: Callable[[Any, str | None], None], **fields: Any
    ) -> None:
        """Calls the service. ``then`` takes the response, or ``None`` and the reason why there is none."""

class Request:
    """A request that is answered later, once."""

    def reply(self, response: Any = None, /, **fields: Any) -> None:
        """Answers with a response, or with one of these fields."""
    def refuse(self, reason: str) -> None:
        """Answers that there is no response."""

class Robot:
    """A robot that runs beside a script, until it is stopped."""

    @property
    def is_running(self) -> bool: ...
    def stop(self) -> None: ...
    def set(self, module: str, setting: str, value: Any) -> None: ...
    def __enter__(self) -> Robot: ...
    def __exit__(self, *exception: object) -> None: ...

class Probe:
    """Modules under test; used by :class:`downbeat.test.Robot`."""

    def __new__(cls) -> Probe: ...
    @property
    def now(self) -> int: ...
    def add(self, name: str, kind: type | str, settings: dict[str, Any], remap: dict[str, str]) -> None: ...
    def inject(self, topic: str, message: Any, fields: dict[str, Any]) -> None: ...
    def advance(self, time: float) -> None: ...
    def next(self, topic: str, within: float) -> Any: ...
    def heard(self, topic: str) -> list[Any]: ...
    def waiting(self) -> dict[str, int]: ...
    def call(self, service: str, request: Any, fields: dict[str, Any]) -> tuple[Any, str]: ...
    def set(self, module: str, setting: str, value: Any) -> None: ...

class ReplayReport:
    """What was replayed, and how it differs from the bag; as a text, the report."""

    @property
    def different(self) -> int: ...
    @property
    def compared(self) -> int: ...
    @property
    def changed_sources(self) -> list[str]: ...
    def assert_same(self) -> None:
        """Raises ``AssertionError`` with the report unless the replay equals the bag."""

def main(kinds: dict[str, Any], line: list[str]) -> int: ...
def start(kinds: dict[str, Any], robot: str) -> Robot: ...
def replay(kinds: dict[str, Any], robot: str, bag: str) -> ReplayReport: ...
