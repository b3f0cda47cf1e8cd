"""A simulated IMU, so that the robot runs without hardware: the body sways about y with a period of two seconds."""

import downbeat as db


class SimulatedImu(db.Module):
    def setup(self):
        self.step = 0
        self.imu = self.publish("imu/data_raw", "sensor_msgs/msg/Imu")

    @db.every("10ms")
    def measure(self):
        self.step = (self.step + 1) % 200
        ramp = self.step if self.step < 100 else 200 - self.step
        stamp = self.now().to_msg()
        self.imu(header={"stamp": stamp, "frame_id": "imu_link"}, angular_velocity={"y": (ramp - 50) / 100})
