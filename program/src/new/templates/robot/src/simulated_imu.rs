//! A simulated IMU, so that the robot runs without hardware.

use std::time::Duration;

use downbeat::executor::{Context, Module, Publication, Setup, SetupError};
use downbeat::msgs::builtin_interfaces::msg::Time;
use downbeat::msgs::sensor_msgs::msg::Imu;

/// The body sways about y with a period of two seconds.
#[derive(Default)]
pub struct SimulatedImu {
    step: u32,
}

const PERIOD: Duration = Duration::from_millis(10);

impl Module for SimulatedImu {
    type Ports = Publication<Imu>;

    fn setup(&mut self, setup: &mut Setup<'_, Self>) -> Result<Publication<Imu>, SetupError> {
        setup.every(PERIOD, Self::measure)?;
        setup.publish("imu/data_raw")
    }
}

impl SimulatedImu {
    fn measure(&mut self, ctx: &mut Context<'_, Publication<Imu>>) {
        self.step = (self.step + 1) % 200;
        let ramp = if self.step < 100 { f64::from(self.step) } else { f64::from(200 - self.step) };
        let mut imu = Imu::default();
        imu.header.stamp = Time::from_nanos(ctx.now().as_nanos());
        imu.header.frame_id = "imu_link".into();
        imu.angular_velocity.y = (ramp - 50.0) / 100.0; // rad/s
        ctx.publish(*ctx.ports, imu);
    }
}
