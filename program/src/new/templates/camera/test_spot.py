"""The module with a probe, where the test advances the clock; and the recorded run, bit for bit."""

import pathlib

import downbeat as db
import numpy as np
from downbeat.msgs.sensor_msgs.msg import Image
from spot import Spot

HERE = pathlib.Path(__file__).parent


def test_the_spot_is_where_the_picture_is_bright():
    robot = db.test.Robot(spot=Spot)
    picture = np.zeros((48, 64), np.uint8)
    robot.inject("camera/image_raw", Image.from_numpy(picture))
    robot.expect_none("spot")
    picture[10:13, 20:23] = 200
    robot.inject("camera/image_raw", Image.from_numpy(picture))
    point = robot.expect("spot").point
    assert (point.x, point.y) == (21.0, 11.0)


def test_the_field_run_repeats():
    db.replay(HERE / "robot.toml", HERE / "tests/field_run").assert_same()
