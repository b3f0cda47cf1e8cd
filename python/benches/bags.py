"""Reads a bag of mixed messages with downbeat, rosbags and mcap-ros2-support, and prints how they compare in this run.

Usage: python benches/bags.py [--messages 100000] [--rounds 3]

Each reads all messages of the same bag, uncompressed MCAP as rosbag2 writes it. "All fields" reads every field of every message
with the same code for all libraries, "lazily" one field of each message. The best round of each counts; they take turns. Compare
ratios: times depend on the machine.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory
from rosbags.rosbag2 import Reader
from rosbags.typesys import Stores, get_typestore

import downbeat as db
from downbeat import _core
from downbeat.msgs.geometry_msgs.msg import Twist
from downbeat.msgs.nav_msgs.msg import Odometry
from downbeat.msgs.sensor_msgs.msg import Image, Imu, JointState, LaserScan
from downbeat.msgs.tf2_msgs.msg import TFMessage

Touch = Callable[[Any], Any]


def touch_of(name: str, indent: str = "    ", message: str = "m") -> str:
    """Code that reads all fields of a message."""
    lines = []
    for number, (field, element, is_several, _, _) in enumerate(_core.describe_fields(name)):
        if "/" not in element:
            lines.append(f"{indent}{message}.{field}\n")
            continue
        inner = f"{message}_{number}"
        if is_several:
            lines.append(f"{indent}for {inner} in {message}.{field}:\n")
            lines.append(touch_of(element, indent + "    ", inner))
        else:
            lines.append(f"{indent}{inner} = {message}.{field}\n")
            lines.append(touch_of(element, indent, inner))
    return "".join(lines)


def compiled(name: str) -> Touch:
    scope: dict[str, Touch] = {}
    exec(f"def touch(m):\n{touch_of(name)}", scope)
    return scope["touch"]


def write(path: Path, count: int) -> dict[str, str]:
    header = {"stamp": {"sec": 1, "nanosec": 2}, "frame_id": "base_link"}
    names = [f"joint_{number}" for number in range(20)]
    values = np.linspace(0, 1, 20)
    transform = {"header": header, "child_frame_id": "left_foot"}
    kinds: list[tuple[str, Any, int]] = [
        ("/joint_states", JointState(header=header, name=names, position=values, velocity=values, effort=values), 30),
        ("/imu", Imu(header=header), 30),
        ("/tf", TFMessage(transforms=[transform] * 3), 15),
        ("/odom", Odometry(header=header, child_frame_id="base_link"), 10),
        ("/cmd_vel", Twist(), 10),
        ("/scan", LaserScan(header=header, ranges=np.ones(360, np.float32)), 4),
        ("/image", Image.from_numpy(np.zeros((48, 64, 3), np.uint8)), 1),
    ]
    turns = [kind for kind in kinds for _ in range(kind[2])]
    order = np.random.default_rng(1).permutation(len(turns))
    with db.Writer(path) as bag:
        for number in range(count):
            topic, message, _ = turns[order[number % len(turns)]]
            bag.write(topic, message, 1_000_000_000 + number)
    return {topic: message.TYPE_NAME for topic, message, _ in kinds}


def downbeat(path: Path) -> Iterator[tuple[str, Any]]:
    for topic, message, _ in db.Bag(path):
        yield topic, message


def rosbags(path: Path) -> Iterator[tuple[str, Any]]:
    store = get_typestore(Stores.ROS2_JAZZY)
    with Reader(path) as reader:
        for connection, _, data in reader.messages():
            yield connection.topic, store.deserialize_cdr(data, connection.msgtype)


def mcap(path: Path) -> Iterator[tuple[str, Any]]:
    with next(path.glob("*.mcap")).open("rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        for _, channel, _, message in reader.iter_decoded_messages():
            yield channel.topic, message


def main() -> None:
    parser = argparse.ArgumentParser(description="Compares readers of bags.")
    parser.add_argument("--messages", type=int, default=100_000)
    parser.add_argument("--rounds", type=int, default=3)
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "bag"
        types = write(path, arguments.messages)
        touch = {topic: compiled(name) for topic, name in types.items()}
        first = {topic: compiled_first(name) for topic, name in types.items()}
        best: dict[tuple[str, str], float] = {}
        for _ in range(arguments.rounds):
            for reader in (downbeat, rosbags, mcap):
                for how, read in (("all fields", touch), ("lazily", first)):
                    start = time.perf_counter()
                    count = 0
                    for topic, message in reader(path):
                        read[topic](message)
                        count += 1
                    taken = time.perf_counter() - start
                    assert count == arguments.messages
                    key = (reader.__name__, how)
                    best[key] = min(taken, best.get(key, taken))
    for how in ("all fields", "lazily"):
        ours = best["downbeat", how]
        for reader_name in ("downbeat", "rosbags", "mcap"):
            taken = best[reader_name, how]
            print(
                f"{how:10}  {reader_name:8}  {taken:7.3f} s  {taken / arguments.messages * 1e6:6.2f} us/message  "
                f"{taken / ours:5.1f} x downbeat"
            )


def compiled_first(name: str) -> Touch:
    field = _core.describe_fields(name)[0][0]
    scope: dict[str, Touch] = {}
    exec(f"def touch(m):\n    m.{field}", scope)
    return scope["touch"]


if __name__ == "__main__":
    main()
