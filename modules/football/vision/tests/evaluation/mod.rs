//! Simulated pictures with a known truth: random places of camera, ball and boxes; random light, colours,
//! noise and blur.

use downbeat_football::Field;
use downbeat_physics::camera::{Camera as Rendered, Scene};
use downbeat_physics::{ArenaOptions, Ball, Block, Floor, Model, Shape, Start, WorldFile};
use downbeat_transforms::Isometry;
use downbeat_vision::{Camera, Colours, Detector, Encoding, Picture, Seen, TeamColour, View};
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
    /// Of other robots.
    pub robots: Robots,
}

/// What was counted of other robots that stand and of others that lie, in the picture and not hidden, within
/// [`ROBOT_RANGE`].
#[derive(Clone, Debug, Default)]
pub struct Robots {
    /// Those that stand, and those of them that were found; the same of those that lie.
    pub standing: [usize; 2],
    pub lying: [usize; 2],
    /// How often it was said rightly whether one stands or lies, of all that were found.
    pub upright: usize,
    /// Robots that were found: with the right team, with one that they are not of, with none although they
    /// are of one.
    pub teams: [usize; 3],
    /// Robots that were reported, and those of them where neither a robot nor a box as large as one is.
    pub reported: [usize; 2],
    /// Errors as a share of the distance.
    pub errors: Vec<f64>,
}

/// Within it robots count, in m.
const ROBOT_RANGE: f64 = 3.0;

impl Robots {
    /// Of those that stand.
    pub fn recall(&self) -> f64 {
        self.standing[1] as f64 / self.standing[0].max(1) as f64
    }

    pub fn precision(&self) -> f64 {
        1.0 - self.reported[1] as f64 / self.reported[0].max(1) as f64
    }

    /// How often the team is right where one is reported.
    pub fn team_precision(&self) -> f64 {
        let [right, wrong, _] = self.teams;
        right as f64 / (right + wrong).max(1) as f64
    }
}

impl fmt::Display for Robots {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { standing, lying, upright, teams: [right, wrong, unknown], reported, errors } = self;
        write!(
            f,
            "robots that stand {} of {}, that lie {} of {}, ",
            standing[1], standing[0], lying[1], lying[0]
        )?;
        write!(f, "{} of {} reported are none; ", reported[1], reported[0])?;
        write!(f, "recall {:.3}, precision {:.3}, ", self.recall(), self.precision())?;
        write!(f, "{upright} of {} are rightly said to stand or lie; ", standing[1] + lying[1])?;
        write!(
            f,
            "team right {right}, wrong {wrong} ({:.3} right), unknown {unknown}; ",
            self.team_precision()
        )?;
        write!(f, "median error {:.3} of the distance", median(errors))
    }
}

fn median(of: &[f64]) -> f64 {
    let mut sorted = of.to_vec();
    sorted.sort_by(f64::total_cmp);
    sorted.get(sorted.len() / 2).copied().unwrap_or(f64::INFINITY)
}

impl Totals {
    pub fn recall(&self) -> f64 {
        self.found as f64 / self.balls.max(1) as f64
    }

    pub fn precision(&self) -> f64 {
        1.0 - self.reported[1] as f64 / self.reported[0].max(1) as f64
    }

    pub fn median_error(&self) -> f64 {
        median(&self.errors)
    }
}

impl fmt::Display for Totals {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { balls, found, reported, errors, landmarks, robots } = self;
        let [right, all] = landmarks;
        write!(f, "balls {found} of {balls}, {} of {} reported are none; ", reported[1], reported[0])?;
        write!(f, "recall {:.3}, precision {:.3}; ", self.recall(), self.precision())?;
        write!(f, "median error {:.4} of the distance ({} points); ", self.median_error(), errors.len())?;
        write!(f, "{right} of {all} posts and intersections are right; {robots}")
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
    let boxes: Vec<Block> = (0..random.usize(..4))
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
    // Of another sequence, so that the rest of the picture is as it would be without them.
    let others = others(&mut Rng::with_seed(!seed), &map_from_ground);
    let render = |world: &WorldFile, others: &mut dyn Iterator<Item = &Other>| {
        let world_from_camera = map_from_ground * view.ground_from_camera;
        let scene = others.fold(Scene::new(world, |_| None), |scene, other| other.added_to(scene));
        scene.render(&Rendered::darwin_op(), &world_from_camera)
    };
    let without = render(&world, &mut others.iter());
    world.ball = has_ball.then_some(ball);
    let mut data = render(&world, &mut others.iter());
    let boxes: Vec<DVec2> =
        world.boxes.iter().map(|block| DVec2::new(block.position[0], block.position[1])).collect();
    let bare = WorldFile { ball: None, boxes: Vec::new(), ..world.clone() };
    let nobody = render(&bare, &mut [].iter());
    // Of each: whether it is in the picture and nothing hides it.
    let are_visible: Vec<bool> = others
        .iter()
        .enumerate()
        .map(|(index, other)| {
            let alone = render(&bare, &mut [other].into_iter());
            let rest = render(
                &world,
                &mut others.iter().enumerate().filter(|(at, _)| *at != index).map(|(_, other)| other),
            );
            let changed = |one: &[u8], other: &[u8]| -> Vec<[usize; 2]> {
                let pixels = one.chunks(3).zip(other.chunks(3)).enumerate();
                pixels
                    .filter(|(_, (one, other))| one != other)
                    .map(|(pixel, _)| [pixel % 320, pixel / 320])
                    .collect()
            };
            let (own, seen) = (changed(&alone, &nobody), changed(&data, &rest));
            let is_inside = own.iter().all(|[column, row]| (3..317).contains(column) && *row < 237);
            // Of one that stands, also the trunk is in the picture.
            let rows = own.iter().map(|[_, row]| *row);
            let height = rows.clone().max().unwrap_or_default() - rows.min().unwrap_or_default();
            let at = map_from_ground.inverse().transform_point(other.map_from_root.translation).truncate();
            let least = if other.lies {
                0.0
            } else {
                0.6 * view.height_at(at, field.robot.height).unwrap_or_default()
            };
            let is_large = own.len() >= 30 && height as f64 >= least;
            is_inside && is_large && seen.len() as f64 >= 0.9 * own.len() as f64
        })
        .collect();
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

    count_robots(&seen, &others, &are_visible, &boxes, &map_from_ground, &mut totals.robots);
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

/// Another robot.
pub struct Other {
    model: Model,
    /// Of its bodies, in the first one.
    poses: Vec<Isometry>,
    map_from_root: Isometry,
    colour: [u8; 3],
    team: Option<TeamColour>,
    lies: bool,
}

/// Up to three robots in front of the camera; one of four lies on its front, its back or a side.
fn others(random: &mut Rng, map_from_ground: &Isometry) -> Vec<Other> {
    let model = ArenaOptions::darwin_op([]).model;
    (0..random.usize(..4))
        .map(|_| {
            let poses = standing(&model, || between(random, -0.15, 0.15));
            let at = DVec2::from_angle(between(random, -0.6, 0.6)) * between(random, 0.5, 4.0);
            let lies = random.u8(..4) == 0;
            let turn = DQuat::from_rotation_z(between(random, -PI, PI));
            let tilt = match (lies, random.u8(..3)) {
                (false, _) => DQuat::from_rotation_y(between(random, 0.0, 0.25)),
                (true, 0) => DQuat::from_rotation_y(FRAC_PI_2),
                (true, 1) => DQuat::from_rotation_y(-FRAC_PI_2),
                (true, _) => DQuat::from_rotation_x(FRAC_PI_2),
            };
            let mut map_from_root =
                *map_from_ground * Isometry { translation: at.extend(0.0), rotation: turn * tilt };
            map_from_root.translation.z = -lowest(&model, &poses, &map_from_root);
            let (team, colour) = match random.u8(..7) {
                0..3 => (Some(TeamColour::Blue), [30, 60, 200]),
                3..6 => (Some(TeamColour::Red), [190, 30, 40]),
                _ => (None, [90, 90, 90]),
            };
            let colour = colour.map(|part: u8| (f64::from(part) + between(random, -18.0, 18.0)) as u8);
            Other { model: model.clone(), poses, map_from_root, colour, team, lies }
        })
        .collect()
}

/// The poses of the bodies of a robot that stands, each joint off by some angle.
fn standing(model: &Model, mut off: impl FnMut() -> f64) -> Vec<Isometry> {
    let stand = Start::walking_ready().angles;
    let angle_of =
        |name: &str| stand.iter().find(|(joint, _)| joint == name).map_or(0.0, |(_, angle)| *angle);
    let joints = model.bodies.iter().map(|body| body.joint.as_ref());
    let angles: Vec<f64> =
        joints.map(|joint| joint.map_or(0.0, |joint| angle_of(&joint.name) + off())).collect();
    model.poses(&angles)
}

/// How far below the origin of its root a robot ends.
fn lowest(model: &Model, poses: &[Isometry], map_from_root: &Isometry) -> f64 {
    let of_shapes = model.bodies.iter().zip(poses).flat_map(|(body, pose)| {
        body.shapes.iter().map(move |(body_from_shape, shape)| {
            let at = *map_from_root * *pose * *body_from_shape;
            let [x, y, z] = [DVec3::X, DVec3::Y, DVec3::Z].map(|axis| (at.rotation * axis).z.abs());
            let reach = match *shape {
                Shape::Box([along, across, up]) => (x * along + y * across + z * up) / 2.0,
                Shape::Cylinder { radius, length } => z * length / 2.0 + libm::hypot(x, y) * radius,
                Shape::Sphere(radius) => radius,
            };
            at.translation.z - reach
        })
    });
    of_shapes.fold(f64::INFINITY, f64::min)
}

impl Other {
    fn added_to(&self, scene: Scene) -> Scene {
        scene.with_robot(&self.model, |body| Some(self.map_from_root * *self.poses.get(body)?), self.colour)
    }

    /// The middle of its trunk on the floor.
    fn place(&self) -> DVec2 {
        self.map_from_root.translation.truncate()
    }
}

fn count_robots(
    seen: &Seen,
    others: &[Other],
    are_visible: &[bool],
    boxes: &[DVec2],
    map_from_ground: &Isometry,
    totals: &mut Robots,
) {
    let here = map_from_ground.translation.truncate();
    let in_map = |place: DVec2| map_from_ground.transform_point(place.extend(0.0)).truncate();
    let is_at =
        |place: DVec2, truth: DVec2| in_map(place).distance(truth) < 0.25 + 0.15 * truth.distance(here);
    for (other, _) in others.iter().zip(are_visible).filter(|(_, is_visible)| **is_visible) {
        let distance = other.place().distance(here);
        if distance > ROBOT_RANGE {
            continue;
        }
        let counts = if other.lies { &mut totals.lying } else { &mut totals.standing };
        counts[0] += 1;
        let nearest =
            seen.robots.iter().filter(|robot| is_at(robot.place, other.place())).min_by(|one, two| {
                let far = |place: DVec2| in_map(place).distance(other.place());
                far(one.place).total_cmp(&far(two.place))
            });
        let Some(found) = nearest else { continue };
        counts[1] += 1;
        totals.upright += usize::from(found.is_fallen == other.lies);
        totals.errors.push(in_map(found.place).distance(other.place()) / distance);
        match (other.team, found.team) {
            (Some(team), Some(found)) if team == found => totals.teams[0] += 1,
            (_, Some(_)) => totals.teams[1] += 1,
            (Some(_), None) => totals.teams[2] += 1,
            (None, None) => {}
        }
    }
    for found in seen.robots.iter().filter(|robot| robot.place.length() <= ROBOT_RANGE) {
        let is_there =
            others.iter().map(Other::place).chain(boxes.iter().copied()).any(|at| is_at(found.place, at));
        totals.reported[0] += 1;
        totals.reported[1] += usize::from(!is_there);
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

/// Of robots so near that the picture holds but a part of them.
#[derive(Clone, Debug, Default)]
pub struct Near {
    /// Robots that cover more than a twentieth of the picture, and those of them that were found.
    pub robots: usize,
    pub found: usize,
    /// Of those that were found: with the right team, with the wrong one, and those that were said to lie.
    pub teams: [usize; 2],
    pub lying: usize,
    /// How far off they were, in m.
    pub errors: Vec<f64>,
    /// Pictures without another robot, and robots that were reported there or elsewhere.
    pub empty: usize,
    pub wrong: usize,
}

impl fmt::Display for Near {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { robots, found, teams, lying, errors, empty, wrong } = self;
        write!(
            f,
            "near robots {found} of {robots}, {lying} of them said to lie, team right {}, wrong {}; ",
            teams[0], teams[1]
        )?;
        write!(
            f,
            "median error {:.3} m; {wrong} robots where none is ({empty} pictures without one)",
            median(errors)
        )
    }
}

/// One picture of a robot that looks at the ball at its feet, three of four times with another robot there.
pub fn evaluate_near(seed: u64, near: &mut Near) {
    let mut random = Rng::with_seed(seed);
    let place = DVec3::new(between(&mut random, -3.5, 3.5), between(&mut random, -2.0, 2.0), 0.0);
    let map_from_ground =
        Isometry { translation: place, rotation: DQuat::from_rotation_z(between(&mut random, -PI, PI)) };
    let ball_at = DVec2::from_angle(between(&mut random, -0.3, 0.3)) * between(&mut random, 0.12, 0.5);
    let height = between(&mut random, 0.38, 0.45);
    let down = libm::atan2(height - 0.05, ball_at.x) + between(&mut random, -0.1, 0.1);
    let view = view_at(height, down, between(&mut random, -0.08, 0.08));
    let to_map = |point: DVec2| map_from_ground.transform_point(point.extend(0.0)).truncate();
    let ball = Ball { position: to_map(ball_at).to_array(), ..Ball::default() };
    let world = WorldFile {
        floor: Floor { colour: [40, 130, 50], ..Floor::default() },
        field: Some(downbeat_physics::Field::default()),
        ball: Some(ball),
        ..WorldFile::default()
    };
    let other = (random.u8(..4) > 0).then(|| {
        let at = DVec2::from_angle(between(&mut random, -0.7, 0.7)) * between(&mut random, 0.2, 0.6);
        let turn = DQuat::from_rotation_z(between(&mut random, -PI, PI));
        let model = ArenaOptions::darwin_op([]).model;
        let poses = standing(&model, || 0.0);
        let mut map_from_root = map_from_ground * Isometry { translation: at.extend(0.0), rotation: turn };
        map_from_root.translation.z = -lowest(&model, &poses, &map_from_root);
        let (team, colour) =
            if random.bool() { (TeamColour::Blue, [30, 60, 200]) } else { (TeamColour::Red, [190, 30, 40]) };
        Other { model, poses, map_from_root, colour, team: Some(team), lies: false }
    });
    let render = |others: &mut dyn Iterator<Item = &Other>| {
        let scene = others.fold(Scene::new(&world, |_| None), |scene, other| other.added_to(scene));
        scene.render(&Rendered::darwin_op(), &(map_from_ground * view.ground_from_camera))
    };
    let mut data = render(&mut other.iter());
    let without = render(&mut [].iter());
    let covered = data.chunks(3).zip(without.chunks(3)).filter(|(one, other)| one != other).count();
    disturb(&mut data, &mut random);
    let picture = Picture::new([320, 240], 960, Encoding::Rgb8, &data).unwrap();
    let seen = detector().see(&picture, &view);
    let truth = other
        .as_ref()
        .map(|other| map_from_ground.inverse().transform_point(other.map_from_root.translation).truncate());
    let is_there = |place: DVec2| truth.is_some_and(|at| at.distance(place) < 0.2);
    near.empty += usize::from(truth.is_none());
    near.wrong += seen.robots.iter().filter(|robot| !is_there(robot.place)).count();
    let Some((other, at)) = other.zip(truth).filter(|_| covered > 320 * 240 / 20) else { return };
    near.robots += 1;
    let found = seen.robots.iter().find(|robot| is_there(robot.place));
    let Some(found) = found else { return };
    near.found += 1;
    near.lying += usize::from(found.is_fallen);
    near.errors.push(found.place.distance(at));
    if let (Some(own), Some(seen)) = (other.team, found.team) {
        near.teams[usize::from(own != seen)] += 1;
    }
}
