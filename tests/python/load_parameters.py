"""Prints as JSON the parameters that a real ROS 2 node named darwin_op reads from a parameter file."""

import json
import os
import sys

os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"

import rclpy
from rclpy.node import Node

rclpy.init(args=["--ros-args", "--params-file", sys.argv[1]])
node = Node("darwin_op", automatically_declare_parameters_from_overrides=True)
parameters = node.get_parameters_by_prefix("")
values = {name: [parameter.type_.name, parameter.value] for name, parameter in parameters.items()}
print(json.dumps(values, default=list))
node.destroy_node()
rclpy.shutdown()
