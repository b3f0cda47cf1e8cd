"""rosbags: an independent reader and writer of messages in Python, with its own store of definitions."""

import json
import struct

import numpy
from rosbags.interfaces import Nodetype
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from rosbags.typesys.base import normalize_fieldname

FORMS = {'float32': struct.Struct('>f'), 'float64': struct.Struct('>d')}


def unsigned_byte(value):
    return value & 255


def convert(lines):
    """FILE has `define`, name, definition, and name, bytes. Prints for the latter the value and the written bytes,
    little-endian and big-endian."""
    types = {}
    values = []
    for *command, name, data in lines:
        name = known_as(name)
        if command:
            types.update(get_types_from_msg(bytes.fromhex(data).decode(), name))
        else:
            values.append((name, bytes.fromhex(data)))
    store = get_typestore(Stores.EMPTY)
    store.register(types)
    plain = {name: plain_of(store, name) for name in {name for name, _ in values}}
    for name, data in values:
        message = store.deserialize_cdr(data, name)
        written = (store.serialize_cdr(message, name, little_endian=little) for little in (True, False))
        yield json.dumps(plain[name](message)), *(data.hex() for data in written)


def hashes(lines):
    """Prints each name with the hash of its own definition, if it has the type."""
    store = get_typestore(Stores.ROS2_JAZZY)
    for name, (_, fields) in store.fielddefs.items():
        # rosbags hashes `char` as a character; in ROS 2 definitions it means uint8.
        fields[:] = [(field, without_char(of)) for field, of in fields]
    for (name,) in lines:
        if name in store.fielddefs:
            yield name, store.hash_rihs01(name)


def without_char(of):
    kind, detail = of
    if detail == ('char', 0):
        return kind, ('uint8', 0)
    return (kind, (without_char(detail[0]), detail[1])) if kind in (Nodetype.ARRAY, Nodetype.SEQUENCE) else of


def known_as(name):
    """rosbags supports messages only."""
    package, _, type_name = name.split('/')
    return f'{package}/msg/{type_name}'


def plain_of(store, name):
    """Returns a function that formats messages of this type."""
    # Messages without fields have one anyway.
    fields = [(field, normalize_fieldname(field), plain_value_of(store, of))
              for field, of in store.fielddefs[name][1] if field != 'structure_needs_at_least_one_member']
    return lambda message: {field: plain(getattr(message, attribute)) for field, attribute, plain in fields}


def plain_value_of(store, of):
    kind, detail = of
    if kind == Nodetype.NAME:
        return plain_of(store, detail)
    if kind == Nodetype.BASE:
        form = FORMS.get(detail[0])
        # Bytes are signed in rosbags.
        return (lambda value: form.pack(value).hex()) if form else unsigned_byte if detail[0] == 'byte' else lambda value: value
    element = plain_value_of(store, detail[0])

    def plain(values):
        if not isinstance(values, numpy.ndarray):
            return [element(value) for value in values]
        if values.dtype.kind != 'f':
            return [element(value) for value in values.tolist()]
        size = values.dtype.itemsize * 2
        bits = values.astype(values.dtype.newbyteorder('>')).tobytes().hex()
        return [bits[start:start + size] for start in range(0, len(bits), size)]
    return plain
