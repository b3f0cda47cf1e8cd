"""Reads a bag of texts as others do: prints topic and text of the messages that `mcap` finds in each file, in the order of the
file, and of all that `rosbags` finds in the bag. Usage: read_files.py BAG"""

import json
import sys
from pathlib import Path

from mcap.reader import make_reader
from rosbags.highlevel import AnyReader

bag = Path(sys.argv[1])
files = {}
for path in bag.glob("*.mcap"):
    with path.open("rb") as stream:
        messages = make_reader(stream, validate_crcs=True).iter_messages(log_time_order=False)
        # CDR of a string: a header, the length, the text, and its end.
        files[path.name] = [[channel.topic, message.data[8:-1].decode()] for _, channel, message in messages]
with AnyReader([bag]) as reader:
    found = [[c.topic, reader.deserialize(raw, c.msgtype).data] for c, _, raw in reader.messages()]
print(json.dumps({"files": files, "bag": found}))
