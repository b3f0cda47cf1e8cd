"""Prints "ready", then the time of the first joint state as Unix seconds and the number of its joints. Arguments: seconds, topic."""

import sys
import time

import rclpy
from rclpy.qos import qos_profile_sensor_data
from sensor_msgs.msg import JointState

rclpy.init()
node = rclpy.create_node("newcomer")
first = []
node.create_subscription(
    JointState, sys.argv[2], lambda message: first.append((time.time(), len(message.name))), qos_profile_sensor_data
)
print("ready", flush=True)
end = time.monotonic() + float(sys.argv[1])
while not first and time.monotonic() < end:
    rclpy.spin_once(node, timeout_sec=0.1)
if not first:
    sys.exit("no joint state arrived")
print(*first[0], flush=True)
