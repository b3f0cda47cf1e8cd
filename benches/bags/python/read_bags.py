"""Reads one topic of a bag with rosbags, several times, and prints the best seconds per message of the topic.

Usage: read_bags.py BAG TOPIC TURNS
"""

import json
import sys
import time
from pathlib import Path

from rosbags.highlevel import AnyReader

bag, topic, turns = Path(sys.argv[1]), sys.argv[2], int(sys.argv[3])


def turn(deserialize):
    started = time.perf_counter()
    count = 0
    with AnyReader([bag]) as reader:
        connections = [connection for connection in reader.connections if connection.topic == topic]
        for connection, _, data in reader.messages(connections=connections):
            if deserialize:
                reader.deserialize(data, connection.msgtype)
            count += 1
    return (time.perf_counter() - started) / count


print(json.dumps({
    "rosbags, bytes": min(turn(False) for _ in range(turns)),
    "rosbags, decoded": min(turn(True) for _ in range(turns)),
}))
