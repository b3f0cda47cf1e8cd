"""What the fields of messages accept, for type checkers."""

from __future__ import annotations

import array
from collections.abc import Sequence
from typing import Any, TypeAlias

import numpy.typing as npt

Booleans: TypeAlias = "Sequence[bool] | npt.NDArray[Any]"
Bytes: TypeAlias = "Sequence[int] | bytes | bytearray | memoryview | npt.NDArray[Any] | array.array[Any]"
Floats: TypeAlias = "Sequence[float] | npt.NDArray[Any] | array.array[Any]"
Integers: TypeAlias = "Sequence[int] | npt.NDArray[Any] | array.array[Any]"
