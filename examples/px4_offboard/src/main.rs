//! Flies a square in offboard mode of a PX4 autopilot.

use std::process::ExitCode;
use std::time::Duration;

use downbeat::App;
use downbeat::executor::{Client, Context, Module, Publication, Received, Reply, Setup, SetupError};
use downbeat::msgs::geometry_msgs::msg::{Point, PoseStamped};
use downbeat::msgs::nav_msgs::msg::Odometry;
use downbeat::msgs::std_srvs::srv::{SetBoolRequest, SetBoolResponse, TriggerRequest, TriggerResponse};

/// The corners, in m to the east and to the north of the start.
const CORNERS: [[f64; 2]; 4] = [[0.0, 0.0], [2.0, 0.0], [2.0, 2.0], [0.0, 2.0]];
const HEIGHT: f64 = 2.0; // m
const NEAR: f64 = 0.1; // m
const TIMEOUT: Duration = Duration::from_secs(5);

/// Flies the square once.
#[derive(Default)]
struct Square {
    stage: Stage,
    position: Option<Point>,
}

/// What happens next. A request is repeated if it was refused.
#[derive(Clone, Copy, Default, PartialEq)]
enum Stage {
    #[default]
    Arm,
    Offboard,
    /// To the corner with this index.
    Fly(usize),
    Land,
    /// Until a request is answered.
    Wait,
    Done,
}

struct Ports {
    set_points: Publication<PoseStamped>,
    arm: Client<SetBoolRequest, SetBoolResponse>,
    offboard: Client<TriggerRequest, TriggerResponse>,
    land: Client<TriggerRequest, TriggerResponse>,
}

impl Module for Square {
    type Ports = Ports;

    fn setup(&mut self, setup: &mut Setup<'_, Self>) -> Result<Ports, SetupError> {
        setup.subscribe("odom", Self::on_odometry)?;
        // Without set-points PX4 leaves offboard mode, and `px4` makes none of commands older than 0.5 s.
        setup.every(Duration::from_millis(100), Self::command)?;
        Ok(Ports {
            set_points: setup.publish("setpoint_pose")?,
            arm: setup.client("arm", TIMEOUT, |square: &mut Self, reply: Reply<SetBoolResponse>, _| {
                square.go_on(reply.result.map(|response| response.message), Stage::Arm, Stage::Offboard);
            })?,
            offboard: setup.client(
                "offboard",
                TIMEOUT,
                |square: &mut Self, reply: Reply<TriggerResponse>, _| {
                    square.go_on(
                        reply.result.map(|response| response.message),
                        Stage::Offboard,
                        Stage::Fly(0),
                    );
                },
            )?,
            land: setup.client("land", TIMEOUT, |square: &mut Self, reply: Reply<TriggerResponse>, _| {
                square.go_on(reply.result.map(|response| response.message), Stage::Land, Stage::Done);
            })?,
        })
    }
}

impl Square {
    fn on_odometry(&mut self, odometry: Received<'_, Odometry>, _: &mut Context<'_, Ports>) {
        self.position = Some(odometry.pose.pose.position);
    }

    /// Notes the answer to a request.
    fn go_on<E: std::fmt::Display>(&mut self, answer: Result<String, E>, refused: Stage, accepted: Stage) {
        match answer {
            Ok(message) => {
                tracing::info!("{message}");
                self.stage = accepted;
            }
            Err(error) => {
                tracing::warn!("{error}");
                self.stage = refused;
            }
        }
    }

    fn command(&mut self, ctx: &mut Context<'_, Ports>) {
        let Some(position) = self.position else { return };
        let corner = match self.stage {
            Stage::Done => return,
            Stage::Fly(corner) => corner,
            Stage::Land => CORNERS.len() - 1,
            Stage::Arm | Stage::Offboard | Stage::Wait => 0,
        };
        let [x, y] = CORNERS[corner];
        let mut set_point = PoseStamped::default();
        set_point.header.frame_id = "odom".to_owned();
        set_point.pose.position = Point { x, y, z: HEIGHT };
        set_point.pose.orientation.w = 1.0; // faces east
        ctx.publish(ctx.ports.set_points, set_point);

        match self.stage {
            Stage::Arm => {
                ctx.call(ctx.ports.arm, SetBoolRequest { data: true });
                self.stage = Stage::Wait;
            }
            Stage::Offboard => {
                ctx.call(ctx.ports.offboard, TriggerRequest::default());
                self.stage = Stage::Wait;
            }
            Stage::Fly(corner) if distance(&position, [x, y, HEIGHT]) < NEAR => {
                tracing::info!("corner {} of {}: {x:.1} m east, {y:.1} m north", corner + 1, CORNERS.len());
                self.stage = if corner + 1 < CORNERS.len() { Stage::Fly(corner + 1) } else { Stage::Land };
            }
            Stage::Land => {
                ctx.call(ctx.ports.land, TriggerRequest::default());
                self.stage = Stage::Wait;
            }
            Stage::Fly(_) | Stage::Wait | Stage::Done => {}
        }
    }
}

fn distance(from: &Point, [x, y, z]: [f64; 3]) -> f64 {
    ((from.x - x).powi(2) + (from.y - y).powi(2) + (from.z - z).powi(2)).sqrt()
}

fn app() -> App {
    App::with_built_in_kinds().kind("square", "flies a square by set-points", Square::default)
}

fn main() -> ExitCode {
    app().main()
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;
    use downbeat::executor::Probe;
    use downbeat::modules::px4::{Autopilot, Px4};

    #[test]
    fn the_vehicle_is_at_each_corner_and_lands() {
        let mut probe = Probe::new();
        probe.add("autopilot", Autopilot::default()).unwrap();
        probe.add("px4", Px4::default()).unwrap();
        probe.add("square", Square::default()).unwrap();
        let odom = probe.listen::<Odometry>("odom").unwrap();
        probe.advance(Duration::from_secs(30)).unwrap();
        let flown: Vec<Point> = odom.take().into_iter().map(|odometry| odometry.pose.pose.position).collect();
        for [x, y] in CORNERS {
            assert!(flown.iter().any(|position| distance(position, [x, y, HEIGHT]) < NEAR), "{x} {y}");
        }
        let [x, y] = CORNERS[3];
        assert!(distance(flown.last().unwrap(), [x, y, 0.0]) < 2.0 * NEAR, "{:?}", flown.last());
    }
}
