"""Samples of splines through points, by scipy. Reads from stdin, writes to stdout, both JSON."""

import json
import sys

import numpy as np
from scipy.interpolate import BPoly

asked = json.load(sys.stdin)
answers = []
for case in asked:
    times = [point["time"] for point in case["points"]]
    # Rows of what each point has: a position, then perhaps velocity and acceleration.
    rows = [point["state"] for point in case["points"]]
    spline = BPoly.from_derivatives(times, rows)
    first, second = spline.derivative(), spline.derivative(2)
    at = np.array(case["at"])
    answers.append(np.stack([spline(at), first(at), second(at)], axis=1).tolist())
json.dump(answers, sys.stdout)
