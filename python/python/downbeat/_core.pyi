"""The Rust half of downbeat."""

import os
from collections.abc import Iterator, Mapping
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
    def path(self) -> str: ...
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
    def path(self) -> str: ...
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
