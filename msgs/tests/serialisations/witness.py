"""Reads messages in other serialisations with their reference libraries.

    witness.py COMMAND FILE

FILE has lines of tab-separated words: `schema NAME HEX`, followed by `value HEX JSON` for values of that schema. Each
value is compared with its JSON; NaN and the infinities are null there.
"""

import json
import math
import sys

from google.protobuf import descriptor_pb2, descriptor_pool, message_factory
from google.protobuf.descriptor import FieldDescriptor
import flatbuffers.number_types as number
from flatbuffers.table import Table


def lines(path):
    with open(path, encoding="utf-8") as file:
        for line in file.read().split("\n")[:-1]:
            yield line.split("\t")


def check(condition, *what):
    if not condition:
        raise AssertionError(what)


def same(found, expected, where):
    """Compares a scalar with its JSON."""
    if isinstance(found, float):
        if expected is None:
            check(not math.isfinite(found), where, found)
        else:
            check(found == expected and math.copysign(1, found) == math.copysign(1, expected), where, found, expected)
    else:
        check(found == expected, where, found, expected)


def single(value):
    """A 32-bit number as written in JSON: the shortest text that parses to it."""
    import struct

    if not math.isfinite(value):
        return value
    for digits in range(1, 18):
        text = float(f"{value:.{digits}g}")
        try:
            if struct.pack("<f", text) == struct.pack("<f", value):
                return text
        except OverflowError:
            pass
    return value


# Protobuf


def protobuf_class(name, data):
    files = descriptor_pb2.FileDescriptorSet.FromString(data)
    pool = descriptor_pool.DescriptorPool()
    for file in files.file:  # Imported files come first.
        pool.Add(file)
    return message_factory.GetMessageClass(pool.FindMessageTypeByName(name))


def same_message(message, expected, where):
    fields = message.DESCRIPTOR.fields
    check({field.name for field in fields} == set(expected), where, expected.keys())
    for field in fields:
        place = f"{where}.{field.name}"
        found, wanted = getattr(message, field.name), expected[field.name]
        if field.type == FieldDescriptor.TYPE_BYTES:
            check(list(found) == wanted, place, found, wanted)
            continue
        is_list = field.is_repeated
        found, wanted = (list(found), wanted) if is_list else ([found], [wanted])
        check(len(found) == len(wanted), place, found, wanted)
        for one, other in zip(found, wanted):
            if field.type == FieldDescriptor.TYPE_MESSAGE:
                check(is_list or message.HasField(field.name), place)
                same_message(one, other, place)
            elif field.type == FieldDescriptor.TYPE_FLOAT:
                same(single(one), other, place)
            else:
                same(one, other, place)


def protobuf(path):
    cls = None
    for kind, *rest in lines(path):
        if kind == "schema":
            cls = protobuf_class(rest[0], bytes.fromhex(rest[1]))
        else:
            message = cls.FromString(bytes.fromhex(rest[0]))
            same_message(message, json.loads(rest[1]), cls.DESCRIPTOR.full_name)
            print(message.SerializeToString().hex())


def proto_text(path):
    """Compiles all `file` lines together, and compares the results with the files of the `schema` lines."""
    import tempfile
    from pathlib import Path

    from grpc_tools import protoc

    ours, names = {}, []
    with tempfile.TemporaryDirectory() as folder:
        for kind, name, content in lines(path):
            if kind == "schema":
                files = descriptor_pb2.FileDescriptorSet.FromString(bytes.fromhex(content)).file
                ours.update((file.name, file) for file in files)
            else:
                file = Path(folder, name)
                file.parent.mkdir(parents=True, exist_ok=True)
                file.write_bytes(bytes.fromhex(content))
                names.append(name)
        out = Path(folder, "out.pb")
        check(protoc.main(["protoc", f"-I{folder}", f"--descriptor_set_out={out}", *names]) == 0)
        theirs = descriptor_pb2.FileDescriptorSet.FromString(out.read_bytes())
    for file in theirs.file:
        for message in file.message_type:
            for field in message.field:
                field.ClearField("json_name")  # The default.
        check(file == ours[file.name], file, ours[file.name])
    check({file.name for file in theirs.file} == set(ours) == set(names), set(ours) ^ set(names))
    print(len(theirs.file))


# FlatBuffers: binary schemas read by the ids of reflection.fbs, then messages by these schemas.

# By reflection.BaseType.
NUMBERS = {
    2: number.BoolFlags,
    3: number.Int8Flags,
    4: number.Uint8Flags,
    5: number.Int16Flags,
    6: number.Uint16Flags,
    7: number.Int32Flags,
    8: number.Uint32Flags,
    9: number.Int64Flags,
    10: number.Uint64Flags,
    11: number.Float32Flags,
    12: number.Float64Flags,
}
STRING, VECTOR, OBJECT = 13, 14, 15


class Node:
    """A table, its fields by id."""

    def __init__(self, data, position):
        self.table = Table(data, position)

    @classmethod
    def root(cls, data):
        return cls(data, Table(data, 0).Get(number.UOffsetTFlags, 0))

    def offset(self, field_id):
        return self.table.Offset(4 + 2 * field_id)

    def scalar(self, field_id, flags, default=0):
        return self.table.GetSlot(4 + 2 * field_id, default, flags)

    def text(self, field_id):
        offset = self.offset(field_id)
        return self.table.String(offset + self.table.Pos).decode() if offset else None

    def inner(self, field_id):
        offset = self.offset(field_id)
        return Node(self.table.Bytes, self.table.Indirect(offset + self.table.Pos)) if offset else None

    def inners(self, field_id):
        offset = self.offset(field_id)
        check(offset, "a vector is missing", field_id)
        start = self.table.Vector(offset)
        return [
            Node(self.table.Bytes, self.table.Indirect(start + 4 * index))
            for index in range(self.table.VectorLen(offset))
        ]


def read_type(node):
    return {
        "base_type": node.scalar(0, number.Int8Flags),
        "element": node.scalar(1, number.Int8Flags),
        "index": node.scalar(2, number.Int32Flags, -1),
        "base_size": node.scalar(4, number.Uint32Flags, 4),
        "element_size": node.scalar(5, number.Uint32Flags, 0),
    }


def read_object(node):
    return {
        "name": node.text(0),
        "is_struct": node.scalar(2, number.BoolFlags, False),
        "minalign": node.scalar(3, number.Int32Flags),
        "bytesize": node.scalar(4, number.Int32Flags),
        "fields": [
            {
                "name": field.text(0),
                "type": read_type(field.inner(1)),
                "id": field.scalar(2, number.Uint16Flags),
                "offset": field.scalar(3, number.Uint16Flags),
                "default_integer": field.scalar(4, number.Int64Flags),
                "default_real": field.scalar(5, number.Float64Flags, 0.0),
                "optional": field.scalar(11, number.BoolFlags, False),
            }
            for field in node.inners(1)
        ],
    }


def read_schema(data):
    check(data[4:8] == b"BFBS", data[:8])
    node = Node.root(data)
    return {
        "objects": [read_object(inner) for inner in node.inners(0)],
        "enums": [
            {
                "name": inner.text(0),
                "values": [(value.text(0), value.scalar(1, number.Int64Flags)) for value in inner.inners(1)],
                "underlying_type": read_type(inner.inner(3)),
            }
            for inner in node.inners(1)
        ],
        "root": node.inner(4).text(0),
    }


def same_table(schema, of, node, expected, where):
    check({field["name"] for field in of["fields"]} == set(expected), where, expected.keys())
    for field in of["fields"]:
        place, wanted, kind = f"{where}.{field['name']}", expected[field["name"]], field["type"]
        table, offset = node.table, node.offset(field["id"])
        flags = NUMBERS.get(kind["base_type"])
        if flags:
            found = table.GetSlot(field["offset"], flags.py_type(field["default_real"]), flags)
            same(single(found) if flags is number.Float32Flags else found, wanted, place)
        elif kind["base_type"] == STRING:
            check((node.text(field["id"]) or "") == wanted, place, wanted)
        elif kind["base_type"] == OBJECT:
            same_table(schema, schema["objects"][kind["index"]], node.inner(field["id"]), wanted, place)
        else:
            check(kind["base_type"] == VECTOR, place, kind)
            check((table.VectorLen(offset) if offset else 0) == len(wanted), place, wanted)
            start = table.Vector(offset) if offset else 0
            element = NUMBERS.get(kind["element"])
            for index, other in enumerate(wanted):
                at = start + kind["element_size"] * index
                if element:
                    check(at % element.bytewidth == 0, place, "is not aligned")
                    found = table.Get(element, at)
                    same(single(found) if element is number.Float32Flags else found, other, place)
                elif kind["element"] == STRING:
                    check(table.String(at).decode() == other, place, other)
                else:
                    inner = Node(table.Bytes, table.Indirect(at))
                    same_table(schema, schema["objects"][kind["index"]], inner, other, place)


def flatbuffers(path):
    schema, count = None, 0
    for kind, *rest in lines(path):
        if kind == "schema":
            schema = read_schema(bytes.fromhex(rest[1]))
            check(schema["root"] == rest[0], rest[0])
            names = [of["name"] for of in schema["objects"]]
            check(names == sorted(names), names)
            root = schema["objects"][names.index(rest[0])]
        else:
            same_table(schema, root, Node.root(bytes.fromhex(rest[0])), json.loads(rest[1]), root["name"])
            count += 1
    print(count)


def json_schema(path):
    import fastjsonschema

    validate, count = None, 0
    for kind, *rest in lines(path):
        if kind == "schema":
            validate = fastjsonschema.compile(json.loads(bytes.fromhex(rest[1])))
        else:
            value = json.loads(bytes.fromhex(rest[0]))
            check(value == json.loads(rest[1]), rest)
            validate(value)
            count += 1
    print(count)


# Foxglove's own schemas: `schema NAME HEX` is compared with the published one, of values the fields are printed as JSON.


def plain(value):
    from google.protobuf.message import Message

    if isinstance(value, Message):
        fields = {}
        for field in value.DESCRIPTOR.fields:
            if field.has_presence and not value.HasField(field.name):
                continue
            fields[field.name] = plain(getattr(value, field.name))
        return fields
    if isinstance(value, bytes):
        return list(value)
    if isinstance(value, (str, int, float)):
        return value
    return [plain(element) for element in value]


def foxglove_class(name):
    import importlib

    short = name.removeprefix("foxglove.")
    return getattr(importlib.import_module(f"foxglove_schemas_protobuf.{short}_pb2"), short)


def described(descriptor, seen):
    """The fields of a message and of nested messages."""
    if descriptor.full_name in seen:
        return
    seen[descriptor.full_name] = fields = {}
    for field in descriptor.fields:
        names = [of.full_name for of in (field.message_type, field.enum_type) if of]
        values = [(value.name, value.number) for value in field.enum_type.values] if field.enum_type else []
        fields[field.name] = (field.number, field.type, field.is_repeated, field.has_presence, names, values)
        if field.message_type:
            described(field.message_type, seen)


def foxglove_protobuf(path):
    cls = None
    for kind, *rest in lines(path):
        if kind == "schema":
            cls = foxglove_class(rest[0])
            ours, theirs = {}, {}
            described(protobuf_class(rest[0], bytes.fromhex(rest[1])).DESCRIPTOR, ours)
            described(cls.DESCRIPTOR, theirs)
            check(ours == theirs, ours, theirs)
        else:
            message = cls.FromString(bytes.fromhex(rest[0]))
            print(json.dumps([plain(message), message.SerializeToString().hex()]))


def foxglove_flatbuffers(path):
    import foxglove_schemas_flatbuffer
    import importlib.resources

    root = schema = None
    for kind, *rest in lines(path):
        if kind == "schema":
            short = rest[0].removeprefix("foxglove.")
            published = importlib.resources.files(foxglove_schemas_flatbuffer) / f"{short}.bfbs"
            ours, theirs = read_schema(bytes.fromhex(rest[1])), read_schema(published.read_bytes())
            for part in ("objects", "enums", "root"):
                check(ours[part] == theirs[part], rest[0], part, ours[part], theirs[part])
            schema = theirs
            root = next(of for of in schema["objects"] if of["name"] == rest[0])
        else:
            print(json.dumps(plain_table(schema, root, Node.root(bytes.fromhex(rest[0])))))


def plain_table(schema, of, node):
    fields = {}
    for field in of["fields"]:
        kind, table, offset = field["type"], node.table, node.offset(field["id"])
        flags = NUMBERS.get(kind["base_type"])
        if flags:
            if offset or not field["optional"]:
                fields[field["name"]] = table.GetSlot(field["offset"], flags.py_type(field["default_real"]), flags)
        elif kind["base_type"] == STRING:
            fields[field["name"]] = node.text(field["id"]) or ""
        elif kind["base_type"] == OBJECT:
            inner = schema["objects"][kind["index"]]
            if offset and inner["is_struct"]:
                at = table.Pos + offset
                flags = NUMBERS[inner["fields"][1]["type"]["base_type"]]
                fields[field["name"]] = {"seconds": table.Get(flags, at), "nanos": table.Get(flags, at + 4)}
            elif offset:
                fields[field["name"]] = plain_table(schema, inner, node.inner(field["id"]))
        else:
            start, length = (table.Vector(offset), table.VectorLen(offset)) if offset else (0, 0)
            places = [start + kind["element_size"] * index for index in range(length)]
            element = NUMBERS.get(kind["element"])
            if element:
                fields[field["name"]] = [table.Get(element, at) for at in places]
            else:
                inner = schema["objects"][kind["index"]]
                fields[field["name"]] = [plain_table(schema, inner, Node(table.Bytes, table.Indirect(at))) for at in places]
    return fields


if __name__ == "__main__":
    globals()[sys.argv[1]](sys.argv[2])
