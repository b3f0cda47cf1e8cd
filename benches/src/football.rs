//! A football robot: eight modules and 14 topics, with one message on each per cycle.

use std::hint::black_box;
use std::time::Duration;

use downbeat_executor::{Context, Core, ManualClock, Module, Publication, Received, Setup, SetupError, Time};

use crate::contestants::Contestant;

/// A message of N numbers; only its size matters.
#[derive(Clone, Copy)]
struct Numbers<const N: usize>([f32; N]);

impl<const N: usize> Numbers<N> {
    fn new(number: f32) -> Self {
        Self([number; N])
    }
}

/// The address and size of the pixels, and the camera's position; pixels are passed as a shared buffer.
type Image = Numbers<12>;
type Ball = Numbers<4>;
type Lines = Numbers<32>;
type Pose = Numbers<12>;
type State = Numbers<2>;
type WalkCommand = Numbers<3>;
type HeadCommand = Numbers<2>;
type LegCommands = Numbers<12>;
type NeckCommands = Numbers<2>;
type Odometry = Numbers<6>;
type JointStates = Numbers<60>;
type Imu = Numbers<10>;
type Battery = Numbers<2>;
type Feet = Numbers<8>;

const PERIOD: Duration = Duration::from_millis(8);

/// `executor/steps` carries no messages here.
const TOPICS: usize = 14;

/// A module that subscribes to topics, adds up one number of each message, and publishes its sum on its
/// topics every cycle.
macro_rules! part {
    ($part:ident hears [$($heard:ident: $Heard:ty),*] tells [$($told:ident: $Told:ty),*]) => {
        #[derive(Default)]
        struct $part {
            sum: f32,
            $($told: Option<Publication<$Told>>,)*
        }

        impl Module for $part {
            type Ports = ();

            fn setup(&mut self, setup: &mut Setup<'_, Self>) -> Result<(), SetupError> {
                $(self.$told = Some(setup.publish(stringify!($told))?);)*
                $(setup.subscribe(
                    stringify!($heard),
                    |part: &mut Self, message: Received<'_, $Heard>, _: &mut Context<'_>| {
                        part.sum = black_box(part.sum + message.0[0]);
                    },
                )?;)*
                setup.every(PERIOD, |part: &mut Self, ctx: &mut Context<'_>| {
                    $(if let Some(told) = part.$told { ctx.publish(told, <$Told>::new(part.sum)); })*
                })
            }
        }
    };
}

part!(Camera hears [] tells [image: Image]);
part!(BallFinder hears [image: Image, joint_states: JointStates] tells [ball: Ball]);
part!(LineFinder hears [image: Image, joint_states: JointStates] tells [lines: Lines]);
part!(Localisation hears [lines: Lines, odometry: Odometry, imu: Imu] tells [pose: Pose]);
part!(Behaviour hears [ball: Ball, pose: Pose, battery: Battery, imu: Imu]
      tells [state: State, walk_command: WalkCommand, head_command: HeadCommand]);
part!(Walk hears [walk_command: WalkCommand, imu: Imu, feet: Feet, joint_states: JointStates]
      tells [leg_commands: LegCommands, odometry: Odometry]);
part!(Head hears [head_command: HeadCommand, ball: Ball] tells [neck_commands: NeckCommands]);
part!(Hardware hears [leg_commands: LegCommands, neck_commands: NeckCommands, state: State]
      tells [joint_states: JointStates, imu: Imu, battery: Battery, feet: Feet]);

/// A core with the modules of the robot. A trial is a cycle.
pub struct Football {
    core: Core,
    clock: ManualClock,
}

impl Football {
    /// Adds the robot's modules to the core returned by `prepare`, and starts them.
    ///
    /// # Errors
    /// If the core cannot be prepared.
    pub fn new(prepare: impl FnOnce(Core) -> anyhow::Result<Core>) -> anyhow::Result<Self> {
        let clock = ManualClock::new(Time::ZERO);
        let mut core = prepare(Core::new().with_clock(clock.clone()))?;
        core.add("camera", Camera::default())?;
        core.add("ball_finder", BallFinder::default())?;
        core.add("line_finder", LineFinder::default())?;
        core.add("localisation", Localisation::default())?;
        core.add("behaviour", Behaviour::default())?;
        core.add("walk", Walk::default())?;
        core.add("head", Head::default())?;
        core.add("hardware", Hardware::default())?;
        let mut football = Self { core, clock };
        (0..10).for_each(|_| football.trial());
        Ok(football)
    }
}

impl Contestant for Football {
    fn trial(&mut self) {
        self.clock.advance(PERIOD);
        // Fails only at the start. Lost messages show in the counts.
        let _ = self.core.cycle();
    }

    /// The number of messages that each topic has carried; 0 if the numbers differ.
    fn finish(self: Box<Self>) -> u64 {
        let counts = self.core.topics().map(|topic| topic.counter.messages());
        let mut counts: Vec<u64> = counts.filter(|&count| count > 0).collect();
        let topics = counts.len();
        counts.dedup();
        if topics == TOPICS && counts.len() == 1 { counts[0] } else { 0 }
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;
    use crate::launchers::LAUNCHERS;

    #[test]
    fn each_topic_carries_one_message_per_cycle() {
        for launcher in LAUNCHERS {
            let mut football = Box::new(Football::new(launcher.launch).unwrap());
            (0..5).for_each(|_| football.trial());
            assert_eq!(football.finish(), 14, "{}", launcher.name);
        }
    }
}
