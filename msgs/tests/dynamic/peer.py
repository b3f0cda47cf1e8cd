"""The other end of the tests of dynamic messages: rclpy and rosbags read messages that were changed by path.

    peer.py read FILE    FILE has lines of type name, bytes (hexadecimal); prints what rclpy reads, as YAML in JSON
    peer.py big FILE     FILE has type name, definition, bytes (both hexadecimal); prints big-endian bytes of rosbags

Parts of a line are separated by tabs.
"""

import importlib
import json
import sys


def lines(path):
    with open(path, encoding='utf-8') as file:
        return [line.rstrip('\n').split('\t') for line in file]


def plain(value):
    if hasattr(value, 'get_fields_and_field_types'):
        return {field: plain(getattr(value, field)) for field in value.get_fields_and_field_types()}
    if isinstance(value, bytes):
        return value[0]
    if hasattr(value, 'tolist'):
        return value.tolist()
    if isinstance(value, (list, tuple)):
        return [plain(item) for item in value]
    return value


def read(path):
    from rclpy.serialization import deserialize_message
    for name, data in lines(path):
        package, kind, type_name = name.split('/')
        cls = importlib.import_module(f'{package}.{kind}')
        for part in type_name.split('_'):
            cls = getattr(cls, part)
        print(json.dumps(plain(deserialize_message(bytes.fromhex(data), cls))))


def big(path):
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore
    for name, definition, data in lines(path):
        store = get_typestore(Stores.EMPTY)
        store.register(get_types_from_msg(bytes.fromhex(definition).decode(), name))
        message = store.deserialize_cdr(bytes.fromhex(data), name)
        print(bytes(store.serialize_cdr(message, name, little_endian=False)).hex())


if __name__ == '__main__':
    {'read': read, 'big': big}[sys.argv[1]](sys.argv[2])
