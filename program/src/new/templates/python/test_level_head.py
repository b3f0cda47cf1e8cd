"""The module with a probe, where the test advances the clock; and the recorded run, bit for bit."""

import pathlib

import downbeat as db
from level_head import LevelHead

HERE = pathlib.Path(__file__).parent


def test_the_head_turns_against_the_body_as_far_as_the_joint_allows():
    robot = db.test.Robot(level_head=LevelHead)
    angles = []
    for _ in range(4):
        robot.inject("imu/data_raw", angular_velocity={"y": 0.5})
        robot.advance("1s")
        angles.append(round(float(robot.heard("joint_commands")[-1].position[0]), 6))
    assert angles == [0.0, 0.45, 0.9, 0.9]


def test_the_field_run_repeats():
    db.replay(HERE / "robot.toml", HERE / "tests/field_run").assert_same()
