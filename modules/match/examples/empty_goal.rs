//! One robot, an empty goal, ten seeded placements: how often and how fast does it score? The decisions are a small module here.
#![allow(missing_docs)]

use clap::Parser;
use downbeat_executor::{Context, Inbox, Module, Publication, Received, Setup, SetupError, Time};
use downbeat_football::Field;
use downbeat_match::{Entrant, Pitch, PitchError, player};
use downbeat_modules::servo_emulator::Random;
use downbeat_msgs::geometry_msgs::msg::PointStamped;
use downbeat_msgs::std_msgs::msg::String as Text;
use downbeat_physics::ArenaRobot;
use glam::DVec2;
use parking_lot::Mutex;
use std::f64::consts::TAU;
use std::sync::Arc;
use std::time::{Duration, Instant};

/// Lets one robot shoot at an empty goal from seeded placements.
#[derive(Parser)]
struct Arguments {
    /// The first seed
    #[arg(long, default_value_t = 1)]
    first: u64,
    /// The number of seeds
    #[arg(long, default_value_t = 10)]
    seeds: u64,
    /// How long a robot has, in s
    #[arg(long, default_value_t = 120)]
    seconds: u64,
    /// Prints where robot and ball are every second
    #[arg(long)]
    trace: bool,
}

/// Lines up and kicks, again and again.
struct Shooter {
    goal: DVec2,
    is_busy: bool,
    kicked_at: Option<Time>,
}

struct Ports {
    target: Publication<PointStamped>,
    play: Publication<Text>,
    head: Publication<Text>,
}

impl Module for Shooter {
    type Ports = Ports;

    fn setup(&mut self, setup: &mut Setup<'_, Self>) -> Result<Ports, SetupError> {
        setup.every(Duration::from_secs(1), |shooter: &mut Self, ctx: &mut Context<'_, Ports>| {
            let mut target = PointStamped::default();
            target.header.frame_id = "map".into();
            (target.point.x, target.point.y) = (shooter.goal.x, shooter.goal.y);
            ctx.publish(ctx.ports.target, target);
            ctx.publish(ctx.ports.head, Text { data: "track".into() });
        })?;
        setup.subscribe("motions/playing", |shooter: &mut Self, playing: Received<'_, Text>, _| {
            shooter.is_busy = !playing.data.is_empty();
        })?;
        setup.subscribe("walk_to/state", |shooter: &mut Self, state: Received<'_, Text>, ctx| {
            let rested = shooter.kicked_at.is_none_or(|at| ctx.now() > at + Duration::from_secs(2));
            if state.data.starts_with("kick_") && !shooter.is_busy && rested {
                shooter.kicked_at = Some(ctx.now());
                ctx.publish(ctx.ports.play, Text { data: state.data.clone() });
            }
        })?;
        Ok(Ports {
            target: setup.publish("walk_to/kick")?,
            play: setup.publish("motions/play")?,
            head: setup.publish("head/mode")?,
        })
    }
}

/// When a goal fell, in s; `None` if none did.
fn shoot(seed: u64, arguments: &Arguments) -> Result<Option<f64>, PitchError> {
    let field = Field::named("kid_size_2013").unwrap_or_default();
    let mut random = Random::new(seed, 9);
    let goal = DVec2::new(field.length / 2.0, 0.0);
    // The ball within 2 m of the goal, the robot within 1.5 m of the ball.
    let mut on_field = |centre: DVec2, within: [f64; 2]| loop {
        let far = within[0] + random.unit() * (within[1] - within[0]);
        let place = centre + DVec2::from_angle(random.unit() * TAU) * far;
        if place.x.abs() < goal.x - 0.3 && place.y.abs() < field.width / 2.0 - 0.3 {
            return place;
        }
    };
    let ball = on_field(goal, [0.8, 2.0]);
    let start = on_field(ball, [0.4, 1.5]);
    let mut robot = ArenaRobot::named("shooter");
    robot.seed = seed;
    robot.start.position = start.to_array();
    robot.start.yaw = random.unit() * TAU;
    let entrants = vec![Entrant { robot, defends_right: false }];
    let mut pitch = Pitch::new(&field, entrants, |_, core, bus| {
        let mut core = player::with_skills(core, bus, seed.cast_signed())?;
        // Behind the line, so that the direction is clear in front of it too.
        let goal = goal + DVec2::X * field.goal.depth;
        core.add("shooter", Shooter { goal, is_busy: false, kicked_at: None })?;
        Ok(core)
    })?;
    pitch.arena().place_ball(ball.to_array());
    let state = Arc::<Mutex<String>>::default();
    let shown = Arc::clone(&state);
    if let Some(core) = pitch.core(0).filter(|_| arguments.trace) {
        let show = move |text: Received<'_, Text>| shown.lock().clone_from(&text.data);
        core.outlet("walk_to/state", Inbox::KeepAll, show).map_err(PitchError::setup("shooter"))?.keep();
    }
    for tenth in 0..arguments.seconds * 10 {
        pitch.run_for(Duration::from_millis(100))?;
        let found = pitch.snapshot();
        let Some(ball) = found.ball.map(|ball| ball.world_from_body.translation) else { continue };
        if arguments.trace && tenth % 10 == 0 {
            let root = found.robots[0].root.world_from_body;
            let ahead = root.rotation * glam::DVec3::X;
            let (x, y, yaw) = (root.translation.x, root.translation.y, ahead.y.atan2(ahead.x));
            let seen = DVec2::from_angle(-yaw).rotate(ball.truncate() - DVec2::new(x, y));
            let (second, state) = (tenth / 10, state.lock());
            println!(
                "{second:>4} robot {x:.2} {y:.2} {yaw:.2} ball {:.2} {:.2} seen {seen:.3} {state}",
                ball.x, ball.y
            );
        }
        if ball.x > goal.x + field.ball.diameter / 2.0 && ball.y.abs() < field.goal.width / 2.0 {
            return Ok(Some(tenth as f64 / 10.0));
        }
    }
    Ok(None)
}

fn main() -> Result<(), PitchError> {
    let arguments = Arguments::parse();
    let (started, mut goals, mut simulated) = (Instant::now(), 0, 0.0);
    for seed in arguments.first..arguments.first + arguments.seeds {
        let goal = shoot(seed, &arguments)?;
        goals += u32::from(goal.is_some());
        simulated += goal.unwrap_or(arguments.seconds as f64);
        println!("seed {seed}: {}", goal.map_or("no goal".to_owned(), |at| format!("goal after {at:.1} s")));
    }
    let speed = simulated / started.elapsed().as_secs_f64();
    println!("{goals} goals of {}, {speed:.1} times faster than real time", arguments.seeds);
    Ok(())
}
