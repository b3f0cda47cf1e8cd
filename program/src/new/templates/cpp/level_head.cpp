// Holds the head level: tilts it against the rotation that the gyroscope measures.

#include <algorithm>

#include "downbeat.hpp"
#include "sensor_msgs/msg/imu.hpp"
#include "sensor_msgs/msg/joint_state.hpp"

using namespace std::chrono_literals;
using sensor_msgs::msg::Imu;
using sensor_msgs::msg::JointState;

class LevelHead : public downbeat::Module {
    void setup() override {
        auto commands = publish<JointState>("joint_commands");
        gain_ = setting("gain", 0.9, "how much of the rotation is compensated", 0.0, 2.0);
        subscribe<Imu>("imu/data_raw", [this](const Imu &imu) { measure(imu); });
        every(20ms, [this, commands] {
            JointState command;
            command.name = {"head_tilt"};
            command.position = {angle_};
            commands(command);
        });
    }

    void variables(downbeat::Variables &variables) const override { variables.report("angle", angle_); }

    void measure(const Imu &imu) {
        const std::chrono::duration<double> elapsed = measured_ == 0ns ? 0ns : now() - measured_;
        measured_ = now();
        const double angle = angle_ + *gain_ * imu.angular_velocity.y * elapsed.count();
        angle_ = std::clamp(angle, -0.4, 0.9);
        if (angle != angle_) {
            warn_every(5s, "the head is at its limit");
        }
    }

    double angle_ = 0.0; // rad, positive is up
    std::chrono::nanoseconds measured_ = 0ns;
    downbeat::Setting<double> gain_;
};

DOWNBEAT_MODULE(LevelHead)
