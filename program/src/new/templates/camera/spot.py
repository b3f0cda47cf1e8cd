"""Finds the bright spot in pictures, with NumPy.

The module runs on its own thread: a picture that takes long delays no other module, and pictures that come meanwhile wait for it.
"""

import downbeat as db
import numpy as np


class Spot(db.Module):
    brightness = db.setting(128, range=(0, 255), about="what is brighter belongs to the spot")

    def setup(self):
        self.spots = self.publish("spot", "geometry_msgs/msg/PointStamped")

    @db.subscribe("camera/image_raw", "sensor_msgs/msg/Image")
    def look(self, picture):
        rows, columns = np.nonzero(picture.to_numpy() > self.brightness)
        if len(rows) == 0:
            self.log.warning("no spot in the picture", every="5s")
            return
        # In pixels from the corner at the top left.
        self.spots(header=picture.header, point={"x": columns.mean(), "y": rows.mean(), "z": 0.0})
