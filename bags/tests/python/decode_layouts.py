"""Decodes every message of the bags in a folder with other readers, and prints for each bag and reader the number of
messages and a hash of their texts. Usage: decode_layouts.py FOLDER"""

import hashlib
import json
import sys
from pathlib import Path

from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory
from rosbags.highlevel import AnyReader


def texts_of(bag):
    """The messages read by `mcap-ros2-support`, ordered by time."""
    texts = []
    with (bag / f"{bag.name}_0.mcap").open("rb") as stream:
        reader = make_reader(stream, validate_crcs=True, decoder_factories=[DecoderFactory()])
        for _, _, message, decoded in reader.iter_decoded_messages():
            texts.append((message.log_time, decoded.data))
    return sorted(texts)


def count_in_rosbags(bag):
    try:
        with AnyReader([bag]) as reader:
            return sum(1 for c, _, raw in reader.messages() if reader.deserialize(raw, c.msgtype) is not None)
    except Exception as error:  # reported to the test, which knows what rosbags cannot read
        print(f"{bag.name}: {error}", file=sys.stderr)
        return None


found = {}
for bag in sorted(Path(sys.argv[1]).iterdir()):
    with (bag / f"{bag.name}_0.mcap").open("rb") as stream:
        in_mcap = sum(1 for _ in make_reader(stream, validate_crcs=True).iter_messages())
    texts = texts_of(bag)
    found[bag.name] = {
        "mcap": in_mcap,
        "mcap_ros2": len(texts),
        "rosbags": count_in_rosbags(bag),
        "hash": hashlib.sha256(repr(texts).encode()).hexdigest(),
    }
print(json.dumps(found))
