"""The real ROS 2: rclpy over rmw_fastrtps_cpp."""

import importlib
import json
import random
import struct

from rclpy.serialization import deserialize_message, serialize_message
from rosidl_parser.definition import (
    AbstractString, AbstractWString, Array, BasicType, BoundedSequence, NamespacedType, UnboundedSequence)


def write(lines, count, seed):
    """Prints the default and `count` random values of each type: name, bytes, value."""
    for (name,) in lines:
        message_type = MessageType.named(name)
        for number in range(int(count) + 1):
            # Each value is reproducible independently of the others.
            chance = random.Random(f'{seed} {name} {number}')
            message = message_type.cls() if number == 0 else message_type.random(chance, 0)
            yield name, serialize_message(message).hex(), json.dumps(message_type.plain(message))


def read(lines):
    """Prints for each name and bytes the value and the written bytes."""
    for name, data in lines:
        message_type = MessageType.named(name)
        message = deserialize_message(bytes.fromhex(data), message_type.cls)
        yield json.dumps(message_type.plain(message)), serialize_message(message).hex()


class MessageType:
    """A message class with functions that create and format its values."""

    known = {}

    @classmethod
    def named(cls, name):
        if name not in cls.known:
            cls.known[name] = cls(message_class(name))
        return cls.known[name]

    def __init__(self, cls):
        self.cls = cls
        names = cls.get_fields_and_field_types()
        self.fields = [(name, plain_of(of), random_of(of)) for name, of in zip(names, cls.SLOT_TYPES)]

    def plain(self, message):
        return {name: plain(getattr(message, name)) for name, plain, _ in self.fields}

    def random(self, chance, depth):
        message = self.cls()
        for name, _, make in self.fields:
            setattr(message, name, make(chance, depth))
        return message


def message_class(name):
    package, kind, type_name = name.split('/')
    value = importlib.import_module(f'{package}.{kind}')
    for part in type_name.split('_'):
        if part in ('SendGoal', 'GetResult'):
            value = getattr(value.Impl, part + 'Service')
        elif part == 'FeedbackMessage':
            value = value.Impl.FeedbackMessage
        else:
            value = getattr(value, part)
    return value


def plain_of(of):
    """Returns a function that formats values of this type."""
    if isinstance(of, NamespacedType):
        return MessageType.named('/'.join(of.namespaced_name())).plain
    if isinstance(of, (Array, BoundedSequence, UnboundedSequence)):
        element = plain_of(of.value_type)
        return lambda values: [element(value) for value in values]
    if isinstance(of, BasicType) and of.typename == 'octet':
        return lambda value: value[0]
    if isinstance(of, BasicType) and of.typename in ('float', 'double'):
        bits = struct.Struct('>f' if of.typename == 'float' else '>d')
        return lambda value: bits.pack(value).hex()
    if isinstance(of, BasicType) and of.typename != 'boolean':
        return int
    return lambda value: value


def random_of(of):
    """Returns a function that creates values of this type from random numbers and the nesting depth."""
    if isinstance(of, NamespacedType):
        message_type = MessageType.named('/'.join(of.namespaced_name()))
        return lambda chance, depth: message_type.random(chance, depth + 1)
    if isinstance(of, Array):
        element = random_of(of.value_type)
        return lambda chance, depth: [element(chance, depth) for _ in range(of.size)]
    if isinstance(of, (BoundedSequence, UnboundedSequence)):
        element = random_of(of.value_type)
        bound = of.maximum_size if isinstance(of, BoundedSequence) else None
        lengths = MESSAGES if isinstance(of.value_type, NamespacedType) else PRIMITIVE_VALUES
        return lambda chance, depth: [element(chance, depth) for _ in range(count(chance, depth, bound, lengths))]
    if isinstance(of, (AbstractString, AbstractWString)):
        bound = of.maximum_size if of.has_maximum_size() else None
        return lambda chance, depth: text(chance, bound)
    return PRIMITIVES[of.typename]


# Lengths of sequences decrease with the depth, because nested messages quickly become large.
MESSAGES = [[0, 1, 2, 3], [0, 1, 2], [0, 0, 1]]
PRIMITIVE_VALUES = [[0, 1, 3, 17], [0, 1, 2, 3], [0, 1, 2]]


def count(chance, depth, bound, lengths):
    if bound is not None and depth < 2 and chance.random() < 0.3:
        return bound
    length = chance.choice(lengths[min(depth, 2)])
    return length if bound is None else min(length, bound)


def text(chance, bound):
    # No zero character: C strings end there.
    characters = 'aZ \t\n"\\\x7f\x80üß漢\uffff\U0001f600\U0010ffff'
    if bound is not None and chance.random() < 0.3:
        return 'x' * bound
    value = ''.join(chance.choices(characters, k=chance.choice([0, 0, 1, 3, 8, 25])))
    return value if bound is None or len(value.encode()) <= bound else ''


def integer(bits, is_signed):
    least = -(1 << (bits - 1)) if is_signed else 0
    greatest = least + (1 << bits) - 1

    def make(chance, _depth):
        return chance.choice([least, greatest, 0, chance.randint(least, greatest)])
    return make


def floating(bits, form, quiet):
    def make(chance, _depth):
        pattern = chance.choice(EDGES[bits] + [chance.getrandbits(bits)] * 12)
        value, = struct.unpack('>' + form, pattern.to_bytes(bits // 8, 'big'))
        if value != value:
            # Conversions between the two sizes make a signalling NaN quiet.
            value, = struct.unpack('>' + form, (pattern | quiet).to_bytes(bits // 8, 'big'))
        return value
    return make


# Zeros, infinities, NaNs, the least and the greatest numbers.
EDGES = {
    32: [0, 1 << 31, 0x7f800000, 0xff800000, 0x7fc00000, 0xffc12345, 1, 0x7f7fffff],
    64: [0, 1 << 63, 0x7ff << 52, 0xfff << 52, 0x7ff8 << 48, 0xfff8000000012345, 1, (0x7ff << 52) - 1],
}

PRIMITIVES = {
    'boolean': lambda chance, _depth: chance.random() < 0.5,
    'octet': lambda chance, _depth: bytes([chance.getrandbits(8)]),
    'float': floating(32, 'f', 1 << 22),
    'double': floating(64, 'd', 1 << 51),
    **{f'int{bits}': integer(bits, True) for bits in (8, 16, 32, 64)},
    **{f'uint{bits}': integer(bits, False) for bits in (8, 16, 32, 64)},
}
