// A simulated IMU, so that the robot runs without hardware: the body sways about y with a period of two seconds.

#include "downbeat.hpp"
#include "sensor_msgs/msg/imu.hpp"

using namespace std::chrono_literals;
using sensor_msgs::msg::Imu;

class SimulatedImu : public downbeat::Module {
    void setup() override {
        auto out = publish<Imu>("imu/data_raw");
        every(10ms, [this, out] {
            step_ = (step_ + 1) % 200;
            const int ramp = step_ < 100 ? step_ : 200 - step_;
            Imu imu;
            imu.header.stamp.sec = static_cast<std::int32_t>(now() / 1s);
            imu.header.stamp.nanosec = static_cast<std::uint32_t>((now() % 1s).count());
            imu.header.frame_id = "imu_link";
            imu.angular_velocity.y = (ramp - 50) / 100.0; // rad/s
            out(imu);
        });
    }

    int step_ = 0;
};

DOWNBEAT_MODULE(SimulatedImu)
