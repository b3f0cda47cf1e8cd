"""Holds the head level: tilts it against the rotation that the gyroscope measures."""

import downbeat as db


class LevelHead(db.Module):
    gain = db.setting(0.9, range=(0, 2), about="how much of the rotation is compensated")

    def setup(self):
        self.angle = 0.0  # rad, positive is up
        self.measured = None
        self.commands = self.publish("joint_commands", "sensor_msgs/msg/JointState")

    @db.subscribe("imu/data_raw", "sensor_msgs/msg/Imu")
    def measure(self, imu):
        now = self.now()
        if self.measured is not None:
            angle = self.angle + self.gain * imu.angular_velocity.y * (now - self.measured) / 1e9
            self.angle = min(max(angle, -0.4), 0.9)
            if angle != self.angle:
                self.log.warning("the head is at its limit", every="5s")
        self.measured = now

    @db.every("20ms")
    def command(self):
        self.commands(name=["head_tilt"], position=[self.angle])

    def save(self):  # for the next version of this file, see `reload` in robot.toml
        return self.angle

    def restore(self, angle):
        self.angle = angle
