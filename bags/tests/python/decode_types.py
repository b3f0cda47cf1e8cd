"""Decodes every message of a bag with other readers, and prints for each reader and topic the values, or why it
cannot read the topic. Usage: decode_types.py FOLDER, which has the bags `messages` and `events` and values.json.

Floating-point numbers are texts of their bits in hexadecimal.
"""

import json
import struct
import sys
from pathlib import Path

# Formats values as in the tests of messages.
sys.path.insert(0, str(Path(__file__).parents[3] / "msgs/tests/interop/python"))

from bags import plain_of  # noqa: E402
from mcap.reader import make_reader  # noqa: E402
from mcap_ros2.decoder import DecoderFactory  # noqa: E402
from rclpy.serialization import deserialize_message  # noqa: E402
from ros import MessageType  # noqa: E402
from rosbags.rosbag2 import Reader  # noqa: E402
from rosbags.typesys import Stores, get_typestore  # noqa: E402
from schemas import types_of  # noqa: E402


def with_mcap_ros2(bag: Path, values: dict) -> dict:
    found = {}
    with (bag / f"{bag.name}_0.mcap").open("rb") as stream:
        decoders = DecoderFactory()
        for schema, channel, message in make_reader(stream, validate_crcs=True).iter_messages():
            read = found.setdefault(channel.topic, [])
            if isinstance(read, str):
                continue
            try:
                decoded = decoders.decoder_for(channel.message_encoding, schema)(message.data)
                read.append(like(values[channel.topic][len(read)], decoded))
            except Exception as error:  # reported to the test, which knows what it cannot read
                found[channel.topic] = repr(error)
    return found


def like(value, decoded):
    """Formats a decoded value like the given one, because it does not contain the size of numbers."""
    if isinstance(value, dict):
        assert set(decoded.__slots__) == set(value), (decoded.__slots__, list(value))
        return {name: like(of, getattr(decoded, name)) for name, of in value.items()}
    if isinstance(value, list):
        decoded = list(decoded)
        return [like(*pair) for pair in zip(value, decoded)] if len(value) == len(decoded) else decoded
    if isinstance(decoded, float):
        return struct.pack(">f" if len(value) == 8 else ">d", decoded).hex()
    # The library reads `char` as a signed number. In ROS 2 it is uint8.
    if isinstance(decoded, int) and decoded < 0 and value == decoded + 256:
        return value
    return decoded


def with_rosbags(bag: Path) -> dict:
    """Decodes with only the definitions in the bag."""
    found = {}
    with Reader(bag) as reader:
        types = {}
        for connection in reader.connections:
            try:
                store = get_typestore(Stores.EMPTY)
                store.register(types_of(connection))
                types[connection.topic] = store, plain_of(store, connection.msgtype)
                found[connection.topic] = []
            except Exception as error:  # reported to the test, which knows what it cannot read
                found[connection.topic] = repr(error)
        for connection, _, raw in reader.messages():
            if isinstance(found[connection.topic], str):
                continue
            store, plain = types[connection.topic]
            try:
                found[connection.topic].append(plain(store.deserialize_cdr(raw, connection.msgtype)))
            except Exception as error:
                found[connection.topic] = repr(error)
    return found


def with_rclpy(bag: Path, packages: set) -> dict:
    found = {}
    with (bag / f"{bag.name}_0.mcap").open("rb") as stream:
        for schema, channel, message in make_reader(stream).iter_messages():
            if schema.name.split("/")[0] in packages:
                of = MessageType.named(schema.name)
                value = of.plain(deserialize_message(message.data, of.cls))
                found.setdefault(channel.topic, []).append(value)
    return found


def main() -> None:
    folder = Path(sys.argv[1])
    bags = folder / "messages", folder / "events"
    values = json.loads((folder / "values.json").read_text())
    packages = {path.parent.name for path in (Path(sys.prefix) / "share").glob("*/package.xml")}
    found = {
        "mcap_ros2": with_mcap_ros2(bags[0], values) | with_mcap_ros2(bags[1], values),
        "rosbags": with_rosbags(bags[0]) | with_rosbags(bags[1]),
        "rclpy": with_rclpy(bags[0], packages) | with_rclpy(bags[1], packages),
        "packages": sorted(packages),
    }
    print(json.dumps(found))


main()
