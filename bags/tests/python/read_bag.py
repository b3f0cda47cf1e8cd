"""Reads a bag with other readers and prints, per reader, the number of decoded messages of each topic.

Usage: read_bag.py BAG_DIRECTORY. Every message is decoded; anything that is not as it should be raises.
"""

import json
import sys
from collections import Counter
from pathlib import Path

from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory
from rosbags.highlevel import AnyReader
from rosbags.rosbag2 import Reader
from rosbags.typesys import Stores, get_typestore
from ruamel.yaml import YAML


def mcap_counts(bag: Path) -> dict:
    counts, sample = Counter(), {}
    for path in sorted(bag.glob("*.mcap")):
        with path.open("rb") as stream:
            reader = make_reader(stream, validate_crcs=True, decoder_factories=[DecoderFactory()])
            assert reader.get_header().profile == "ros2"
            names = [record.name for record in reader.iter_metadata()]
            assert names == ["rosbag2", "rosbag2"], names
            times = []
            for schema, channel, message, decoded in reader.iter_decoded_messages():
                assert schema.encoding == "ros2msg" and channel.message_encoding == "cdr"
                assert message.sequence == 0
                counts[channel.topic] += 1
                times.append(message.log_time)
                sample[channel.topic] = decoded
            assert times == sorted(times)
            statistics = reader.get_summary().statistics
            assert statistics.message_count == sum(counts.values())
    return {"counts": counts, "text": sample["/chatter"].data, "position": list(sample["/joint_states"].position)}


def any_reader_counts(bag: Path) -> dict:
    counts, sample = Counter(), {}
    with AnyReader([bag]) as reader:
        for connection, _, raw in reader.messages():
            sample[connection.topic] = reader.deserialize(raw, connection.msgtype)
            counts[connection.topic] += 1
        assert reader.message_count == sum(counts.values())
        topics = {name: topic.msgtype for name, topic in reader.topics.items()}
    return {
        "counts": counts,
        "text": sample["/chatter"].data,
        "position": sample["/joint_states"].position.tolist(),
        "types": topics,
    }


def rosbag2_counts(bag: Path) -> dict:
    """Decodes with the Jazzy types of rosbags, which compares our definitions and hashes with independent ones."""
    store = get_typestore(Stores.ROS2_JAZZY)
    counts = Counter()
    with Reader(bag) as reader:
        for connection in reader.connections:
            if connection.msgtype in store.types:
                assert connection.digest == store.hash_rihs01(connection.msgtype), connection.msgtype
        for connection, _, raw in reader.messages():
            if connection.msgtype in store.types:
                store.deserialize_cdr(raw, connection.msgtype)
            counts[connection.topic] += 1
        qos = {c.topic: [str(q.durability) for q in c.ext.offered_qos_profiles] for c in reader.connections}
        distro = reader.ros_distro
    yaml = YAML(typ="safe").load(bag / "metadata.yaml")
    custom_data = yaml["rosbag2_bagfile_information"]["custom_data"]
    return {"counts": counts, "qos": qos, "custom_data": custom_data, "distro": distro}


def main() -> None:
    bag = Path(sys.argv[1])
    print(json.dumps({"mcap": mcap_counts(bag), "any": any_reader_counts(bag), "rosbag2": rosbag2_counts(bag)}))


main()
