"""cyclonedds: the serialisation of Eclipse Cyclone DDS in Python, in both versions of CDR."""

import json
import struct

import cyclonedds.idl.types as idl
from cyclonedds.idl import make_idl_struct
from cyclonedds.idl._support import Endianness
from cyclonedds.idl.annotations import appendable, final
from rosbags.interfaces import Nodetype
from rosbags.typesys import get_types_from_msg

from bags import known_as

PRIMITIVES = {
    'bool': bool, 'byte': idl.byte, 'char': idl.uint8,
    'float32': idl.float32, 'float64': idl.float64,
    **{f'{sign}int{bits}': getattr(idl, f'{sign}int{bits}') for sign in ('', 'u') for bits in (8, 16, 32, 64)},
}
FORMS = {'float32': '>f', 'float64': '>d'}


def convert(lines):
    """FILE has `define`, name, definition, and name, bytes. Prints for the latter the value and the written bytes, in
    version 1 and in version 2, each little-endian and big-endian."""
    for types, name, support, message in messages(lines, final):
        written = (serialize(support, message, version_2, endianness)
                   for version_2 in (False, True) for endianness in (Endianness.Little, Endianness.Big))
        yield json.dumps(plain(types, name, message)), *written


def delimit(lines):
    """FILE as for `convert`. The bytes of the value in version 2, little-endian and big-endian, if its type and those within may
    have fields appended."""
    for _, _, support, message in messages(lines, appendable):
        yield tuple(serialize(support, message, True, endianness) for endianness in (Endianness.Little, Endianness.Big))


def messages(lines, extensibility):
    types = {}
    classes = {}
    for *command, name, data in lines:
        name = known_as(name)
        if command:
            types.update(get_types_from_msg(bytes.fromhex(data).decode(), name))
            continue
        support = class_of(classes, types, name, extensibility).__idl__
        yield types, name, support, support.deserialize(bytes.fromhex(data))


def serialize(support, message, version_2, endianness):
    return bytes(support.serialize(message, use_version_2=version_2, endianness=endianness)).hex()


def class_of(classes, types, name, extensibility):
    if name not in classes:
        fields = {field: annotation(classes, types, of, extensibility) for field, of in types[name][1]}
        # An empty structure has one byte, as in rosidl.
        fields = fields or {'structure_needs_at_least_one_member': idl.uint8}
        made = make_idl_struct(name.replace('/', '_'), name.replace('/', '.'), fields)
        classes[name] = extensibility(made)
    return classes[name]


def annotation(classes, types, of, extensibility):
    kind, detail = of
    if kind == Nodetype.NAME:
        return class_of(classes, types, detail, extensibility)
    if kind == Nodetype.BASE:
        name, bound = detail
        if name == 'string':
            # The bound includes the terminating zero.
            return idl.bounded_str[bound + 1] if bound else str
        return PRIMITIVES[name]
    element, count = detail
    element = annotation(classes, types, element, extensibility)
    if kind == Nodetype.ARRAY:
        return idl.array[element, count]
    return idl.sequence[element, count] if count else idl.sequence[element]


def plain(types, name, message):
    return {field: plain_value(types, of, getattr(message, field)) for field, of in types[name][1]}


def plain_value(types, of, value):
    kind, detail = of
    if kind == Nodetype.NAME:
        return plain(types, detail, value)
    if kind == Nodetype.BASE:
        form = FORMS.get(detail[0])
        return struct.pack(form, value).hex() if form else value
    return [plain_value(types, detail[0], item) for item in value]
