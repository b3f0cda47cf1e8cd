"""Prints how many messages `mcap` and `rosbags` find in a bag, and its topics. Usage: count_messages.py BAG"""

import json
import sys
from pathlib import Path

from mcap.reader import make_reader
from rosbags.rosbag2 import Reader

bag = Path(sys.argv[1])
with (bag / f"{bag.name}_0.mcap").open("rb") as stream:
    in_mcap = sum(1 for _ in make_reader(stream).iter_messages())
with Reader(bag) as reader:
    in_rosbag2 = sum(1 for _ in reader.messages())
    topics = [connection.topic for connection in reader.connections]
print(json.dumps({"mcap": in_mcap, "rosbag2": in_rosbag2, "topics": topics}))
