"""A simulated camera, so that the robot runs without hardware: a bright spot goes round in a dark picture.

For a real camera, open it in `setup` and publish its pictures in `take` with `Image.from_numpy(array, encoding="bgr8")`. The module
runs on its own thread, so it may wait for the camera. What it publishes is recorded; a replay takes it from the bag.
"""

import math

import downbeat as db
import numpy as np
from downbeat.msgs.sensor_msgs.msg import Image

WIDTH, HEIGHT = 64, 48
ROWS, COLUMNS = np.mgrid[0:HEIGHT, 0:WIDTH]


class Camera(db.Module):
    def setup(self):
        self.angle = 0.0
        self.pictures = self.publish("camera/image_raw", "sensor_msgs/msg/Image")

    @db.every("100ms")
    def take(self):
        self.angle += 0.2
        column, row = 32 + 20 * math.cos(self.angle), 24 + 14 * math.sin(self.angle)
        is_spot = (ROWS - row) ** 2 + (COLUMNS - column) ** 2 < 9
        picture = Image.from_numpy(np.where(is_spot, 240, 30).astype(np.uint8))
        picture.header = {"stamp": self.now().to_msg(), "frame_id": "camera"}
        self.pictures(picture)
