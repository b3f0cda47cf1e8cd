"""Robot software as small modules in one process: modules, messages and bags in Python."""

from downbeat import _core, msgs
from downbeat._bags import Bag, BagMessage, Table, Topic, Writer
from downbeat._core import Client, Message, Publisher, ReplayReport, Request, Robot
from downbeat.action import ActionClient, Goal
from downbeat.module import (
    Module,
    Refused,
    Task,
    Time,
    action,
    each_run,
    every,
    on_change,
    serve,
    setting,
    subscribe,
)
from downbeat.program import main, replay, run, start

# Needs the names above.
from downbeat import test  # isort: skip

__all__ = [
    "ActionClient",
    "Bag",
    "BagMessage",
    "Client",
    "Goal",
    "Message",
    "Module",
    "Publisher",
    "Refused",
    "ReplayReport",
    "Request",
    "Robot",
    "Table",
    "Task",
    "Time",
    "Topic",
    "Writer",
    "action",
    "each_run",
    "every",
    "main",
    "msgs",
    "on_change",
    "replay",
    "run",
    "serve",
    "setting",
    "start",
    "subscribe",
    "test",
]
