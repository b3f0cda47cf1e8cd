"""Prints what `rosbags` and Python's own `sqlite3` find in a bag of SQLite files. Usage: read_sqlite.py BAG"""

import hashlib
import json
import sqlite3
import sys
from pathlib import Path

from rosbags.highlevel import AnyReader
from rosbags.rosbag2 import Reader


def digest(messages):
    found = hashlib.sha256()
    for topic, time, data in messages:
        found.update(f"{topic} {time} {len(data)} ".encode() + bytes(data))
    return found.hexdigest()


bag = Path(sys.argv[1])
with Reader(bag) as reader:
    messages = [(connection.topic, time, data) for connection, time, data in reader.messages()]
    in_rosbags = {
        "count": reader.message_count,
        "messages": len(messages),
        "digest": digest(messages),
        "types": {connection.topic: connection.msgtype for connection in reader.connections},
        "counts": {connection.topic: connection.msgcount for connection in reader.connections},
        "hashes": {connection.topic: connection.digest for connection in reader.connections},
    }
with AnyReader([bag]) as reader:
    decoded = [reader.deserialize(data, connection.msgtype) for connection, _, data in reader.messages()]

rows = []
for path in sorted(bag.glob("*.db3"), key=lambda path: int(path.stem.rsplit("_")[-1])):
    database = sqlite3.connect(path)
    assert database.execute("PRAGMA integrity_check").fetchall() == [("ok",)], path
    query = "SELECT name, timestamp, data FROM messages JOIN topics ON topic_id = topics.id ORDER BY timestamp, messages.id"
    rows += database.execute(query).fetchall()
    database.close()
print(
    json.dumps(
        {
            "rosbags": in_rosbags,
            "decoded": len(decoded),
            "sqlite3": {"messages": len(rows), "digest": digest(rows)},
        }
    )
)
