"""Writes a data set with LeRobot itself.

Usage: write_with_lerobot.py HOME DATASET. Prints the last state.
"""

import json
import sys

import numpy
from lerobot.datasets.lerobot_dataset import LeRobotDataset

names = ["pan.pos", "gripper.pos"]
numbers = {"dtype": "float32", "shape": (2,), "names": names}
dataset = LeRobotDataset.create(
    "downbeat/test",
    fps=10,
    root=sys.argv[2],
    robot_type="my_arm",
    use_videos=False,
    features={
        "observation.state": numbers,
        "action": numbers,
        "observation.images.front": {"dtype": "image", "shape": (24, 32, 3), "names": ["height", "width", "channels"]},
    },
)
state = numpy.zeros(2, dtype="float32")
for length in (10, 5):
    for frame in range(length):
        state = numpy.array([length, frame], dtype="float32")
        picture = numpy.full((24, 32, 3), frame, dtype="uint8")
        dataset.add_frame({"observation.state": state, "action": -state, "observation.images.front": picture, "task": "wave"})
    dataset.save_episode()
dataset.finalize()
print(json.dumps({"last": state.tolist()}))
