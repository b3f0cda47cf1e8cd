"""Reads a data set with LeRobot itself, as a training does.

Usage: read_with_lerobot.py HOME DATASET. Prints what it finds.
"""

import importlib.metadata
import json
import sys

import torch
from lerobot.datasets.lerobot_dataset import LeRobotDataset

dataset = LeRobotDataset("downbeat/test", root=sys.argv[2], delta_timestamps={"action": [-0.05, 0.0, 0.05]})
frame = dataset[41]  # the first of the second episode
batch = next(iter(torch.utils.data.DataLoader(dataset, batch_size=8)))
assert dataset.meta.robot_type == "my_arm"
assert dataset.meta.stats["observation.state"]["mean"].shape == (2,)
assert dataset.meta.stats["observation.images.front"]["std"].shape == (3, 1, 1)
assert dataset.meta.features["observation.state"]["names"] == ["pan.pos", "gripper.pos"]

# Episodes can be read alone.
only = LeRobotDataset("downbeat/test", root=sys.argv[2], episodes=[1])
assert len(only) == 21 and only[0]["task"] == "grip"

print(json.dumps({
    "version": importlib.metadata.version("lerobot"),
    "frames": len(dataset),
    "episodes": dataset.num_episodes,
    "fps": dataset.fps,
    "tasks": [dataset[0]["task"], frame["task"]],
    "state": frame["observation.state"].tolist(),
    "picture": list(frame["observation.images.front"].shape),
    "level": frame["observation.images.front"].mean().item(),
    "is_pad": frame["action_is_pad"].tolist(),
    "batch": list(batch["observation.state"].shape),
}))
