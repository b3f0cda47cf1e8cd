"""Writes the same messages into bags with `rosbags` and `mcap-ros2-support`, in the given folder, and prints the
contents of each: topic, time and data of every message, ordered by time."""

import json
import sys
from pathlib import Path

import numpy as np
from mcap.writer import CompressionType
from mcap_ros2.writer import Writer as McapRos2Writer
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

START = 1_700_000_000_000_000_000
COUNT = 200
JOINT_STATE = """std_msgs/Header header
string[] name
float64[] position
float64[] velocity
float64[] effort
================================================================================
MSG: std_msgs/Header
builtin_interfaces/Time stamp
string frame_id
================================================================================
MSG: builtin_interfaces/Time
int32 sec
uint32 nanosec
"""

folder = Path(sys.argv[1])
store = get_typestore(Stores.ROS2_JAZZY)
String = store.types["std_msgs/msg/String"]
JointState = store.types["sensor_msgs/msg/JointState"]
Header = store.types["std_msgs/msg/Header"]
Time = store.types["builtin_interfaces/msg/Time"]
none = np.array([], dtype=np.float64)


def messages():
    for n in range(COUNT):
        time = START + n * 10_000_000
        yield "/chatter", String(data=f"number {n} " + "x" * (n % 50)), time
        header = Header(stamp=Time(sec=n, nanosec=n * 1000), frame_id="base")
        position = np.array([n / 7, -n], dtype=np.float64)
        state = JointState(header=header, name=["a", "b"], position=position, velocity=none, effort=none)
        yield "/joint_states", state, time + 3_000_000


def rosbag(name, version, storage, mode):
    found = []
    writer = Writer(folder / name, version=version, storage_plugin=storage)
    writer.set_compression(mode, CompressionFormat.ZSTD)
    with writer:
        connections = {}
        for topic, message, time in messages():
            of = message.__msgtype__
            if topic not in connections:
                connections[topic] = writer.add_connection(topic, of, typestore=store)
            data = bytes(store.serialize_cdr(message, of))
            writer.write(connections[topic], time, data)
            found.append([topic, time, data.hex()])
    return found


def mcap_ros2(name, compression):
    found = []
    path = folder / f"{name}.mcap"
    with McapRos2Writer(str(path), compression=compression, chunk_size=4000) as writer:
        string = writer.register_msgdef("std_msgs/msg/String", "string data")
        state = writer.register_msgdef("sensor_msgs/msg/JointState", JOINT_STATE)
        for topic, message, time in messages():
            of = message.__msgtype__
            plain = message
            if topic == "/joint_states":
                plain = {
                    "header": {
                        "stamp": {"sec": message.header.stamp.sec, "nanosec": message.header.stamp.nanosec},
                        "frame_id": message.header.frame_id,
                    },
                    "name": message.name,
                    "position": list(message.position),
                    "velocity": [],
                    "effort": [],
                }
            schema = state if topic == "/joint_states" else string
            writer.write_message(topic, schema, plain, log_time=time, publish_time=time)
            found.append([topic, time, bytes(store.serialize_cdr(message, of)).hex()])
    return found


bags = {}
for version in (8, 9):
    for storage in (StoragePlugin.SQLITE3, StoragePlugin.MCAP):
        for mode in (CompressionMode.NONE, CompressionMode.FILE, CompressionMode.MESSAGE, CompressionMode.STORAGE):
            if storage == StoragePlugin.SQLITE3 and mode == CompressionMode.STORAGE:
                continue
            name = f"rosbags_{version}_{storage.name}_{mode.name}".lower()
            bags[name] = rosbag(name, version, storage, mode)
for compression in CompressionType:
    name = f"mcap_ros2_{compression.name}".lower()
    bags[f"{name}.mcap"] = mcap_ros2(name, compression)
print(json.dumps(bags))
