"""Prints a line when it listens, and the number of joints of each message of a robot: with rclpy of ROS 2."""

import signal

import rclpy
from sensor_msgs.msg import JointState

signal.alarm(60)  # a robot without joint states must not hold the run
rclpy.init()
node = rclpy.create_node("joint_states_from_nothing")
node.create_subscription(JointState, "/joint_states", lambda message: print(len(message.name), flush=True), 10)
print("listening", flush=True)
rclpy.spin(node)
