"""Bags: what :class:`Bag` and :class:`Writer` add to the Rust half."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import numpy.typing as npt

from downbeat import _core

if TYPE_CHECKING:
    import pandas
    import pyarrow

__all__ = ["Bag", "BagMessage", "Table", "Topic", "Writer"]

Topic = _core.Topic
Writer = _core.Writer


class BagMessage(NamedTuple):
    """A message of a bag: ``for topic, message, time in bag``."""

    #: The name of its topic.
    topic: str
    #: The message, whose fields are decoded when they are read.
    message: Any
    #: When it was received, in nanoseconds since the epoch.
    time: int


class Bag(_core.Bag):
    """A bag that was recorded: a directory of rosbag2, or one of its files.

    >>> bag = Bag("morning_run")
    >>> for topic, message, time in bag.messages(topics=["/imu"]):
    ...     print(time, message.angular_velocity.z)

    Messages come in the order in which they were received. Bags of interrupted recordings can be read as well: ``missing`` lists
    what is lost. Raises ``FileNotFoundError`` if there is no such file, ``ValueError`` if it is no bag.
    """

    __slots__ = ()

    def __iter__(self) -> Iterator[BagMessage]:
        """All messages."""
        return super().__iter__()

    def messages(
        self, topics: str | Iterable[str] | None = None, start: int | None = None, end: int | None = None
    ) -> Iterator[BagMessage]:
        """The messages of these topics, received from ``start`` to ``end``, both included, in nanoseconds since the epoch.

        Raises ``KeyError`` for an unknown topic. While iterating, a damaged part of the bag raises ``ValueError`` once; iterating
        again continues after it.
        """
        names = [topics] if isinstance(topics, str) else topics
        return super().messages(None if names is None else list(names), start, end)

    def table(self, topic: str, start: int | None = None, end: int | None = None) -> Table:
        """The messages of a topic as a table, a row each. Raises ``KeyError`` for an unknown topic."""
        return Table(topic, *self.columns(topic, start, end))


class Table:
    """A topic as a table: a column for each number, boolean and text in the messages, named by its path: ``position[3]``.

    A sequence has as many columns as its longest has elements; bytes, and arrays of more than 1000 elements, have one.
    """

    def __init__(
        self,
        topic: str,
        received: bytearray,
        published: bytearray,
        columns: list[tuple[str, str, bytearray | list[Any], bytearray | None]],
    ) -> None:
        self.topic = topic
        #: When each message was received and published, in nanoseconds since the epoch.
        self.time: npt.NDArray[np.int64] = np.frombuffer(received, np.int64)
        self.publish_time: npt.NDArray[np.int64] = np.frombuffer(published, np.int64)
        self._columns: dict[str, tuple[npt.NDArray[Any], npt.NDArray[np.bool_] | None]] = {}
        for name, dtype, values, there in columns:
            if isinstance(values, list):
                array: npt.NDArray[Any] = np.empty(len(values), object)
                array[:] = values
            else:
                array = np.frombuffer(values, dtype)
            self._columns[name] = (array, None if there is None else np.frombuffer(there, np.bool_))

    @property
    def columns(self) -> list[str]:
        """The names of the columns, without the times."""
        return list(self._columns)

    def __len__(self) -> int:
        return len(self.time)

    def __getitem__(self, column: str) -> npt.NDArray[Any]:
        """The values of a column. Where a row has none, because its sequence is shorter, the column is a masked array."""
        values, there = self._columns[column]
        return values if there is None else np.ma.masked_array(values, ~there)

    def __repr__(self) -> str:
        return f"Table({self.topic!r}, {len(self)} rows, {len(self._columns)} columns)"

    def to_pandas(self) -> pandas.DataFrame:
        """A data frame, indexed by the time of receipt. Integers with gaps become pandas' ``Int64``.

        Raises ``ImportError`` if pandas is not installed.
        """
        try:
            import pandas
        except ImportError as error:
            raise ImportError("Table.to_pandas needs pandas: pip install pandas") from error
        data: dict[str, Any] = {}
        for name, (values, there) in self._columns.items():
            if there is None or values.dtype.kind in "fO":  # NaN and None mark the gaps of these.
                data[name] = values
            else:
                kind = pandas.arrays.BooleanArray if values.dtype.kind == "b" else pandas.arrays.IntegerArray
                data[name] = kind(values, ~there)
        index = pandas.DatetimeIndex(self.time.view("datetime64[ns]"), tz="UTC", name="time")
        return pandas.DataFrame(data, index=index)

    def to_arrow(self) -> pyarrow.Table:
        """A table of Arrow, whose first columns are ``time`` and ``publish_time``.

        Raises ``ImportError`` if pyarrow is not installed.
        """
        try:
            import pyarrow
        except ImportError as error:
            raise ImportError("Table.to_arrow needs pyarrow: pip install pyarrow") from error
        stamp = pyarrow.timestamp("ns", tz="UTC")
        arrays = {"time": pyarrow.array(self.time, stamp), "publish_time": pyarrow.array(self.publish_time, stamp)}
        for name, (values, there) in self._columns.items():
            arrays[name] = pyarrow.array(values, mask=None if there is None else ~there)
        return pyarrow.table(arrays)
