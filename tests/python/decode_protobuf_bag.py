"""Decodes every message of a bag in Protobuf with other readers, using only the schemas in the bag.

Usage: decode_protobuf_bag.py BAG_DIRECTORY. Prints the schema and the count of each topic, and the joints of the last
message of /joint_states.
"""

import json
import sys
from collections import Counter
from pathlib import Path

from google.protobuf.json_format import MessageToDict
from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory

schemas, counts, last = {}, Counter(), None
for path in sorted(Path(sys.argv[1]).glob("*.mcap")):
    with path.open("rb") as stream:
        reader = make_reader(stream, validate_crcs=True, decoder_factories=[DecoderFactory()])
        for schema, channel, _, message in reader.iter_decoded_messages():
            assert schema.name == message.DESCRIPTOR.full_name
            schemas[channel.topic] = schema.name
            counts[channel.topic] += 1
            if channel.topic == "/joint_states":
                last = message

joints = [MessageToDict(joint) for joint in last.joints] if last else []
print(json.dumps({"schemas": schemas, "counts": counts, "last_joints": joints}))
