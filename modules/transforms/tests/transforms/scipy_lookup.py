"""Looks up transforms with scipy: one JSON object in, one list of answers out, each translation and quaternion (x, y, z, w)."""

import json
import sys

import numpy as np
from scipy.spatial.transform import Rotation, Slerp


class Link:
    """Where a frame was in its parent over time."""

    def __init__(self):
        self.parent = None
        self.samples = []
        self.is_static = False

    def at(self, time):
        samples = sorted(self.samples)
        if self.is_static:
            return np.array(samples[-1][1]), Rotation.from_quat(samples[-1][2])
        times = np.array([sample[0] for sample in samples]) - samples[0][0]
        time = time - samples[0][0]
        places = np.array([sample[1] for sample in samples])
        place = np.array([np.interp(time, times, places[:, axis]) for axis in range(3)])
        return place, Slerp(times, Rotation.from_quat([sample[2] for sample in samples]))(time)


def in_root(links, frame, time):
    place, rotation = np.zeros(3), Rotation.identity()
    while frame in links:
        link_place, link_rotation = links[frame].at(time)
        place, rotation = link_rotation.apply(place) + link_place, link_rotation * rotation
        frame = links[frame].parent
    return place, rotation


def main():
    asked = json.load(sys.stdin)
    links = {}
    for transform in asked["transforms"]:
        link = links.setdefault(transform["child"], Link())
        link.parent, link.is_static = transform["parent"], transform["is_static"]
        link.samples.append((transform["time"], transform["translation"], transform["rotation"]))
    answers = []
    for query in asked["queries"]:
        target_place, target_rotation = in_root(links, query["target"], query["time"])
        source_place, source_rotation = in_root(links, query["source"], query["time"])
        back = target_rotation.inv()
        answers.append([*back.apply(source_place - target_place), *(back * source_rotation).as_quat()])
    json.dump(answers, sys.stdout)


main()
