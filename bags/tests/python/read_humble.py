"""Reads a bag with metadata of version 5 as ROS 2 Humble does: prints version and QoS policies by topic, and the number of
messages that `rosbags` finds. Usage: read_humble.py BAG"""

import json
import sys
from pathlib import Path

from mcap.reader import make_reader
from rosbags.rosbag2 import Reader
from ruamel.yaml import YAML

yaml = YAML(typ="safe")
policies = ["history", "depth", "reliability", "durability", "liveliness"]


def numbers(text: object) -> list:
    assert isinstance(text, str), text
    return [[profile[policy] for policy in policies] for profile in yaml.load(text or "[]")]


bag = Path(sys.argv[1])
information = yaml.load(bag / "metadata.yaml")["rosbag2_bagfile_information"]
entries = [entry["topic_metadata"] for entry in information["topics_with_message_count"]]
with (bag / information["relative_file_paths"][0]).open("rb") as stream:
    channels = make_reader(stream).get_summary().channels.values()
    in_file = {channel.topic: numbers(channel.metadata["offered_qos_profiles"]) for channel in channels}
with Reader(bag) as reader:
    count = sum(1 for _ in reader.messages())
print(
    json.dumps(
        {
            "version": information["version"],
            "qos": {entry["name"]: numbers(entry["offered_qos_profiles"]) for entry in entries},
            "in_file": in_file,
            "messages": count,
        }
    )
)
