"""Compares exported tables with the messages decoded by rosbags, message by message, cell by cell.

Usage: read_tables.py BAG DIRECTORY. The directory has /joint_states and /bus/exchanges as .csv, .jsonl and .parquet, which
DuckDB reads. Prints the number of compared rows of each file; any difference raises.
"""

import base64
import json
import math
import sys
from pathlib import Path

import duckdb
from rosbags.highlevel import AnyReader

bag, directory = map(Path, sys.argv[1:])

messages = {"/joint_states": [], "/bus/exchanges": []}
with AnyReader([bag]) as reader:
    for connection, time, data in reader.messages():
        if connection.topic in messages:
            messages[connection.topic].append((time, reader.deserialize(data, connection.msgtype)))


def rows(path):
    # DuckDB needs more packages to return times with time zones to Python.
    select = {
        ".csv": "SELECT log_time AS received, * FROM read_csv(?)",
        ".parquet": "SELECT epoch_ns(log_time) AS received, * EXCLUDE (log_time, publish_time) FROM read_parquet(?)",
    }
    table = duckdb.execute(select[path.suffix], [str(path)])
    names = [column[0] for column in table.description]
    return [dict(zip(names, row)) for row in table.fetchall()]


def is_same(cell, value):
    return float(cell) == value or (math.isnan(float(cell)) and math.isnan(value))


compared = {}
for suffix in (".csv", ".parquet"):
    path = directory / f"joint_states{suffix}"
    table = rows(path)
    assert len(table) == len(messages["/joint_states"])
    for row, (time, message) in zip(table, messages["/joint_states"]):
        assert row["received"] == time
        assert row["header.stamp.nanosec"] == message.header.stamp.nanosec
        assert row["header.frame_id"] in (message.header.frame_id, None)
        for index, name in enumerate(message.name):
            assert row[f"name[{index}]"] == name
            assert is_same(row[f"position[{index}]"], message.position[index])
            assert is_same(row[f"effort[{index}]"], message.effort[index])
    compared[path.name] = len(table)

    path = directory / f"bus.exchanges{suffix}"
    table = rows(path)
    assert len(table) == len(messages["/bus/exchanges"])
    for row, (time, message) in zip(table, messages["/bus/exchanges"]):
        sent = row["instruction"]
        sent = base64.b64decode(sent or "") if suffix == ".csv" else bytes(sent)
        assert row["received"] == time and sent == message.instruction.tobytes()
    compared[path.name] = len(table)

lines = (directory / "joint_states.jsonl").read_text().splitlines()
assert len(lines) == len(messages["/joint_states"])
for line, (time, message) in zip(lines, messages["/joint_states"]):
    row = json.loads(line)
    assert row["log_time"] == time
    assert row["message"]["name"] == message.name
    assert row["message"]["position"] == message.position.tolist()
compared["joint_states.jsonl"] = len(lines)

print(json.dumps(compared))
