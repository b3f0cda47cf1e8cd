"""Prints the orientations that the package ahrs computes with the filter of Mahony.

Input, as JSON: gains, time step, first orientation (w, x, y, z), and samples of gyroscope and accelerometer.
"""

import json
import sys

import numpy
from ahrs.filters import Mahony

asked = json.load(sys.stdin)
mahony = Mahony(frequency=1.0 / asked["dt"], k_P=asked["gain"], k_I=asked["bias_gain"])
orientation = numpy.array(asked["first"])
orientations = []
for gyro, force in asked["samples"]:
    orientation = mahony.updateIMU(orientation, gyr=numpy.array(gyro), acc=numpy.array(force))
    orientations.append(list(map(float, orientation)))
json.dump({"orientations": orientations, "bias": list(map(float, mahony.b))}, sys.stdout)
