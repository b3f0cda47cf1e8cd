"""Writes a message many times with Python's writers and prints the seconds per message of each, the best of three turns.

Usage: write_bags.py MESSAGE COUNT FOLDER
"""

import json
import shutil
import sys
import time
from pathlib import Path

from mcap.writer import CompressionType, Writer as McapWriter
from rosbags.rosbag2 import StoragePlugin, Writer as RosbagsWriter
from rosbags.typesys import Stores, get_typestore

message = Path(sys.argv[1]).read_bytes()
count = int(sys.argv[2])
folder = Path(sys.argv[3])


def with_mcap(bag):
    bag.mkdir()
    with (bag / "bag.mcap").open("wb") as stream:
        writer = McapWriter(stream, chunk_size=768 * 1024, compression=CompressionType.NONE)
        writer.start("ros2")
        schema = writer.register_schema("sensor_msgs/msg/JointState", "ros2msg", b"string data")
        channel = writer.register_channel("/joint_states", "cdr", schema)
        for number in range(count):
            writer.add_message(channel, number, message, number)
        writer.finish()


def with_rosbags(bag):
    store = get_typestore(Stores.ROS2_JAZZY)
    with RosbagsWriter(bag, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        connection = writer.add_connection("/joint_states", "sensor_msgs/msg/JointState", typestore=store)
        for number in range(count):
            writer.write(connection, number, message)


def best_of_three(write):
    times = []
    for _ in range(3):
        bag = folder / "python"
        started = time.perf_counter()
        write(bag)
        times.append(time.perf_counter() - started)
        shutil.rmtree(bag)
    return min(times) / count


print(json.dumps({"Python mcap": best_of_three(with_mcap), "rosbags": best_of_three(with_rosbags)}))
