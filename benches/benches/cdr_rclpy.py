"""Writes and reads the messages of cdr.rs with rclpy, which uses Fast CDR; prints the best time of each.

The time has two parts that cannot be separated here: Fast CDR, and the conversion between Python objects and C structs.
"""

import timeit

from geometry_msgs.msg import TransformStamped
from rcl_interfaces.msg import Log
from rclpy.serialization import deserialize_message, serialize_message
from sensor_msgs.msg import Image, Imu, JointState, PointCloud2, PointField

LARGE = 1 << 20


def with_header(message):
    message.header.frame_id = 'base_link'
    return message


def joint_state():
    numbers = [index / 10 for index in range(20)]
    return with_header(JointState(
        name=[f'joint_{index:02}' for index in range(20)], position=numbers, velocity=numbers, effort=numbers))


def point_cloud():
    fields = [PointField(name=name, offset=4 * index, datatype=PointField.FLOAT32, count=1)
              for index, name in enumerate(['x', 'y', 'z', 'intensity'])]
    return with_header(PointCloud2(
        height=1, width=LARGE // 16, fields=fields, point_step=16, row_step=LARGE, data=bytes([7]) * LARGE,
        is_dense=True))


def image():
    return with_header(Image(height=512, width=1024, encoding='yuv422', step=2048, data=bytes([7]) * LARGE))


def transform(index):
    return with_header(TransformStamped(child_frame_id=f'link_{index:02}'))


def messages():
    yield 'JointState of 20', joint_state()
    yield 'Imu', with_header(Imu())
    yield 'PointCloud2 of 1 MB', point_cloud()
    yield 'Image of 1 MB', image()
    try:
        from tf2_msgs.msg import TFMessage
        yield 'TFMessage of 50', TFMessage(transforms=[transform(index) for index in range(50)])
    except ImportError:
        print('TFMessage of 50: tf2_msgs is not installed, one TransformStamped is measured')
        yield 'TransformStamped', transform(0)
    yield 'Log', Log(
        level=int.from_bytes(Log.WARN, 'little') if isinstance(Log.WARN, bytes) else Log.WARN,
        name='controller_manager', file='./src/ros2_control_node.cpp', function='operator()', line=126,
        msg='Overrun detected! The controller manager missed its desired rate of 100 Hz.')


def best(call):
    timer = timeit.Timer(call)
    count, _ = timer.autorange()
    return min(timer.repeat(repeat=5, number=count)) / count * 1e9


print('Fast CDR behind rclpy, ns:')
for name, message in messages():
    data = serialize_message(message)
    cls = type(message)
    encode = best(lambda: serialize_message(message))
    decode = best(lambda: deserialize_message(data, cls))
    print(f'{name:24} encode {encode:12.0f}   decode {decode:12.0f}')
