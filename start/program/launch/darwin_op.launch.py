"""The emulated Darwin OP in a namespace, with a remap and a parameter: an example for launch files of robots.

    ros2 launch downbeat darwin_op.launch.py namespace:=left robot:=my_robot.toml
"""

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node


def generate_launch_description():
    robot = DeclareLaunchArgument(
        "robot", default_value="darwin_op", description="a robot file, or the name of a robot that downbeat carries"
    )
    namespace = DeclareLaunchArgument("namespace", default_value="", description="of the node and its topics")
    hold = DeclareLaunchArgument("hold_s", default_value="2.0", description="how long a command holds a joint")
    node = Node(
        package="downbeat",
        executable="downbeat",
        arguments=["run", LaunchConfiguration("robot")],
        # Without a name the node has that of the robot file.
        namespace=LaunchConfiguration("namespace"),
        remappings=[("joint_commands", "commands")],
        parameters=[{"mux.hold_s": LaunchConfiguration("hold_s")}],
        output="screen",
    )
    return LaunchDescription([robot, namespace, hold, node])
