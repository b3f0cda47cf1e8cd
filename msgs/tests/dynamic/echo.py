"""Makes msgs/tests/data/echo.jsonl: what ROS 2 prints for messages, and how it parses user input.

    python echo.py > echo.jsonl

needs rclpy, PyYAML, and rosidl_runtime_py (github.com/ros2/rosidl_runtime_py, branch jazzy, on the PYTHONPATH: no wheel has
it). Each line is one of

    {"type", "cdr", "style", "yaml"}     message_to_yaml of a message, with its options
    {"type", "fill", "cdr"}              set_message_fields from YAML; "cdr" is null if it fails; "stamps" counts times

"""

import importlib
import json
import random

from rclpy.serialization import deserialize_message, serialize_message
from rosidl_runtime_py import message_to_yaml, set_message_fields
import yaml

STYLES = [
    {},
    {'flow_style': True},
    {'truncate_length': 2},
    {'truncate_length': 3, 'flow_style': True},
    {'no_arr': True},
    {'no_str': True, 'flow_style': True},
    {'truncate_length': 0},
]

TYPES = [
    'builtin_interfaces/msg/Time', 'diagnostic_msgs/msg/DiagnosticArray', 'geometry_msgs/msg/PoseWithCovariance',
    'rcl_interfaces/msg/Parameter', 'sensor_msgs/msg/BatteryState', 'sensor_msgs/msg/JointState',
    'std_msgs/msg/Float32MultiArray', 'test_msgs/msg/Arrays', 'test_msgs/msg/BasicTypes',
    'test_msgs/msg/BoundedSequences', 'test_msgs/msg/Defaults', 'test_msgs/msg/Empty', 'test_msgs/msg/Nested',
    'test_msgs/msg/UnboundedSequences', 'test_msgs/msg/WStrings', 'std_srvs/srv/SetBool_Response',
]

TEXTS = [
    '', ' ', 'a', 'yes', 'No', 'true', 'null', '~', '=', '<<', '1', '-1', '0x1f', '017', '08', '1_0', '1.5', '1e5', '1.e+5',
    '.5', '.inf', '.nan', '-.INF', '1:30', '2001-01-01', '2001-1-1 1:00:00', 'a: b', 'a:b', ': a', ':a', 'a:', '?', '? a',
    '?a', '-', '- a', '-a', '---', '--- a', '...', '....', '#a', 'a#b', 'a #b', 'a,b', '[a', 'a]', '{a}', '&a', '*a', '!a',
    '|', '>', '%a', '@a', '`a', "'", "it's", '"', 'a"b', 'a\\b', ' a', 'a ', 'a  b', 'a\nb', 'a\n', '\na', 'a\n\nb', 'a\n b',
    'a \nb', 'a\tb', '\ta', 'a\rb', '\x01', '\x1b[0m', '\x7f', '\x85', 'a\x85b', '\xa0', 'a\xa0b', '\u2028', 'a\u2028b\u2029',
    'ü', '漢字', '\U0001f600', '\U0001f600\x01', '\ufeff', '\ufffd', '\ufffe', '\ue000', '\U0010ffff', 'a\n\n\n', "a'\n'b",
    'http://a.b/c?d=e&f', 'long ' * 30, '/tf', 'base_link', 'C:\\x', 'null ', 'y', 'on', 'a\x00b',
]

FILLS = [
    ('std_msgs/msg/String', ['{}', 'data: hello', "data: 'yes'", 'data: "a\\nb"', 'data: 5', 'daat: x', '5', '[]', 'data: [1]',
                             'data: {a: 1}', 'data: hello world', "data: ''"]),
    ('std_msgs/msg/Bool', ['data: true', 'data: no', 'data: 1', 'data: 0', 'data: On']),
    ('std_msgs/msg/Int8', ['data: 127', 'data: 128', 'data: -128', 'data: -0x10', 'data: 0b11', 'data: 017', 'data: 1_0',
                           'data: "12"', 'data: x']),
    ('std_msgs/msg/UInt64', ['data: 18446744073709551615', 'data: 18446744073709551616', 'data: -1']),
    ('std_msgs/msg/Float64', ['data: 1', 'data: 1.5', 'data: 1e5', 'data: .nan', 'data: .inf', 'data: -.Inf', 'data: x',
                              'data: "2.5"', 'data: nan']),
    ('std_msgs/msg/Float32', ['data: 0.1', 'data: 1e39']),
    ('geometry_msgs/msg/Twist', ['{linear: {x: 2.0}, angular: {z: 1.8}}', 'linear: {x: 1}\nangular: {}', 'linear: 5',
                                 'linear:\n  x: 2.0\n  y: -1.0']),
    ('sensor_msgs/msg/JointState', ['{name: [a, b], position: [1, 2.5]}', 'header: {frame_id: x}', 'header: auto',
                                    '{header: {stamp: now, frame_id: a}}', 'position: 5', 'position: []', 'name: [1]',
                                    'header: now', 'position: [x]']),
    ('geometry_msgs/msg/PoseArray', ['poses: [{position: {x: 1.0}}, {}]', 'poses: {}', 'poses: [5]']),
    ('geometry_msgs/msg/PoseWithCovariance', ['covariance: [1, 2]', 'covariance: [' + ', '.join(['1.5'] * 36) + ']']),
    ('diagnostic_msgs/msg/DiagnosticArray', ['{header: auto, status: [{name: a, values: [{key: k, value: "1"}]}]}']),
    ('sensor_msgs/msg/MultiDOFJointState', ['{header: auto, joint_names: [a], transforms: [{translation: {x: 1}}]}']),
    ('rcl_interfaces/msg/ParameterEvent', ['{stamp: now, node: /a, new_parameters: [{name: b, value: {type: 2}}]}']),
    ('test_msgs/msg/BoundedSequences', ['int8_values: [1, 2, 3]', 'int8_values: [1, 2, 3, 4]', 'string_values: [a, b]']),
    ('std_msgs/msg/Header', ['stamp: now', 'stamp: {sec: 1}']),
    ('std_msgs/msg/UInt8MultiArray', ['data: [1, 255]', 'data: [256]']),
]


def message_class(name):
    package, kind, type_name = name.split('/')
    value = importlib.import_module(f'{package}.{kind}')
    for part in type_name.split('_'):
        value = getattr(value, part)
    return value


def random_value(of):
    from rosidl_parser import definition as d
    if isinstance(of, (d.Array, d.BoundedSequence, d.UnboundedSequence)):
        count = of.size if isinstance(of, d.Array) else random.randint(0, 3)
        return [random_value(of.value_type) for _ in range(count)]
    if isinstance(of, (d.AbstractString, d.AbstractWString)):
        # rclpy interprets these as byte order marks of a wide string.
        marks = ('\ufeff', '\ufffe') if isinstance(of, d.AbstractWString) else ()
        text = random.choice([text for text in TEXTS if '\0' not in text and text not in marks])
        most = of.maximum_size if of.has_maximum_size() else 300
        return text if len(text.encode()) <= most else 'x'
    if isinstance(of, d.NamespacedType):
        return random_message(message_class('/'.join(of.namespaced_name())))
    name = of.typename
    if name == 'boolean':
        return random.random() < 0.5
    if name == 'octet':
        return bytes([random.choice([0, 2, 10, 32, 39, 48, 65, 126, 127, 133, 160, 173, 255])])
    if name in ('float', 'double'):
        value = random.choice([0.0, -0.0, float('nan'), float('inf'), -float('inf'), 1e16, 1e-5, 123456.789,
                               random.gauss(0, 1), random.gauss(0, 1) * 10.0 ** random.randint(-30, 30)])
        return value
    bits = int(name.strip('uint'))
    value = random.choice([0, 1, 2 ** bits - 1, random.getrandbits(bits)])
    return value if name[0] == 'u' else value - (1 << (bits - 1))


def random_message(cls):
    message = cls()
    for (field, _), of in zip(cls.get_fields_and_field_types().items(), cls.SLOT_TYPES):
        setattr(message, field, random_value(of))
    return message


def echo(name, message, style):
    cls = message_class(name)
    data = serialize_message(message)
    text = message_to_yaml(deserialize_message(data, cls), **style)
    print(json.dumps({'type': name, 'cdr': data.hex(), 'style': style, 'yaml': text}))


def fill(name, text):
    message = message_class(name)()
    try:
        values = yaml.safe_load(text)
        if not isinstance(values, dict):
            raise TypeError
        stamps = set_message_fields(message, values, expand_header_auto=True, expand_time_now=True)
        data = serialize_message(message).hex()
    except Exception:
        stamps, data = [], None
    print(json.dumps({'type': name, 'fill': text, 'cdr': data, 'stamps': len(stamps)}))


def main():
    random.seed(2026)
    for name in TYPES:
        for style in STYLES:
            echo(name, random_message(message_class(name)), style)
        echo(name, message_class(name)(), {})
    for text in TEXTS:
        if '\0' in text:
            continue
        echo('std_msgs/msg/String', message_class('std_msgs/msg/String')(data=text), {})
        key_value = message_class('diagnostic_msgs/msg/KeyValue')(key=text, value=text)
        status = message_class('diagnostic_msgs/msg/DiagnosticStatus')(name=text, values=[key_value])
        for style in ({}, {'flow_style': True}):
            echo('diagnostic_msgs/msg/DiagnosticStatus', status, style)
    for name, texts in FILLS:
        for text in texts:
            fill(name, text)


if __name__ == '__main__':
    main()
