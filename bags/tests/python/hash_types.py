"""Prints the type hashes in bags by topic, the hashes that `rosbags` computes from their definitions, and those that the
packages of ROS 2 publish, by type. Usage: hash_types.py FOLDER, which contains the bags `messages` and `events`."""

import json
import sys
from pathlib import Path

from mcap.reader import make_reader
from rosbags.rosbag2 import Reader
from rosbags.typesys import Stores, get_typestore
from schemas import types_of

folder = Path(sys.argv[1])
recorded, computed, published = {}, {}, {}
for name in ("messages", "events"):
    with (folder / name / f"{name}_0.mcap").open("rb") as stream:
        for channel in make_reader(stream).get_summary().channels.values():
            recorded[channel.topic] = channel.metadata["topic_type_hash"]
for name in ("messages", "events"):
    with Reader(folder / name) as reader:
        for connection in reader.connections:
            assert connection.digest == recorded[connection.topic], connection.topic
            try:
                store = get_typestore(Stores.EMPTY)
                store.register(types_of(connection))
                computed[connection.topic] = store.hash_rihs01(connection.msgtype)
            except Exception as error:  # the test knows what it cannot read
                print(f"{connection.topic}: {error!r}", file=sys.stderr)
for kind in ("msg", "srv", "action"):
    for path in (Path(sys.prefix) / "share").glob(f"*/{kind}/*.json"):
        for entry in json.loads(path.read_text())["type_hashes"]:
            published[entry["type_name"]] = entry["hash_string"]
print(json.dumps({"recorded": recorded, "computed": computed, "published": published}))
