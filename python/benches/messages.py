"""Times of messages in Python: a JointState of 20 joints received, read and answered; an image of 1 MB as an array.

Usage: python benches/messages.py
"""

from __future__ import annotations

import timeit
from collections.abc import Callable
from typing import Any

import numpy as np

from downbeat.msgs.sensor_msgs.msg import Image, JointState

NAMES = [f"joint_{number}" for number in range(20)]
VALUES = np.linspace(0, 1, 20)


def best(function: Callable[[], Any], number: int = 20_000) -> float:
    """Microseconds of the best of several rounds."""
    return min(timeit.repeat(function, number=number, repeat=7)) / number * 1e6


def main() -> None:
    header = {"stamp": {"sec": 1}, "frame_id": "body"}
    state = JointState(header=header, name=NAMES, position=VALUES, velocity=VALUES, effort=VALUES).to_cdr()
    image = Image.from_numpy(np.zeros((600, 600, 3), np.uint8)).to_cdr()
    received = JointState.from_cdr(state)

    def read() -> JointState:
        message = JointState.from_cdr(state)
        message.header.stamp.sec, message.header.stamp.nanosec, message.header.frame_id
        message.name, message.position, message.velocity, message.effort
        return message

    def answer() -> bytes:
        return JointState(header=received.header, name=NAMES, position=VALUES).to_cdr()

    def answer_with_lists() -> bytes:
        return JointState(name=NAMES, position=[0.5] * 20).to_cdr()

    def forward() -> bytes:
        message = JointState.from_cdr(state)
        message.header.frame_id = "other"
        return message.to_cdr()

    def both() -> bytes:
        message = read()
        return JointState(header=message.header, name=message.name, position=message.position).to_cdr()

    rows: list[tuple[str, Callable[[], Any]]] = [
        ("JointState: received", lambda: JointState.from_cdr(state)),
        ("JointState: received, all fields read", read),
        ("JointState: answered, from arrays", answer),
        ("JointState: answered, from lists", answer_with_lists),
        ("JointState: received, one field changed, sent", forward),
        ("JointState: received, all fields read, answered", both),
        ("Image of 1 MB: received, to an array", lambda: Image.from_cdr(image).to_numpy()),
        ("one field of a received message, again", lambda: received.position),
    ]
    for name, function in rows:
        print(f"{name:50} {best(function):7.2f} us")


if __name__ == "__main__":
    main()
