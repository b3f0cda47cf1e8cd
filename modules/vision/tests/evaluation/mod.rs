//! Simulated pictures with a known truth: random places of camera, ball and boxes; random light, colours, noise and blur.

use downbeat_football::Field;
use downbeat_physics::camera::{Camera as Rendered, Scene};
use downbeat_physics::{Ball, Block, Floor, WorldFile};
use downbeat_transforms::Isometry;
use downbeat_vision::{Camera, Colours, Detector, Encoding, Picture, View};
use fastrand::Rng;
use glam::{DQuat, DVec2, DVec3};
use std::f64::consts::{FRAC_PI_2, PI};
use std::fmt;

/// Within it balls count, in m.
const RANGE: f64 = 2.5;

/// What was counted.
#[derive(Clone, Debug, Default)]
pub struct Totals {
    /// Balls in pictures, within range.
    pub balls: usize,
    /// Those that were found.
    pub found: usize,
    /// Balls that were reported within range, and those of them that are none.
    pub reported: [usize; 2],
    /// Errors of balls, posts and intersections, as a share of the distance.
    pub errors: Vec<f64>,
    /// Posts and intersections that match the truth, and all that were reported within 4 m.
    pub landmarks: [usize; 2],
}

impl Totals {
    pub fn recall(&self) -> f64 {
        self.found as f64 / self.balls.max(1) as f64
    }

    pub fn precision(&self) -> f64 {
        1.0 - self.reported[1] as f64 / self.reported[0].max(1) as f64
    }

    pub fn median_error(&self) -> f64 {
        let mut sorted = self.errors.clone();
        sorted.sort_by(f64::total_cmp);
        sorted.get(sorted.len() / 2).copied().unwrap_or(f64::INFINITY)
    }
}

impl fmt::Display for Totals {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { balls, found, reported, errors, landmarks } = self;
        let [right, all] = landmarks;
        write!(f, "balls {found} of {balls}, {} of {} reported are none; ", reported[1], reported[0])?;
        write!(f, "recall {:.3}, precision {:.3}; ", self.recall(), self.precision())?;
        write!(f, "median error {:.4} of the distance ({} points); ", self.median_error(), errors.len())?;
        write!(f, "{right} of {all} posts and intersections are right")
    }
}

pub fn detector() -> Detector {
    Detector::new(Field::default(), &Colours::default())
}

/// A camera at this height that looks along x, down and turned by these angles.
pub fn view_at(height: f64, down: f64, roll: f64) -> View {
    let Rendered { width, height: rows, focal } = Rendered::darwin_op();
    let centre = DVec2::new(f64::from(width) - 1.0, f64::from(rows) - 1.0) / 2.0;
    let camera = Camera { size: [width, rows], focal: focal.into(), centre };
    let forward = DQuat::from_rotation_z(-FRAC_PI_2) * DQuat::from_rotation_x(-FRAC_PI_2);
    let rotation = DQuat::from_rotation_y(down) * DQuat::from_rotation_x(roll) * forward;
    View { camera, ground_from_camera: Isometry { translation: DVec3::Z * height, rotation } }
}

/// Uniform.
fn between(random: &mut Rng, from: f64, to: f64) -> f64 {
    from + (to - from) * random.f64()
}

/// About normal, with deviation 1.
fn normal(random: &mut Rng) -> f64 {
    ((0..4).map(|_| random.f64()).sum::<f64>() - 2.0) * 3.0_f64.sqrt()
}

/// One picture, and what is seen in it against what is there.
pub fn evaluate(seed: u64, totals: &mut Totals) {
    let mut random = Rng::with_seed(seed);
    let field = Field::default();
    let (x, y) = (between(&mut random, -4.5, 4.5), between(&mut random, -3.0, 3.0));
    let map_from_ground = Isometry {
        translation: DVec3::new(x, y, 0.0),
        rotation: DQuat::from_rotation_z(between(&mut random, -PI, PI)),
    };
    let view = view_at(
        between(&mut random, 0.38, 0.5),
        between(&mut random, 0.1, 0.75),
        between(&mut random, -0.08, 0.08),
    );
    // Three of four pictures have a ball in front of the robot.
    let (distance, bearing) = (between(&mut random, 0.25, 4.0), between(&mut random, -0.5, 0.5));
    let ball_on_ground = DVec2::from_angle(bearing) * distance;
    let to_map = |point: DVec2| map_from_ground.transform_point(point.extend(0.0)).truncate();
    let has_ball = random.u8(..4) > 0;
    let shift = |random: &mut Rng, of: [u8; 3], most: f64| {
        of.map(|part| (f64::from(part) + between(random, -most, most)).clamp(0.0, 255.0) as u8)
    };
    let ball = Ball {
        position: to_map(ball_on_ground).to_array(),
        colour: shift(&mut random, [230, 90, 20], 18.0),
        ..Ball::default()
    };
    let colours = [[40, 40, 45], [200, 200, 210], [150, 30, 120], [30, 60, 170], [120, 20, 20]];
    let boxes = (0..random.usize(..4))
        .map(|index| {
            let at =
                to_map(DVec2::from_angle(between(&mut random, -0.6, 0.6)) * between(&mut random, 0.6, 5.0));
            Block {
                name: format!("box_{index}"),
                position: [at.x, at.y, 0.225],
                size: [0.12, 0.25, 0.45],
                yaw: between(&mut random, -PI, PI),
                mass: None,
                colour: colours[random.usize(..colours.len())],
            }
        })
        .collect();
    let colour = shift(&mut random, [40, 130, 50], 18.0);
    let mut world = WorldFile {
        floor: Floor { colour, ..Floor::default() },
        field: Some(downbeat_physics::Field::default()),
        boxes,
        ..WorldFile::default()
    };
    let render = |world: &WorldFile| {
        let world_from_camera = map_from_ground * view.ground_from_camera;
        Scene::new(world, |_| None).render(&Rendered::darwin_op(), &world_from_camera)
    };
    let without = render(&world);
    world.ball = has_ball.then_some(ball);
    let mut data = render(&world);
    // How much of the ball is in the picture, and not behind a box.
    let seen_pixels =
        data.chunks(3).zip(without.chunks(3)).filter(|(one, other)| one != other).count() as f64;
    let radius = field.ball.diameter / 2.0;
    let expected = PI * view.width_at(ball_on_ground.extend(radius), radius).powi(2);
    let share = seen_pixels / expected;
    disturb(&mut data, &mut random);

    let picture = Picture::new([320, 240], 960, Encoding::Rgb8, &data).unwrap();
    // The pose of the camera is known to a fifth of a degree.
    let mut believed = view;
    let [pitch, roll] = [normal(&mut random), normal(&mut random)].map(|share| share * 0.0035);
    believed.ground_from_camera.rotation =
        DQuat::from_rotation_y(pitch) * DQuat::from_rotation_x(roll) * believed.ground_from_camera.rotation;
    let seen = detector().see(&picture, &believed);

    let is_right = |place: DVec2| has_ball && place.distance(ball_on_ground) < 0.1 + 0.25 * distance;
    let is_visible = has_ball && share > 0.6 && distance <= RANGE;
    if is_visible {
        totals.balls += 1;
        if let Some(found) = seen.balls.iter().find(|found| is_right(found.place)) {
            totals.found += 1;
            totals.errors.push(found.place.distance(ball_on_ground) / distance);
        } else if std::env::var_os("VISION_MISSES").is_some() {
            println!("{seed}: missed at {distance:.2} m, {share:.2} of it visible: {:?}", seen.balls);
        }
    }
    for found in seen.balls.iter().filter(|found| found.place.length() <= RANGE) {
        totals.reported[0] += 1;
        totals.reported[1] += usize::from(!is_right(found.place));
    }
    let landmarks = seen.posts.iter().map(|post| (post.place, None));
    let landmarks = landmarks.chain(seen.intersections.iter().map(|one| (one.place, Some(one.kind))));
    for (place, kind) in landmarks.filter(|(place, _)| place.length() < 4.0) {
        let truths: Vec<DVec2> = match kind {
            None => field.posts().to_vec(),
            Some(kind) => {
                field.intersections().iter().filter(|one| one.kind == kind).map(|one| one.position).collect()
            }
        };
        let error = truths.iter().map(|truth| truth.distance(to_map(place))).fold(f64::INFINITY, f64::min);
        let is_right = error < 0.15 + 0.15 * place.length();
        totals.landmarks[0] += usize::from(is_right);
        totals.landmarks[1] += 1;
        if is_right {
            totals.errors.push(error / place.length());
        }
    }
}

/// Light, colour cast, blur and noise.
fn disturb(data: &mut [u8], random: &mut Rng) {
    let light = between(random, 0.5, 1.15);
    let cast = [between(random, 0.92, 1.08), 1.0, between(random, 0.92, 1.08)];
    let noise = between(random, 0.0, 7.0);
    if random.bool() {
        // Three by three, the borders as they are.
        let before = data.to_vec();
        for row in 1..239_usize {
            for column in 1..319_usize {
                for part in 0..3 {
                    let at = |row: usize, column: usize| u32::from(before[(row * 320 + column) * 3 + part]);
                    let sum: u32 = (0..9).map(|index| at(row + index / 3 - 1, column + index % 3 - 1)).sum();
                    data[(row * 320 + column) * 3 + part] = (sum / 9) as u8;
                }
            }
        }
    }
    for pixel in data.chunks_exact_mut(3) {
        for (part, cast) in pixel.iter_mut().zip(cast) {
            *part = (f64::from(*part) * light * cast + noise * normal(random)).clamp(0.0, 255.0) as u8;
        }
    }
}
