"""The other end of the interop tests: rclpy and rosbags write and read messages.

    peer.py write FILE COUNT   FILE has type names; prints name, bytes, value (JSON): the default, then COUNT random ones
    peer.py read FILE          FILE has name, bytes; prints the bytes of the message read
    peer.py big_endian FILE    FILE has `define`, name, definition, then name, bytes; prints little- and big-endian bytes

Parts of a line are separated by tabs, bytes and definitions are in hexadecimal.
"""

import importlib
import json
import random
import re
import sys

SEQUENCE = re.compile(r'sequence<(.+?)(?:, (\d+))?>')
ARRAY = re.compile(r'(.+)\[(\d+)\]')
STRING = re.compile(r'w?string(?:<(\d+)>)?')
INTEGER = re.compile(r'(u?)int(8|16|32|64)')
CHARACTERS = 'aZ \n"ü漢\U0001f600'


# Where rclpy has what rosidl derives from an action.
PARTS = {
    'SendGoal': ['Impl', 'SendGoalService'],
    'GetResult': ['Impl', 'GetResultService'],
    'FeedbackMessage': ['Impl', 'FeedbackMessage'],
}


def message_class(name):
    package, kind, type_name = name.split('/')
    value = importlib.import_module(f'{package}.{kind}')
    for part in type_name.split('_'):
        for attribute in PARTS.get(part, [part]):
            value = getattr(value, attribute)
    return value


def kind_of(type_name):
    if re.search('_(Goal|Result|Feedback|FeedbackMessage|SendGoal|GetResult)(_|$)', type_name):
        return 'action'
    return 'srv' if type_name.endswith(('_Request', '_Response', '_Event')) else 'msg'


def random_value(field_type):
    if match := SEQUENCE.fullmatch(field_type):
        count = random.randint(0, min(3, int(match[2] or 3)))
        return [random_value(match[1]) for _ in range(count)]
    if match := ARRAY.fullmatch(field_type):
        return [random_value(match[1]) for _ in range(int(match[2]))]
    if match := STRING.fullmatch(field_type):
        text = ''.join(random.choices(CHARACTERS, k=random.randint(0, 8)))
        return text if len(text.encode()) <= int(match[1] or 99) else text[:1]
    if match := INTEGER.fullmatch(field_type):
        bits = int(match[2])
        value = random.getrandbits(bits)
        return value if match[1] else value - (1 << (bits - 1))
    if field_type == 'boolean':
        return random.random() < 0.5
    if field_type == 'octet':
        return bytes([random.getrandbits(8)])
    if field_type == 'double':
        # Of few digits, so that every JSON reader gets them exactly.
        return random.choice([0.0, -0.0, 1e20, random.randint(-2**28, 2**28) / 64])
    if field_type == 'float':
        return random.choice([0.0, -0.0, 2.0**100, random.randint(-2**23, 2**23) / 64])
    package, name = field_type.split('/')
    return random_message(message_class(f'{package}/{kind_of(name)}/{name}'))


def random_message(cls):
    message = cls()
    for field, field_type in cls.get_fields_and_field_types().items():
        setattr(message, field, random_value(field_type))
    return message


def plain(value):
    """The value as JSON has it."""
    if hasattr(value, 'get_fields_and_field_types'):
        return {field: plain(getattr(value, field)) for field in value.get_fields_and_field_types()}
    if isinstance(value, bytes):
        return value[0]
    if isinstance(value, (bool, int, float, str)):
        return value
    if hasattr(value, 'tolist'):
        return value.tolist()
    return [plain(item) for item in value]


def lines(path):
    with open(path, encoding='utf-8', newline='\n') as file:
        return [line.rstrip('\n').split('\t') for line in file]


def write(path, count):
    from rclpy.serialization import serialize_message
    random.seed(2026)
    for (name,) in lines(path):
        cls = message_class(name)
        for message in [cls()] + [random_message(cls) for _ in range(int(count))]:
            print(name, serialize_message(message).hex(), json.dumps(plain(message)), sep='\t')


def read(path):
    from rclpy.serialization import deserialize_message, serialize_message
    for name, data in lines(path):
        print(serialize_message(deserialize_message(bytes.fromhex(data), message_class(name))).hex())


def big_endian(path):
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore
    store = get_typestore(Stores.EMPTY)
    types = {}
    values = []
    for *command, name, data in lines(path):
        name = name.replace('/srv/', '/msg/')  # A text defines messages only.
        if command:
            types.update(get_types_from_msg(bytes.fromhex(data).decode(), name))
        else:
            values.append((name, data))
    store.register(types)
    for name, data in values:
        message = store.deserialize_cdr(bytes.fromhex(data), name)
        little, big = (store.serialize_cdr(message, name, little_endian=little) for little in (True, False))
        print(little.hex(), big.hex(), sep='\t')


if __name__ == '__main__':
    {'write': write, 'read': read, 'big_endian': big_endian}[sys.argv[1]](*sys.argv[2:])
