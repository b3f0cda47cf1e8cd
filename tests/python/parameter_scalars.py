"""Prints the parameters that rclpy declares for scalars in a parameter file: lines of JSON, [type, value as text], or null if it refuses the file.

usage: parameter_scalars.py FILE, with a scalar in each line
"""

import json
import os
import sys
import tempfile

os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "OFF"

import rclpy  # noqa: E402


def declared(text):
    with tempfile.NamedTemporaryFile("w", suffix=".yaml") as file:
        file.write(f"/**:\n  ros__parameters:\n    x: {text}\n")
        file.flush()
        context = rclpy.Context()
        try:
            rclpy.init(context=context, args=["--ros-args", "--params-file", file.name])
        except Exception:  # of rcl: the file is refused
            return None
        node = rclpy.create_node("n", context=context, automatically_declare_parameters_from_overrides=True)
        parameter = node.get_parameter("x")
        node.destroy_node()
        rclpy.shutdown(context=context)
        value = parameter.value
        return [parameter.type_.name, str(value)]


with open(sys.argv[1]) as lines:
    for line in lines.read().splitlines():
        print(json.dumps(declared(line)))
