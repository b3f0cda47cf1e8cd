"""`ros2 run` and `ros2 launch` for packages of a workspace, on machines without the command `ros2`.

PyPI has neither `ros2` nor `launch_ros`. Packages are found by ROS 2's own `ament_index_python`. Launch files see the few classes of
`launch` and `launch_ros` below, which start a node as `launch_ros` of Jazzy does (`launch_ros/actions/node.py`): the same arguments in
the same order, parameters in a file.
"""

import os
import runpy
import signal
import subprocess
import sys
import tempfile
import types

import yaml
from ament_index_python.packages import get_package_prefix, get_package_share_directory


class Launch:
    """The values of the launch arguments."""

    def __init__(self, given):
        self.given = given

    def text(self, value):
        return value if isinstance(value, str) else value.text(self)


class LaunchDescription:
    def __init__(self, entities):
        self.entities = entities


class DeclareLaunchArgument:
    def __init__(self, name, *, default_value, description):
        self.name, self.default_value = name, default_value

    def start(self, launch):
        launch.given.setdefault(self.name, launch.text(self.default_value))


class LaunchConfiguration:
    def __init__(self, name):
        self.name = name

    def text(self, launch):
        return launch.given[self.name]


class PathJoinSubstitution:
    def __init__(self, parts):
        self.parts = parts

    def text(self, launch):
        return os.path.join(*map(launch.text, self.parts))


class FindPackageShare:
    def __init__(self, package):
        self.package = package

    def text(self, launch):
        return get_package_share_directory(launch.text(self.package))


class Node:
    def __init__(self, *, package, executable, name=None, namespace, arguments, parameters, remappings, output):
        self.package, self.executable, self.name, self.namespace = package, executable, name, namespace
        self.arguments, self.parameters, self.remappings = arguments, parameters, remappings

    def start(self, launch):
        command = [executable(self.package, self.executable), *map(launch.text, self.arguments), "--ros-args"]
        if self.name:
            command += ["-r", f"__node:={launch.text(self.name)}"]
        namespace = "/" + launch.text(self.namespace).strip("/")
        command += ["-r", f"__ns:={namespace}"]
        for parameters in self.parameters:
            values = {name: yaml.safe_load(launch.text(value)) for name, value in parameters.items()}
            node = f"{namespace.rstrip('/')}/{self.name}" if self.name else "/**"
            with tempfile.NamedTemporaryFile("w", prefix="launch_params_", delete=False) as file:
                yaml.dump({node: {"ros__parameters": values}}, file)
            command += ["--params-file", file.name]
        for remapped, name in self.remappings:
            command += ["-r", f"{launch.text(remapped)}:={launch.text(name)}"]
        print(" ".join(command), flush=True)
        return subprocess.Popen(command)


def executable(package, name):
    return os.path.join(get_package_prefix(package), "lib", package, name)


def launch(package, file, *arguments):
    modules = {
        "launch": [LaunchDescription],
        "launch.actions": [DeclareLaunchArgument],
        "launch.substitutions": [LaunchConfiguration, PathJoinSubstitution],
        "launch_ros": [],
        "launch_ros.actions": [Node],
        "launch_ros.substitutions": [FindPackageShare],
    }
    for name, members in modules.items():
        sys.modules[name] = types.ModuleType(name)
        vars(sys.modules[name]).update({member.__name__: member for member in members})
    path = os.path.join(get_package_share_directory(package), "launch", file)
    description = runpy.run_path(path)["generate_launch_description"]()
    state = Launch(dict(argument.split(":=", 1) for argument in arguments))
    nodes = [node for node in (entity.start(state) for entity in description.entities) if node]
    for request in (signal.SIGINT, signal.SIGTERM):
        signal.signal(request, lambda number, _: [node.send_signal(number) for node in nodes])
    codes = [node.wait() for node in nodes]
    sys.exit(1 if any(codes) else 0)


if __name__ == "__main__":
    match sys.argv[1:]:
        case ["run", package, name, *arguments]:
            path = executable(package, name)
            os.execv(path, [path, *arguments])
        case ["launch", *arguments]:
            launch(*arguments)
