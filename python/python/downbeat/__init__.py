"""Robot software as small modules in one process: modules, messages and bags in Python."""

from downbeat import _core, msgs
from downbeat._core import Message

__all__ = ["Message", "msgs"]
