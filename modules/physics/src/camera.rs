//! What a camera sees of a world: floor, lines, posts, boxes and ball, by casting a ray through each pixel.
//!
//! Pictures are simulated: no noise, no distortion, no blur, no shadows, and the robot itself is not in them.
//! Only additions, multiplications, divisions and square roots, so that the same world gives the same bytes
//! on every machine.

use crate::model::{Model, Shape};
use crate::scenery::{Field, WorldFile};
use crate::spawned::{Spawned, SpawnedShape};
use downbeat_msgs::sensor_msgs::msg::CameraInfo;
use downbeat_msgs::std_msgs::msg::Header;
use downbeat_transforms::Isometry;
use glam::{Vec2, Vec3};
use std::ops::Range;

/// A pinhole camera without distortion. Lengths in pixels.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Camera {
    /// Columns.
    pub width: u32,
    /// Rows.
    pub height: u32,
    /// Focal lengths, horizontal and vertical.
    pub focal: [f64; 2],
}

impl Camera {
    /// The Darwin OP's Logitech C905 at 320 x 240, with the 58 and 46 degrees of the manufacturer's
    /// framework.
    #[must_use]
    pub const fn darwin_op() -> Self {
        Self { width: 320, height: 240, focal: [288.6, 282.7] }
    }

    /// Its calibration.
    #[must_use]
    pub fn info(&self, header: Header) -> CameraInfo {
        let Self { width, height, focal: [fx, fy] } = *self;
        let (cx, cy) = ((f64::from(width) - 1.0) / 2.0, (f64::from(height) - 1.0) / 2.0);
        CameraInfo {
            header,
            height,
            width,
            distortion_model: "plumb_bob".to_owned(),
            d: vec![0.0; 5],
            k: [fx, 0.0, cx, 0.0, fy, cy, 0.0, 0.0, 1.0],
            r: [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0],
            p: [fx, 0.0, cx, 0.0, 0.0, fy, cy, 0.0, 0.0, 0.0, 1.0, 0.0],
            ..CameraInfo::default()
        }
    }
}

/// What can be seen.
#[derive(Clone, Debug)]
pub struct Scene {
    floor: Vec3,
    field: Option<Field>,
    bodies: Vec<Visible>,
}

#[derive(Clone, Debug)]
struct Visible {
    centre: Vec3,
    /// The axes of the body in the world.
    axes: [Vec3; 3],
    shape: VisibleShape,
    colour: Vec3,
    /// Of a sphere around it.
    radius: f32,
}

#[derive(Clone, Copy, Debug)]
enum VisibleShape {
    Ball,
    /// Half edges.
    Box(Vec3),
    /// Along its z axis: radius and half height.
    Post(f32, f32),
}

const SKY: Vec3 = Vec3::new(150.0, 175.0, 200.0);
const LINE: Vec3 = Vec3::new(235.0, 235.0, 235.0);
/// Of a robot, but for its trunk.
const LIMB: Vec3 = Vec3::new(60.0, 60.0, 65.0);
/// Beyond this the floor fades into the sky, in m.
const HORIZON: f32 = 60.0;
/// How many pixels of a row are looked at together for lines.
const RUN: usize = 16;

impl Scene {
    /// The world, with the boxes and the ball at these poses; at those of the file if they are not named.
    #[must_use]
    pub fn new(file: &WorldFile, pose_of: impl Fn(&str) -> Option<Isometry>) -> Self {
        let mut bodies = Vec::new();
        if let Some(field) = &file.field {
            let (radius, half) = (field.post_diameter as f32 / 2.0, field.goal_height as f32 / 2.0);
            bodies.extend(file.posts().map(|(_, at)| Visible {
                centre: Vec3::new(at.x as f32, at.y as f32, half),
                axes: [Vec3::X, Vec3::Y, Vec3::Z],
                shape: VisibleShape::Post(radius, half),
                colour: colour(field.post_colour),
                radius: (radius * radius + half * half).sqrt(),
            }));
        }
        for block in &file.boxes {
            let at = pose_of(&block.name).unwrap_or_else(|| Isometry {
                translation: block.position.into(),
                rotation: glam::DQuat::from_rotation_z(block.yaw),
            });
            let half = glam::DVec3::from(block.size).as_vec3() / 2.0;
            bodies.push(Visible::new(&at, VisibleShape::Box(half), colour(block.colour), half.length()));
        }
        if let Some(ball) = &file.ball {
            let [x, y] = ball.position;
            let at = pose_of("ball").unwrap_or_else(|| Isometry::from_translation(x, y, ball.radius));
            bodies.push(Visible::new(&at, VisibleShape::Ball, colour(ball.colour), ball.radius as f32));
        }
        Self { floor: colour(file.floor.colour), field: file.field, bodies }
    }

    /// Adds what was spawned, at these poses; what has no pose is left out.
    #[must_use]
    pub fn with_spawned(mut self, spawned: &[Spawned], pose_of: impl Fn(&str) -> Option<Isometry>) -> Self {
        self.bodies.extend(spawned.iter().filter_map(|spawned| {
            let (shape, radius) = match spawned.shape {
                SpawnedShape::Ball { radius, .. } => (VisibleShape::Ball, radius as f32),
                SpawnedShape::Box { size } => {
                    let half = glam::DVec3::from(size).as_vec3() / 2.0;
                    (VisibleShape::Box(half), half.length())
                }
                SpawnedShape::Post { diameter, height } => {
                    let (radius, half) = (diameter as f32 / 2.0, height as f32 / 2.0);
                    (VisibleShape::Post(radius, half), (radius * radius + half * half).sqrt())
                }
            };
            Some(Visible::new(&pose_of(&spawned.name)?, shape, colour(spawned.colour), radius))
        }));
        self
    }

    /// Adds a robot whose bodies are at these poses, dark with a trunk of this colour.
    #[must_use]
    pub fn with_robot(
        mut self,
        model: &Model,
        pose_of: impl Fn(usize) -> Option<Isometry>,
        trunk: [u8; 3],
    ) -> Self {
        for (index, body) in model.bodies.iter().enumerate() {
            let Some(world_from_body) = pose_of(index) else { continue };
            let colour = if index == 0 { colour(trunk) } else { LIMB };
            self.bodies.extend(body.shapes.iter().map(|(body_from_shape, shape)| {
                let (shape, radius) = match *shape {
                    Shape::Box(edges) => {
                        let half = glam::DVec3::from(edges).as_vec3() / 2.0;
                        (VisibleShape::Box(half), half.length())
                    }
                    Shape::Cylinder { radius, length } => {
                        let (radius, half) = (radius as f32, length as f32 / 2.0);
                        (VisibleShape::Post(radius, half), (radius * radius + half * half).sqrt())
                    }
                    Shape::Sphere(radius) => (VisibleShape::Ball, radius as f32),
                };
                Visible::new(&(world_from_body * *body_from_shape), shape, colour, radius)
            }));
        }
        self
    }

    /// A picture, rgb8, row by row from the top. `world_from_camera` is the pose of the optical frame: z
    /// forward, x to the right, y down.
    #[must_use]
    pub fn render(&self, camera: &Camera, world_from_camera: &Isometry) -> Vec<u8> {
        let view = View::new(camera, world_from_camera);
        let pixels = view.width * view.height;
        let (mut colours, mut depths) = (vec![SKY; pixels], vec![f32::INFINITY; pixels]);
        for row in 0..view.height {
            for first in (0..view.width).step_by(RUN) {
                let columns = first..(first + RUN).min(view.width);
                let has_lines = self.has_lines(&view, row, &columns);
                for column in columns {
                    let Some((point, depth)) = view.on_floor(column, row) else { continue };
                    let index = row * view.width + column;
                    depths[index] = depth;
                    colours[index] = self.floor_at(point, depth, view.pixel, has_lines);
                }
            }
        }
        for body in &self.bodies {
            let Some([left, right, top, bottom]) = view.frame_of(body) else { continue };
            for row in top..bottom {
                for column in left..right {
                    let index = row * view.width + column;
                    let found = body.hit(view.eye, view.ray(column, row));
                    if let Some((depth, normal)) = found.filter(|(depth, _)| *depth < depths[index]) {
                        depths[index] = depth;
                        // Light from above.
                        colours[index] = body.colour * (0.7 + 0.3 * normal.z);
                    }
                }
            }
        }
        let mut bytes = Vec::with_capacity(pixels * 3);
        for colour in colours {
            bytes.extend(colour.to_array().map(|part| part.clamp(0.0, 255.0) as u8));
        }
        bytes
    }

    /// Whether a line may be in these columns of a row. They show a straight stretch of the floor, none of
    /// whose points is nearer to a line than its middle is, less half of its length.
    fn has_lines(&self, view: &View, row: usize, columns: &Range<usize>) -> bool {
        let Some(field) = &self.field else { return false };
        let ends = [columns.start, columns.end - 1].map(|column| view.on_floor(column, row));
        let [Some((one, near)), Some((other, far))] = ends else { return true };
        let (half_length, depth) = (one.distance(other) / 2.0, near.max(far));
        let middle = (one + other) / 2.0;
        let clear = field.line_width as f32 / 2.0 + half_length + depth * view.pixel;
        distance_to_lines(field, Vec2::new(middle.x, middle.y).abs()) < 1.01 * clear + 1e-3
    }

    fn floor_at(&self, point: Vec3, depth: f32, pixel: f32, has_lines: bool) -> Vec3 {
        let far = (depth / HORIZON).min(1.0);
        let mut colour = self.floor;
        if let Some(field) = self.field.as_ref().filter(|_| has_lines) {
            let share = line_share(field, Vec2::new(point.x, point.y).abs(), depth * pixel);
            colour += (LINE - colour) * share;
        }
        colour + (SKY - colour) * far * far
    }
}

/// The share of a pixel of this size, in m, that lines cover, at this point of the first quadrant: the field
/// is symmetric.
fn line_share(field: &Field, at: Vec2, pixel: f32) -> f32 {
    let half_line = field.line_width as f32 / 2.0;
    let (length, width) = (field.length as f32 / 2.0, field.width as f32 / 2.0);
    if at.x > length + pixel || at.y > width + pixel {
        return 0.0;
    }
    let nearest = distance_to_lines(field, at);
    ((half_line - nearest) / pixel.max(1e-6) + 0.5).clamp(0.0, 1.0)
}

/// How far the middle of the nearest line is from a point of the first quadrant, in m.
fn distance_to_lines(field: &Field, at: Vec2) -> f32 {
    let half_line = field.line_width as f32 / 2.0;
    let (length, width) = (field.length as f32 / 2.0, field.width as f32 / 2.0);
    let area = [field.goal_area[0] as f32, field.goal_area[1] as f32 / 2.0];
    let mark = Vec2::new(length - field.penalty_mark as f32, 0.0);
    // Distances from the middles of lines; each is limited along its line.
    let along = |distance: f32, beyond: f32| distance.abs().max(beyond + half_line);
    let distances = [
        along(at.y - width + half_line, at.x - length),
        along(at.x - length + half_line, at.y - width),
        along(at.x, at.y - width),
        along(at.x - length + area[0] - half_line, at.y - area[1]),
        along(at.y - area[1] + half_line, length - area[0] - at.x),
        (at.length() - field.circle_diameter as f32 / 2.0).abs(),
        (at - mark).length() - half_line,
        at.length() - half_line,
    ];
    distances.into_iter().fold(f32::INFINITY, f32::min)
}

/// A camera in the world.
struct View {
    width: usize,
    height: usize,
    eye: Vec3,
    /// The axes of the optical frame in the world; the first two for one pixel.
    right: Vec3,
    down: Vec3,
    forward: Vec3,
    /// The size of a pixel at a distance of 1.
    pixel: f32,
    focal: Vec2,
}

impl View {
    fn new(camera: &Camera, world_from_camera: &Isometry) -> Self {
        let axis = |axis: glam::DVec3| (world_from_camera.rotation * axis).as_vec3();
        let focal = Vec2::new(camera.focal[0] as f32, camera.focal[1] as f32);
        Self {
            width: camera.width as usize,
            height: camera.height as usize,
            eye: world_from_camera.translation.as_vec3(),
            right: axis(glam::DVec3::X) / focal.x,
            down: axis(glam::DVec3::Y) / focal.y,
            forward: axis(glam::DVec3::Z),
            pixel: 1.0 / focal.x,
            focal,
        }
    }

    fn centre(&self) -> Vec2 {
        Vec2::new(self.width as f32 - 1.0, self.height as f32 - 1.0) / 2.0
    }

    /// The direction through a pixel, of length 1 along the optical axis.
    fn ray(&self, column: usize, row: usize) -> Vec3 {
        let centre = self.centre();
        self.forward + self.right * (column as f32 - centre.x) + self.down * (row as f32 - centre.y)
    }

    /// The point of the floor that a pixel shows, and where it is on its ray; `None` above the horizon.
    fn on_floor(&self, column: usize, row: usize) -> Option<(Vec3, f32)> {
        let ray = self.ray(column, row);
        let depth = -self.eye.z / ray.z;
        (ray.z < 0.0).then(|| (self.eye + ray * depth, depth))
    }

    /// The columns and rows in which a body can be; `None` if it is behind the camera.
    fn frame_of(&self, body: &Visible) -> Option<[usize; 4]> {
        let to = body.centre - self.eye;
        let depth = to.dot(self.forward);
        if depth < -body.radius {
            return None;
        }
        let all = [0, self.width, 0, self.height];
        let nearest = depth - body.radius;
        if nearest < 0.01 {
            return Some(all);
        }
        let (x, y) = (
            to.dot(self.right) * self.focal.x * self.focal.x,
            to.dot(self.down) * self.focal.y * self.focal.y,
        );
        let reach = |at: f32, focal: f32| {
            let sides = [at - focal * body.radius, at + focal * body.radius];
            let near = sides.map(|side| side / nearest);
            let far = sides.map(|side| side / (depth + body.radius));
            [near[0].min(far[0]) - 1.0, near[1].max(far[1]) + 2.0]
        };
        let centre = self.centre();
        let within = |value: f32, limit: usize| value.clamp(0.0, limit as f32) as usize;
        let ([left, right], [top, bottom]) = (reach(x, self.focal.x), reach(y, self.focal.y));
        Some([
            within(left + centre.x, self.width),
            within(right + centre.x, self.width),
            within(top + centre.y, self.height),
            within(bottom + centre.y, self.height),
        ])
    }
}

impl Visible {
    fn new(at: &Isometry, shape: VisibleShape, colour: Vec3, radius: f32) -> Self {
        let axes =
            [glam::DVec3::X, glam::DVec3::Y, glam::DVec3::Z].map(|axis| (at.rotation * axis).as_vec3());
        Self { centre: at.translation.as_vec3(), axes, shape, colour, radius }
    }

    /// Where a ray meets it, as a multiple of the ray, and the normal there.
    fn hit(&self, eye: Vec3, ray: Vec3) -> Option<(f32, Vec3)> {
        let from = eye - self.centre;
        match self.shape {
            VisibleShape::Ball => {
                let depth =
                    nearest_root(ray.dot(ray), from.dot(ray), from.dot(from) - self.radius * self.radius)?;
                Some((depth, (from + ray * depth) / self.radius))
            }
            VisibleShape::Post(radius, half) => {
                let [x, y, z] = self.axes;
                let across = |of: Vec3| Vec2::new(of.dot(x), of.dot(y));
                let (a, b) = (across(ray), across(from));
                let depth = nearest_root(a.dot(a), a.dot(b), b.dot(b) - radius * radius)?;
                let at = from + ray * depth;
                let normal = (x * at.dot(x) + y * at.dot(y)) / radius;
                (at.dot(z).abs() <= half).then_some((depth, normal))
            }
            VisibleShape::Box(half) => {
                let (mut enter, mut leave, mut normal) = (0.0_f32, f32::INFINITY, Vec3::ZERO);
                for (axis, half) in self.axes.into_iter().zip(half.to_array()) {
                    let (at, step) = (from.dot(axis), ray.dot(axis));
                    if step.abs() < 1e-9 {
                        if at.abs() > half {
                            return None;
                        }
                        continue;
                    }
                    let (near, far) =
                        ((-half * step.signum() - at) / step, (half * step.signum() - at) / step);
                    if near > enter {
                        (enter, normal) = (near, axis * -step.signum());
                    }
                    leave = leave.min(far);
                }
                (enter > 0.0 && enter < leave).then_some((enter, normal))
            }
        }
    }
}

/// The smaller root of `a t^2 + 2 b t + c`, if it is positive.
fn nearest_root(a: f32, b: f32, c: f32) -> Option<f32> {
    let inside = b * b - a * c;
    if inside < 0.0 || a <= 0.0 {
        return None;
    }
    let root = (-b - inside.sqrt()) / a;
    (root > 0.0).then_some(root)
}

fn colour(of: [u8; 3]) -> Vec3 {
    Vec3::from(of.map(f32::from))
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;
    use crate::scenery::{Ball, Block};
    use glam::{DQuat, DVec3};
    use std::f64::consts::{FRAC_PI_2, PI};

    const CAMERA: Camera = Camera::darwin_op();

    /// A camera at this height that looks along x, downwards by this angle.
    fn looking(height: f64, down: f64) -> Isometry {
        let forward = DQuat::from_rotation_z(-FRAC_PI_2) * DQuat::from_rotation_x(-FRAC_PI_2);
        Isometry { translation: DVec3::Z * height, rotation: DQuat::from_rotation_y(down) * forward }
    }

    fn pixel(picture: &[u8], column: usize, row: usize) -> [u8; 3] {
        let at = (row * 320 + column) * 3;
        picture[at..at + 3].try_into().unwrap()
    }

    fn render(file: &WorldFile, from: &Isometry) -> Vec<u8> {
        Scene::new(file, |_| None).render(&CAMERA, from)
    }

    #[test]
    fn the_sky_is_above_the_horizon_and_the_floor_below() {
        let picture = render(&WorldFile::default(), &looking(0.5, 0.0));
        assert_eq!(picture.len(), 320 * 240 * 3);
        assert_eq!(pixel(&picture, 160, 10), [150, 175, 200]);
        assert_eq!(pixel(&picture, 160, 239), [40, 130, 50]);
    }

    #[test]
    fn the_ball_is_where_a_pinhole_camera_shows_it() {
        let ball = Ball { position: [1.0, 0.2], ..Ball::default() };
        let file = WorldFile { ball: Some(ball), ..WorldFile::default() };
        let picture = render(&file, &looking(0.35, 0.0));
        let is_ball = |at: usize| {
            // Also where it is in its own shade.
            let [red, green, _] = pixel(&picture, at % 320, at / 320);
            f64::from(red) > 2.0 * f64::from(green)
        };
        let seen: Vec<usize> = (0..320 * 240).filter(|at| is_ball(*at)).collect();
        let count = seen.len() as f64;
        let (x, y) =
            seen.iter().fold((0.0, 0.0), |(x, y), at| (x + (at % 320) as f64, y + (at / 320) as f64));
        // Left of the middle, and below it.
        let expected = (159.5 - 288.6 * 0.2, 119.5 + 282.7 * 0.3);
        assert!(
            (x / count - expected.0).abs() < 1.5 && (y / count - expected.1).abs() < 1.5,
            "{} {}",
            x / count,
            y / count
        );
        let area = PI * (288.6 * 0.05) * (282.7 * 0.05);
        assert!((count / area - 1.0).abs() < 0.15, "{count} of {area} pixels");
    }

    #[test]
    fn lines_and_posts_of_the_field_are_seen() {
        let file = WorldFile { field: Some(Field::default()), ..WorldFile::default() };
        // Above the centre mark, straight down: the halfway line crosses the picture.
        let picture = render(&file, &looking(1.0, FRAC_PI_2));
        assert!(pixel(&picture, 160, 120).iter().all(|part| *part > 230));
        assert!(pixel(&picture, 300, 119).iter().all(|part| *part > 230));
        assert_eq!(pixel(&picture, 60, 60), [40, 130, 50]);
        let picture = render(&file, &looking(0.5, 0.0));
        let yellow = (0..320 * 240).filter(|at| {
            let [red, green, blue] = pixel(&picture, at % 320, at / 320);
            red > 140 && green > 130 && blue < 60
        });
        assert!(yellow.count() > 300);
    }

    #[test]
    fn where_no_lines_are_looked_for_none_are() {
        let file = WorldFile { field: Some(Field::default()), ..WorldFile::default() };
        let scene = Scene::new(&file, |_| None);
        let field = scene.field.as_ref().unwrap();
        let mut without = 0;
        for [x, y, down] in
            [[0.0, 0.0, 0.2], [-1.3, 0.7, 0.6], [2.1, -1.9, 0.9], [4.0, 2.8, 0.4], [-4.4, 0.3, 1.2]]
        {
            let mut from = looking(0.42, down);
            from.translation += DVec3::new(x, y, 0.0);
            from.rotation = DQuat::from_rotation_z(x + y) * from.rotation;
            let view = View::new(&Camera::darwin_op(), &from);
            for row in 0..view.height {
                for first in (0..view.width).step_by(RUN) {
                    let mut columns = first..first + RUN;
                    if scene.has_lines(&view, row, &columns) {
                        continue;
                    }
                    without += 1;
                    let is_free = |(at, depth): (Vec3, f32)| {
                        line_share(field, Vec2::new(at.x, at.y).abs(), depth * view.pixel) == 0.0
                    };
                    assert!(
                        columns.all(|column| view.on_floor(column, row).is_none_or(is_free)),
                        "{first} {row}"
                    );
                }
            }
        }
        assert!(without > 8_000, "of 24,000: {without}");
    }

    #[test]
    fn what_is_nearer_hides_what_is_behind() {
        let block = |name: &str, x: f64, colour| Block {
            name: name.into(),
            position: [x, 0.0, 0.5],
            size: [0.2, 0.2, 1.0],
            yaw: 0.3,
            mass: None,
            colour,
        };
        let boxes = vec![block("near", 1.0, [200, 0, 0]), block("far", 2.0, [0, 0, 200])];
        for boxes in [boxes.clone(), boxes.into_iter().rev().collect()] {
            let file = WorldFile { boxes, ..WorldFile::default() };
            let [red, _, blue] = pixel(&render(&file, &looking(0.5, 0.0)), 160, 120);
            assert!(red > 100 && blue == 0);
        }
    }

    #[test]
    fn what_was_spawned_is_seen_while_it_has_a_pose() {
        let post = Spawned { name: "post".into(), ..Spawned::parse("kind = \"post\"").unwrap() };
        // It lies across the picture.
        let lying =
            Isometry { translation: DVec3::new(2.0, 0.0, 0.5), rotation: DQuat::from_rotation_x(FRAC_PI_2) };
        let seen = |pose: Option<Isometry>| {
            let scene = Scene::new(&WorldFile::default(), |_| None);
            let picture =
                scene.with_spawned(std::slice::from_ref(&post), |_| pose).render(&CAMERA, &looking(0.5, 0.0));
            [(160, 120), (160, 80), (100, 120)].map(|(column, row)| pixel(&picture, column, row)[2] < 60)
        };
        assert_eq!(seen(Some(lying)), [true, false, true]);
        assert_eq!(seen(None), [false; 3]);
    }

    #[test]
    fn nothing_outside_the_frame_of_a_body_would_hit_it() {
        let ball = Ball { position: [0.12, 0.03], ..Ball::default() };
        let file = WorldFile { ball: Some(ball), ..WorldFile::default() };
        let scene = Scene::new(&file, |_| None);
        for (height, down) in [(0.05, 0.0), (0.2, 0.5), (0.4, 1.2), (0.4, -0.3)] {
            let view = View::new(&CAMERA, &looking(height, down));
            let [left, right, top, bottom] = view.frame_of(&scene.bodies[0]).unwrap_or_default();
            for (column, row) in (0..320 * 240).map(|at| (at % 320, at / 320)) {
                let is_inside = (left..right).contains(&column) && (top..bottom).contains(&row);
                let is_hit = scene.bodies[0].hit(view.eye, view.ray(column, row)).is_some();
                assert!(is_inside || !is_hit, "{column} {row} at {height} {down}");
            }
        }
    }
}
