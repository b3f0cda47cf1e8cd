"""Prints the contents of metadata.yaml of a bag with a truncated file, and how many messages `mcap` streams from that
file before it reports an error. Usage: count_metadata.py BAG"""

import json
import sys
from pathlib import Path

from mcap.exceptions import McapError
from mcap.records import Message
from mcap.stream_reader import StreamReader
from ruamel.yaml import YAML

bag = Path(sys.argv[1])
information = YAML(typ="safe").load(bag / "metadata.yaml")["rosbag2_bagfile_information"]
topics = {t["topic_metadata"]["name"]: t["message_count"] for t in information["topics_with_message_count"]}
count = 0
with (bag / f"{bag.name}_0.mcap").open("rb") as stream:
    try:
        for record in StreamReader(stream).records:
            count += isinstance(record, Message)
    except McapError:
        pass  # the missing end, as expected
print(json.dumps({"message_count": information["message_count"], "topics": topics, "mcap": count}))
