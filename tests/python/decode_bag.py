"""Decodes every message of a bag with other readers, and prints the number of messages of each topic by reader.

Usage: decode_bag.py BAG_DIRECTORY. Any error raises.
"""

import json
import sys
from collections import Counter
from pathlib import Path

from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory
from rosbags.highlevel import AnyReader
from ruamel.yaml import YAML

bag = Path(sys.argv[1])

by_mcap, by_mcap_ros2 = Counter(), Counter()
for path in sorted(bag.glob("*.mcap")):
    with path.open("rb") as stream:
        for _, channel, _ in make_reader(stream, validate_crcs=True).iter_messages():
            by_mcap[channel.topic] += 1
    with path.open("rb") as stream:
        reader = make_reader(stream, decoder_factories=[DecoderFactory()])
        for _, channel, _, decoded in reader.iter_decoded_messages():
            assert decoded is not None
            by_mcap_ros2[channel.topic] += 1

by_rosbags = Counter()
with AnyReader([bag]) as reader:
    for connection, _, raw in reader.messages():
        assert reader.deserialize(raw, connection.msgtype) is not None
        by_rosbags[connection.topic] += 1

information = YAML(typ="safe").load(bag / "metadata.yaml")["rosbag2_bagfile_information"]
in_metadata = {t["topic_metadata"]["name"]: t["message_count"] for t in information["topics_with_message_count"]}
print(
    json.dumps(
        {
            "mcap": by_mcap,
            "mcap_ros2": by_mcap_ros2,
            "rosbags": by_rosbags,
            "metadata": {topic: count for topic, count in in_metadata.items() if count},
            "custom_data": information["custom_data"],
        }
    )
)
