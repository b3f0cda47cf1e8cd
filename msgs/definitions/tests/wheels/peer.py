"""Runs the tools of ROS 2 and rosbags on our definitions.

    peer.py describe FILE  each line of FILE is the folder of a package; prints name and individual type description (JSON)
                           of every type there, as rosidl_adapter, rosidl_parser and rosidl_generator_type_description
                           make it of the files
    peer.py parse FILE     each line of FILE is a JSON string, the text of a .msg file; prints what rosidl_adapter reads, or
                           `null` where it refuses
    peer.py store FILE     prints name, hash and constants (JSON) of every message rosbags knows of Jazzy; FILE is not read

    peer.py hash FILE      each line of FILE is a JSON list: name, encoding and definition text of a type; prints the hash that
                           rosbags computes from the text, or why it cannot

Parts of a line are separated by tabs.
"""

import contextlib
import io
import json
import pathlib
import struct
import sys
import tempfile

from rosidl_adapter import parser
from rosidl_adapter.action import convert_action_to_idl
from rosidl_adapter.msg import convert_msg_to_idl
from rosidl_adapter.srv import convert_srv_to_idl
from rosidl_generator_type_description import add_action, add_msg, add_srv, serialize_individual_type_description
from rosidl_parser import definition
from rosidl_parser.parser import parse_idl_string

CONVERTERS = {'msg': convert_msg_to_idl, 'srv': convert_srv_to_idl, 'action': convert_action_to_idl}


def describe(path):
    types = {}
    for package in (pathlib.Path(line.rstrip('\n')).resolve() for line in open(path)):
        for kind, convert in CONVERTERS.items():
            for file in sorted(package.glob(f'{kind}/*.{kind}')):
                with tempfile.TemporaryDirectory() as output, contextlib.redirect_stdout(io.StringIO()):
                    idl = convert(package, package.name, file.relative_to(package), pathlib.Path(output))
                    text = idl.read_text(encoding='utf-8')
                for element in parse_idl_string(text).elements:
                    if isinstance(element, definition.Message):
                        add_msg(element, types)
                    elif isinstance(element, definition.Service):
                        add_srv(element, types)
                    elif isinstance(element, definition.Action):
                        add_action(element, types)
    for name, of in types.items():
        print(name, json.dumps(serialize_individual_type_description(of.namespaced_type, of.members)), sep='\t')


def value(of):
    """Converts a value for JSON; floating-point numbers by their bits."""
    if isinstance(of, float):
        return {'bits': struct.pack('>d', of).hex()}
    return [value(item) for item in of] if isinstance(of, list) else of


def parse(path):
    for line in open(path, encoding='utf-8'):
        try:
            with contextlib.redirect_stderr(io.StringIO()):
                message = parser.parse_message_string('pkg', 'Name', json.loads(line))
        except Exception:  # of any kind, including IndexError and AssertionError
            print('null')
            continue
        fields = [[str(of.type), of.name, value(of.default_value)] for of in message.fields]
        constants = [[of.type, of.name, value(of.value)] for of in message.constants]
        print(json.dumps({'fields': fields, 'constants': constants}))


def store(_path):
    from rosbags.typesys import Stores, get_typestore

    types = get_typestore(Stores.ROS2_JAZZY)
    for name, (constants, _fields) in types.fielddefs.items():
        described = [[field_type, constant, value(of)] for constant, field_type, of in constants]
        print(name, types.hash_rihs01(name), json.dumps(described), sep='\t')


def hash_texts(path):
    from rosbags.typesys import Stores, get_types_from_idl, get_types_from_msg, get_typestore

    rule = '=' * 80 + '\n'
    for line in open(path, encoding='utf-8'):
        name, encoding, text = json.loads(line)
        try:
            types = get_typestore(Stores.EMPTY)
            if encoding == 'ros2msg':
                types.register(get_types_from_msg(text, name))
            else:
                assert text.startswith(rule), 'the text has no header'
                for block in text.split(rule)[1:]:
                    header, idl = block.split('\n', 1)
                    assert header.startswith('IDL: '), header
                    types.register(get_types_from_idl(idl))
            print(types.hash_rihs01(name))
        except Exception as error:  # the test knows what it cannot read
            print(repr(error).replace('\n', ' '))


{'describe': describe, 'parse': parse, 'store': store, 'hash': hash_texts}[sys.argv[1]](sys.argv[2])
