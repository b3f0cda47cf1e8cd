"""Opens bags with `rosbags`, which compares the type hashes, and with `mcap-ros2-support`; decodes every message with both.
Prints for each reader, by bag, the number of decoded messages of each topic, or why the bag cannot be opened.

Usage: open_bags.py FOLDER, whose folders and files are the bags. `mcap-ros2-support` reads no names of parts of services and actions: their topics
are left out there.
"""

import json
import sys
from collections import Counter
from pathlib import Path

from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory
from rosbags.highlevel import AnyReader


def with_rosbags(bag: Path) -> dict:
    counts = Counter()
    with AnyReader([bag]) as reader:
        for connection, _, raw in reader.messages():
            reader.deserialize(raw, connection.msgtype)
            counts[connection.topic] += 1
    return counts


def with_mcap_ros2(bag: Path) -> dict:
    counts = Counter()
    for path in [bag] if bag.is_file() else sorted(bag.glob("*.mcap")):
        with path.open("rb") as stream:
            decoders = DecoderFactory()
            for schema, channel, message in make_reader(stream, validate_crcs=True).iter_messages():
                if "/msg/" in schema.name:
                    decoders.decoder_for(channel.message_encoding, schema)(message.data)
                    counts[channel.topic] += 1
    return counts


found = {"rosbags": {}, "mcap_ros2": {}}
for bag in sorted(Path(sys.argv[1]).iterdir()):
    for name, read in (("rosbags", with_rosbags), ("mcap_ros2", with_mcap_ros2)):
        try:
            found[name][bag.name] = read(bag)
        except Exception as error:  # reported to the test, which names the bag
            found[name][bag.name] = repr(error)
print(json.dumps(found))
