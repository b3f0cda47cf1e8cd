"""Prints how many messages `rosbags` finds in a bag of several files, and `mcap` in each of them. Usage: count_split.py BAG"""

import json
import sys
from pathlib import Path

from mcap.reader import make_reader
from rosbags.rosbag2 import Reader
from ruamel.yaml import YAML

bag = Path(sys.argv[1])
information = YAML(typ="safe").load(bag / "metadata.yaml")["rosbag2_bagfile_information"]
files = []
for file in information["files"]:
    with (bag / file["path"]).open("rb") as stream:
        count = sum(1 for _ in make_reader(stream, validate_crcs=True).iter_messages())
    assert count == file["message_count"], file
    files.append(count)
with Reader(bag) as reader:
    in_rosbag2 = sum(1 for _ in reader.messages())
print(json.dumps({"files": files, "rosbags": in_rosbag2}))
