//! Two against two with simple decisions, drawn in the terminal: the number of goals, how long anybody lay, and the speed.
#![allow(missing_docs)]

use clap::Parser;
use downbeat_executor::{Context, Module, Publication, Received, Setup, SetupError, Time};
use downbeat_football::Field;
use downbeat_football::football_interfaces::msg::GameState;
use downbeat_football::soccer_model_msgs::msg::Ball;
use downbeat_match::{Event, Game, GameOptions, Phase, PitchError, Rules, Seat, Team, draw, player};
use downbeat_msgs::geometry_msgs::msg::{PointStamped, PoseStamped};
use downbeat_msgs::std_msgs::msg::{Empty, String as Text};
use glam::DVec2;
use std::time::{Duration, Instant};

/// Lets two robots play against two.
#[derive(Parser)]
struct Arguments {
    /// Of all noise
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// The length of a half, in s
    #[arg(long, default_value_t = 300)]
    half: u64,
    /// Draws the field this often, in s of the game; 0: never
    #[arg(long, default_value_t = 10)]
    draw: u64,
}

/// Number 2 shoots; number 1 stays in front of its goal on the way of the ball, and shoots when the ball is near.
struct Footballer {
    field: Field,
    game: GameState,
    ball: Option<DVec2>,
    is_busy: bool,
    kicked_at: Option<Time>,
}

struct Ports {
    kick: Publication<PointStamped>,
    pose: Publication<PoseStamped>,
    stop: Publication<Empty>,
    play: Publication<Text>,
    head: Publication<Text>,
}

impl Footballer {
    fn decide(&mut self, ctx: &mut Context<'_, Ports>) {
        ctx.publish(ctx.ports.head, Text { data: "track".into() });
        let half = self.field.length / 2.0;
        let home = if self.game.is_goalkeeper {
            let aside = self.ball.map_or(0.0, |ball| ball.y.clamp(-0.5, 0.5) * 0.6);
            DVec2::new(-half + 0.4, aside)
        } else {
            DVec2::new(-self.field.circle_diameter / 2.0 - 0.3, 0.0)
        };
        let is_mine = !self.game.is_goalkeeper || self.ball.is_some_and(|ball| ball.x < -half / 3.0);
        match self.game.state {
            _ if self.game.is_penalised => ctx.publish(ctx.ports.stop, Empty::default()),
            GameState::PLAYING if is_mine => {
                let mut target = PointStamped::default();
                target.header.frame_id = "map".into();
                target.point.x = half + self.field.goal.depth;
                ctx.publish(ctx.ports.kick, target);
            }
            GameState::PLAYING | GameState::READY => {
                let mut place = PoseStamped::default();
                place.header.frame_id = "map".into();
                (place.pose.position.x, place.pose.position.y) = (home.x, home.y);
                place.pose.orientation.w = 1.0;
                ctx.publish(ctx.ports.pose, place);
            }
            _ => ctx.publish(ctx.ports.stop, Empty::default()),
        }
    }
}

impl Module for Footballer {
    type Ports = Ports;

    fn setup(&mut self, setup: &mut Setup<'_, Self>) -> Result<Ports, SetupError> {
        setup.every(Duration::from_millis(400), Self::decide)?;
        setup.subscribe("game_state", |this: &mut Self, game: Received<'_, GameState>, ctx| {
            let is_new = this.game.state != game.state || this.game.is_penalised != game.is_penalised;
            this.game = game.clone();
            if is_new {
                this.decide(ctx);
            }
        })?;
        setup.subscribe("ball", |this: &mut Self, ball: Received<'_, Ball>, _| {
            this.ball = Some(DVec2::new(ball.point.point.x, ball.point.point.y));
        })?;
        setup.subscribe("motions/playing", |this: &mut Self, playing: Received<'_, Text>, _| {
            this.is_busy = !playing.data.is_empty();
        })?;
        setup.subscribe("walk_to/state", |this: &mut Self, state: Received<'_, Text>, ctx| {
            let rested = this.kicked_at.is_none_or(|at| ctx.now() > at + Duration::from_secs(2));
            let may = this.game.state == GameState::PLAYING && !this.game.is_penalised;
            if state.data.starts_with("kick_") && may && !this.is_busy && rested {
                this.kicked_at = Some(ctx.now());
                ctx.publish(ctx.ports.play, Text { data: state.data.clone() });
            }
        })?;
        Ok(Ports {
            kick: setup.publish("walk_to/kick")?,
            pose: setup.publish("walk_to/pose")?,
            stop: setup.publish("walk_to/stop")?,
            play: setup.publish("motions/play")?,
            head: setup.publish("head/mode")?,
        })
    }
}

fn main() -> Result<(), PitchError> {
    let arguments = Arguments::parse();
    let field = Field::named("kid_size_2013").unwrap_or_default();
    let seats = [(Team::Blue, 1), (Team::Blue, 2), (Team::Red, 1), (Team::Red, 2)];
    let options = GameOptions {
        field: field.clone(),
        rules: Rules { half: Duration::from_secs(arguments.half), ..Rules::default() },
        seats: seats.map(|(team, number)| Seat { team, number }).to_vec(),
        seed: arguments.seed,
    };
    let mut game = Game::new(options, |_, core, bus, seed| {
        let mut core = player::with_skills(core, bus, seed.cast_signed())?;
        let field = field.clone();
        let footballer =
            Footballer { field, game: GameState::default(), ball: None, is_busy: false, kicked_at: None };
        core.add("footballer", footballer)?;
        Ok(core)
    })?;
    let started = Instant::now();
    let mut drawn = Duration::ZERO;
    while game.referee().phase() != Phase::Finished {
        let at = game.elapsed();
        for event in game.step()? {
            let [blue, red] = game.referee().score();
            println!("{:>7.1} s  {blue}:{red}  {event}", at.as_secs_f64());
            if event == Event::HalfTime {
                println!();
            }
        }
        if arguments.draw > 0 && at >= drawn {
            drawn = at + Duration::from_secs(arguments.draw);
            let seats = game.seats().to_vec();
            print!("{}", draw(&field, &seats, &game.pitch().snapshot()));
        }
    }
    let ([blue, red], time) = (game.referee().score(), game.elapsed().as_secs_f64());
    let speed = time / started.elapsed().as_secs_f64();
    println!(
        "{blue}:{red} after {time:.0} s, {speed:.1} times real time, hash {:016x}",
        game.pitch().arena().hash()
    );
    Ok(())
}
