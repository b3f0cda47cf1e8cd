"""Starts my_robot: `ros2 launch my_robot my_robot.launch.py namespace:=left gain:=0.5`."""

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument
from launch.substitutions import LaunchConfiguration, PathJoinSubstitution
from launch_ros.actions import Node
from launch_ros.substitutions import FindPackageShare


def generate_launch_description():
    return LaunchDescription(
        [
            DeclareLaunchArgument("namespace", default_value="", description="of the node and its topics"),
            DeclareLaunchArgument("gain", default_value="0.9", description="how much of the rotation is compensated"),
            Node(
                package="my_robot",
                executable="my_robot",
                name="my_robot",
                namespace=LaunchConfiguration("namespace"),
                arguments=["run", PathJoinSubstitution([FindPackageShare("my_robot"), "robot.toml"])],
                parameters=[{"level_head.gain": LaunchConfiguration("gain")}],
                remappings=[("joint_commands", "head/joint_commands")],
                output="screen",
            ),
        ]
    )
