//! A cycle of a football robot: eight modules, 14 topics, one message on each per cycle.
#![allow(missing_docs, clippy::unwrap_used)]

use std::hint::black_box;
use std::time::Duration;

use benches::launchers::LAUNCHERS;
use criterion::{Criterion, criterion_group, criterion_main};
use downbeat_executor::{Context, Core, ManualClock, Module, Publication, Received, Setup, SetupError, Time};

/// A message of N numbers, which is all that matters here.
#[derive(Clone, Copy)]
struct Numbers<const N: usize>([f32; N]);

impl<const N: usize> Numbers<N> {
    fn new(number: f32) -> Self {
        Self([number; N])
    }
}

/// Where the pixels are, their size and the camera's position; pixels travel as a shared buffer.
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

/// A module that hears topics, adds up a number of each message, and tells its sum on its own topics every cycle.
macro_rules! part {
    ($part:ident hears [$($heard:ident: $Heard:ty),*] tells [$($told:ident: $Told:ty),*]) => {
        #[derive(Default)]
        struct $part {
            sum: f32,
            $($told: Option<Publication<$Told>>,)*
        }

        impl Module for $part {
            fn setup(&mut self, setup: &mut Setup<'_, Self>) -> Result<(), SetupError> {
                $(self.$told = Some(setup.publish(stringify!($told))?);)*
                $(setup.subscribe(
                    stringify!($heard),
                    |part: &mut Self, message: Received<'_, $Heard>, _: &mut Context<'_>| {
                        part.sum = black_box(part.sum + message.0[0]);
                    },
                )?;)*
                setup.every(PERIOD, |part: &mut Self, ctx: &mut Context<'_>| {
                    $(ctx.publish(part.$told.unwrap(), <$Told>::new(part.sum));)*
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

fn football(criterion: &mut Criterion) {
    let mut group = criterion.benchmark_group("football");
    for launcher in LAUNCHERS {
        let clock = ManualClock::new(Time::ZERO);
        let mut core = (launcher.launch)(Core::new().with_clock(clock.clone())).unwrap();
        core.add("camera", Camera::default()).unwrap();
        core.add("ball_finder", BallFinder::default()).unwrap();
        core.add("line_finder", LineFinder::default()).unwrap();
        core.add("localisation", Localisation::default()).unwrap();
        core.add("behaviour", Behaviour::default()).unwrap();
        core.add("walk", Walk::default()).unwrap();
        core.add("head", Head::default()).unwrap();
        core.add("hardware", Hardware::default()).unwrap();
        let mut cycle = || {
            clock.advance(PERIOD);
            core.cycle().unwrap();
        };
        (0..10).for_each(|_| cycle());
        group.bench_function(launcher.name, |bencher| bencher.iter(&mut cycle));
        let counts: Vec<u64> = core.topics().map(|topic| topic.counter.messages()).collect();
        let published = counts.iter().filter(|&&count| count > 0).count();
        assert!(
            published == 14 && counts.iter().filter(|&&count| count > 0).all(|&count| count == counts[0])
        );
    }
    group.finish();
}

criterion_group! {
    name = benches;
    config = Criterion::default().warm_up_time(Duration::from_millis(500)).measurement_time(Duration::from_secs(2));
    targets = football
}
criterion_main!(benches);
