//! The detector as a module.

use crate::colours::Colours;
use crate::detector::Detector;
use crate::drawing::annotated;
use crate::seen::{Exposure, Seen, SeenIntersection, SeenRobot, TeamColour};
use crate::view::{Camera, CameraError, View};
use downbeat_executor::{Context, Kept, Module, Publication, Received, Setting, Setup, SetupError, Time};
use downbeat_football::Field;
use downbeat_football::football_interfaces::msg::GameState;
use downbeat_football::soccer_model_msgs::msg::Ball as BallEstimate;
use downbeat_football::soccer_vision_2d_msgs::msg as vision_2d;
use downbeat_football::soccer_vision_3d_msgs::msg as vision_3d;
use downbeat_football::soccer_vision_attribute_msgs::msg::{Confidence, Robot as RobotAttributes};
use downbeat_football::vision_msgs::msg::{BoundingBox2D, BoundingBox3D, Point2D};
use downbeat_msgs::builtin_interfaces;
use downbeat_msgs::diagnostic_msgs::msg::{DiagnosticArray, DiagnosticStatus};
use downbeat_msgs::geometry_msgs::msg::{Point, Vector3};
use downbeat_msgs::sensor_msgs::msg::{CameraInfo, Image};
use downbeat_msgs::std_msgs::msg::Header;
use downbeat_pictures::Picture;
use downbeat_transforms::{Isometry, TransformBuffer, listen};
use glam::{DQuat, DVec2, DVec3};
use std::path::Path;
use std::time::Duration;

/// Looks at pictures; run it detached.
///
/// | topic | type | |
/// | --- | --- | --- |
/// | `camera/image_raw` (in) | sensor_msgs/Image | rgb8, bgr8, yuv422, yuv422_yuy2 |
/// | `camera/camera_info` (in) | sensor_msgs/CameraInfo | of the same size, without distortion |
/// | `game_state` (in) | football_interfaces/GameState | which colour the own team wears, unless `own_colour` says so |
/// | `tf`, `tf_static` (in) | tf2_msgs/TFMessage | the camera and the base at the time of the picture, in a frame whose floor is z = 0 |
/// | `vision/pixels/{field_boundary,markings,balls,goalposts,robots}` | soccer_vision_2d_msgs | in the picture |
/// | `vision/{field_boundary,markings,balls,goalposts,robots}` | soccer_vision_3d_msgs | on the floor, in `base_footprint` |
/// | `vision/ball` | soccer_model_msgs/Ball | the most certain ball with its covariance, in `base_footprint`; no velocity |
/// | `vision/annotated` | sensor_msgs/Image | with the setting `annotated`: the picture with what was seen ([`annotated`](crate::annotated)) |
/// | `diagnostics` | diagnostic_msgs/DiagnosticArray | when the state changes: what is wrong with pictures, and the remedy |
///
/// All have the stamp of the picture. `base_footprint` is on the floor below the base of the robot, with x
/// where the base faces.
///
/// Settings: `field` (a name or a file), `colours` (a file; empty for the built-in ones), `floor_frame`
/// (`odom`), `base_frame` (`base_link`), `angle_deviation` (rad: how certain directions are, for
/// covariances), `annotated` (false; pictures do not depend on who subscribes, so that a recorded run
/// repeats), `own_colour` (`game_state`, `blue` or `red`: what the own team wears). Robots in the other
/// colour are opponents; while the own colour is not known, the team of each robot is unknown.
#[derive(Default)]
pub struct Vision {
    detector: Option<Detector>,
    camera: Option<Result<Camera, CameraError>>,
    transforms: TransformBuffer,
    /// The last picture, until the transforms at its time are known.
    waiting: Option<(Time, Kept<Image>)>,
    told: Option<String>,
    /// As `game_state` has it.
    own_colour: Option<TeamColour>,
}

/// The keys of [`Vision`].
pub struct Ports {
    boundary_in_picture: Publication<vision_2d::FieldBoundary>,
    markings_in_picture: Publication<vision_2d::MarkingArray>,
    balls_in_picture: Publication<vision_2d::BallArray>,
    posts_in_picture: Publication<vision_2d::GoalpostArray>,
    robots_in_picture: Publication<vision_2d::RobotArray>,
    boundary: Publication<vision_3d::FieldBoundary>,
    markings: Publication<vision_3d::MarkingArray>,
    balls: Publication<vision_3d::BallArray>,
    posts: Publication<vision_3d::GoalpostArray>,
    robots: Publication<vision_3d::RobotArray>,
    ball: Publication<BallEstimate>,
    annotated: Publication<Image>,
    diagnostics: Publication<DiagnosticArray>,
    annotate: Setting<bool>,
    floor_frame: Setting<String>,
    base_frame: Setting<String>,
    angle_deviation: Setting<f64>,
    own_colour: Setting<String>,
}

/// How long a picture waits for its transforms.
const PATIENCE: Duration = Duration::from_millis(300);
/// How often a waiting picture is tried again.
const RETRY: Duration = Duration::from_millis(10);
const FOOTPRINT: &str = "base_footprint";

impl Vision {
    fn on_info(&mut self, info: Received<'_, CameraInfo>, _: &mut Context<'_, Ports>) {
        self.camera = Some(Camera::of(&info));
    }

    fn on_game(&mut self, game: Received<'_, GameState>, _: &mut Context<'_, Ports>) {
        self.own_colour = match game.own_colour {
            GameState::COLOUR_BLUE => Some(TeamColour::Blue),
            GameState::COLOUR_RED => Some(TeamColour::Red),
            _ => None,
        };
    }

    fn on_image(&mut self, image: Received<'_, Image>, ctx: &mut Context<'_, Ports>) {
        // A picture that cannot be used is not kept.
        if let Err(problem) = Picture::of(&image).and_then(Picture::with_colours) {
            return self.report(&problem.to_string(), ctx);
        }
        self.waiting = Some((ctx.now(), image.keep()));
        self.look(ctx);
    }

    fn look(&mut self, ctx: &mut Context<'_, Ports>) {
        let Some((since, image)) = self.waiting.take() else { return };
        let camera = match &self.camera {
            Some(Ok(camera)) => *camera,
            Some(Err(problem)) => return self.report(&problem.to_string(), ctx),
            None => {
                let problem = "pictures, but no camera_info; let the camera driver publish it beside them";
                return self.report(problem, ctx);
            }
        };
        let size = [image.width, image.height];
        if camera.size != size {
            let problem = CameraError::Size { picture: size, calibrated: camera.size };
            return self.report(&problem.to_string(), ctx);
        }
        let ground_from_camera = match self.ground_from_camera(&image.header, ctx) {
            Ok(found) => found,
            Err(_) if ctx.now().saturating_since(since) < PATIENCE => {
                self.waiting = Some((since, image));
                return;
            }
            Err(problem) => {
                let problem = format!(
                    "no pose of the camera at the time of the picture: {problem}; run robot_state_publisher and gait, or set floor_frame and base_frame"
                );
                return self.report(&problem, ctx);
            }
        };
        let Some(detector) = &mut self.detector else { return };
        let view = View { camera, ground_from_camera };
        let picture = match Picture::of(&image).and_then(Picture::with_colours) {
            Ok(picture) => picture,
            Err(problem) => return self.report(&problem.to_string(), ctx),
        };
        let header = &image.header;
        let seen = detector.see(&picture, &view);
        if *ctx.get(ctx.ports.annotate) {
            let annotated = Image {
                header: header.clone(),
                encoding: "rgb8".to_owned(),
                is_bigendian: 0,
                step: 3 * image.width,
                data: annotated(&picture, &seen),
                width: image.width,
                height: image.height,
            };
            ctx.publish(ctx.ports.annotated, annotated);
        }
        let state = match seen.exposure {
            Exposure::Good => "",
            Exposure::Black => "the picture is black; look for a lens cap, or raise exposure and gain",
            Exposure::White => "the picture is white all over; lower exposure and gain",
            Exposure::NoCarpet => "no carpet in the picture; calibrate the colours if there is some",
        };
        self.report(state, ctx);
        let own = match ctx.get(ctx.ports.own_colour).as_str() {
            "blue" => Some(TeamColour::Blue),
            "red" => Some(TeamColour::Red),
            _ => self.own_colour,
        };
        if let Some(detector) = &self.detector {
            publish(&seen, own, &view, detector.field(), header, ctx);
        }
    }

    /// The camera over the floor below the base.
    fn ground_from_camera(
        &self,
        header: &Header,
        ctx: &Context<'_, Ports>,
    ) -> Result<Isometry, downbeat_transforms::LookupError> {
        let at = Time::from_nanos(header.stamp.as_nanos());
        let floor = ctx.get(ctx.ports.floor_frame);
        let camera = self.transforms.lookup(floor, &header.frame_id, at)?.target_from_source;
        let base_frame: &String = ctx.get(ctx.ports.base_frame);
        let base = self.transforms.lookup(floor, base_frame, at)?.target_from_source;
        let ahead = base.rotation * DVec3::X;
        let footprint = Isometry {
            translation: base.translation.with_z(0.0),
            rotation: DQuat::from_rotation_z(libm::atan2(ahead.y, ahead.x)),
        };
        Ok(footprint.inverse() * camera)
    }

    /// Publishes the state if it changed; an empty problem is none.
    fn report(&mut self, problem: &str, ctx: &mut Context<'_, Ports>) {
        if self.told.as_deref() == Some(problem) {
            return;
        }
        self.told = Some(problem.to_owned());
        let (level, message) = match problem {
            "" => (DiagnosticStatus::OK, "sees"),
            problem => (DiagnosticStatus::WARN, problem),
        };
        let status = DiagnosticStatus {
            level,
            name: format!("{}: pictures", ctx.module_name()),
            message: message.to_owned(),
            ..DiagnosticStatus::default()
        };
        let stamp = builtin_interfaces::msg::Time::from_nanos(ctx.now().as_nanos());
        let header = Header { stamp, frame_id: String::new() };
        ctx.publish(ctx.ports.diagnostics, DiagnosticArray { header, status: vec![status] });
    }
}

impl Module for Vision {
    type Ports = Ports;

    fn setup(&mut self, setup: &mut Setup<'_, Self>) -> Result<Ports, SetupError> {
        let field = setup.read_only_setting(
            "field",
            String::new(),
            "name of a built-in field, or path of a file; empty: darwin_op_2014",
        )?;
        let colours = setup.read_only_setting(
            "colours",
            String::new(),
            "path of colour classes; empty: built-in ones",
        )?;
        let own_colour = setup.read_only_choice(
            "own_colour",
            "game_state",
            &["game_state", "blue", "red"],
            "what the own team wears",
        )?;
        let text = |setup: &Setup<'_, Self>, setting| setup.value(setting).cloned().unwrap_or_default();
        let found = Field::named(&text(setup, field))
            .map_err(|error| setup.refuse_value(field, error.to_string()))?;
        let classes = match text(setup, colours).as_str() {
            "" => Colours::default(),
            path => Colours::read(Path::new(path))
                .map_err(|error| setup.refuse_value(colours, error.to_string()))?,
        };
        self.detector = Some(Detector::new(found, &classes));
        listen(setup, |vision: &mut Self| &mut vision.transforms)?;
        setup.subscribe("game_state", Self::on_game)?;
        setup.subscribe("camera/camera_info", Self::on_info)?;
        setup.subscribe("camera/image_raw", Self::on_image)?;
        setup.every(RETRY, Self::look)?;
        Ok(Ports {
            boundary_in_picture: setup.publish("vision/pixels/field_boundary")?,
            markings_in_picture: setup.publish("vision/pixels/markings")?,
            balls_in_picture: setup.publish("vision/pixels/balls")?,
            posts_in_picture: setup.publish("vision/pixels/goalposts")?,
            robots_in_picture: setup.publish("vision/pixels/robots")?,
            boundary: setup.publish("vision/field_boundary")?,
            markings: setup.publish("vision/markings")?,
            balls: setup.publish("vision/balls")?,
            posts: setup.publish("vision/goalposts")?,
            robots: setup.publish("vision/robots")?,
            ball: setup.publish("vision/ball")?,
            annotated: setup.publish("vision/annotated")?,
            diagnostics: setup.publish("diagnostics")?,
            annotate: setup.setting(
                "annotated",
                false,
                "publish pictures with what was seen drawn into them",
            )?,
            floor_frame: setup.setting(
                "floor_frame",
                "odom".to_owned(),
                "a frame in which the floor is z = 0",
            )?,
            base_frame: setup.setting("base_frame", "base_link".to_owned(), "the base of the robot")?,
            angle_deviation: setup.setting_in(
                "angle_deviation",
                0.01,
                0.0001..=0.2,
                "rad; standard deviation of the direction of what is seen",
            )?,
            own_colour,
        })
    }
}

fn publish(
    seen: &Seen,
    own: Option<TeamColour>,
    view: &View,
    field: &Field,
    image: &Header,
    ctx: &mut Context<'_, Ports>,
) {
    let ground = Header { frame_id: FOOTPRINT.to_owned(), ..image.clone() };
    let pixels = image.clone();
    ctx.publish(
        ctx.ports.boundary_in_picture,
        vision_2d::FieldBoundary {
            header: pixels.clone(),
            points: seen.boundary.iter().map(|point| pixel(*point)).collect(),
            confidence: confidence(1.0),
        },
    );
    ctx.publish(
        ctx.ports.boundary,
        vision_3d::FieldBoundary {
            header: ground.clone(),
            points: seen.boundary.iter().filter_map(|point| view.on_floor(*point)).map(place).collect(),
            confidence: confidence(1.0),
        },
    );
    publish_markings(seen, view, field, [&pixels, &ground], ctx);
    let balls = seen.balls.iter();
    let balls_in_picture = balls.clone().map(|ball| vision_2d::Ball {
        bb: around(ball.centre, DVec2::splat(2.0 * ball.radius)),
        center: pixel(ball.centre),
        confidence: confidence(ball.confidence),
    });
    ctx.publish(
        ctx.ports.balls_in_picture,
        vision_2d::BallArray { header: pixels.clone(), balls: balls_in_picture.collect() },
    );
    let radius = field.ball.diameter / 2.0;
    let balls_on_floor = balls.map(|ball| vision_3d::Ball {
        center: Point { z: radius, ..place(ball.place) },
        confidence: confidence(ball.confidence),
    });
    ctx.publish(
        ctx.ports.balls,
        vision_3d::BallArray { header: ground.clone(), balls: balls_on_floor.collect() },
    );
    if let Some(ball) = seen.balls.first() {
        let [[xx, xy], [_, yy]] = view.covariance(ball.place, *ctx.get(ctx.ports.angle_deviation));
        let mut message = BallEstimate { header: ground.clone(), ..BallEstimate::default() };
        message.point.point = Point { z: radius, ..place(ball.place) };
        message.point.covariance = [xx, xy, 0.0, xy, yy, 0.0, 0.0, 0.0, 1e-6];
        // The velocity is unknown, as REP-103 has it for elements of covariances.
        message.twist.covariance[0] = -1.0;
        ctx.publish(ctx.ports.ball, message);
    }
    let posts_in_picture = seen.posts.iter().map(|post| vision_2d::Goalpost {
        bb: standing(post.foot, post.size),
        confidence: confidence(post.confidence),
        ..vision_2d::Goalpost::default()
    });
    ctx.publish(
        ctx.ports.posts_in_picture,
        vision_2d::GoalpostArray { header: pixels.clone(), posts: posts_in_picture.collect() },
    );
    let goal = field.goal;
    let posts_on_floor = seen.posts.iter().map(|post| vision_3d::Goalpost {
        bb: standing_on(post.place, [goal.post_diameter, goal.post_diameter, goal.height]),
        confidence: confidence(post.confidence),
        ..vision_3d::Goalpost::default()
    });
    ctx.publish(
        ctx.ports.posts,
        vision_3d::GoalpostArray { header: ground.clone(), posts: posts_on_floor.collect() },
    );
    let robots_in_picture = seen.robots.iter().map(|robot| vision_2d::Robot {
        bb: standing(robot.foot, robot.size),
        attributes: attributes(robot, own),
        confidence: confidence(robot.confidence),
    });
    ctx.publish(
        ctx.ports.robots_in_picture,
        vision_2d::RobotArray { header: pixels, robots: robots_in_picture.collect() },
    );
    let size = field.robot;
    let robots_on_floor = seen.robots.iter().map(|robot| vision_3d::Robot {
        bb: standing_on(robot.place, [size.width, size.width, size.height]),
        attributes: attributes(robot, own),
        confidence: confidence(robot.confidence),
    });
    ctx.publish(
        ctx.ports.robots,
        vision_3d::RobotArray { header: ground, robots: robots_on_floor.collect() },
    );
}

fn attributes(robot: &SeenRobot, own: Option<TeamColour>) -> RobotAttributes {
    RobotAttributes {
        team: match (robot.team, own) {
            (Some(team), Some(own)) if team == own => RobotAttributes::TEAM_OWN,
            (Some(_), Some(_)) => RobotAttributes::TEAM_OPPONENT,
            _ => RobotAttributes::TEAM_UNKNOWN,
        },
        state: if robot.is_fallen { RobotAttributes::STATE_FALLEN } else { RobotAttributes::STATE_STANDING },
        ..RobotAttributes::default()
    }
}

fn publish_markings(
    seen: &Seen,
    view: &View,
    field: &Field,
    [pixels, ground]: [&Header; 2],
    ctx: &mut Context<'_, Ports>,
) {
    let rays = |count: usize| i32::try_from(count).unwrap_or(i32::MAX);
    let mut in_picture =
        vision_2d::MarkingArray { header: pixels.clone(), ..vision_2d::MarkingArray::default() };
    let mut on_floor =
        vision_3d::MarkingArray { header: ground.clone(), ..vision_3d::MarkingArray::default() };
    for line in &seen.lines {
        let confidence = confidence(line.confidence);
        let [start, end] = line.pixels.map(pixel);
        in_picture.segments.push(vision_2d::MarkingSegment { start, end, confidence });
        let [start, end] = line.ends.map(place);
        on_floor.segments.push(vision_3d::MarkingSegment { start, end, confidence });
    }
    for one in &seen.intersections {
        let confidence = confidence(one.confidence);
        let num_rays = rays(one.arms.len());
        in_picture.intersections.push(vision_2d::MarkingIntersection {
            center: pixel(one.pixel),
            num_rays,
            heading_rays: one.arms.iter().filter_map(|arm| heading_in_picture(one, *arm, view)).collect(),
            confidence,
        });
        on_floor.intersections.push(vision_3d::MarkingIntersection {
            center: place(one.place),
            num_rays,
            rays: one.arms.iter().map(|arm| Vector3 { x: arm.x, y: arm.y, z: 0.0 }).collect(),
            confidence,
        });
    }
    if let Some(circle) = &seen.circle {
        let confidence = confidence(circle.confidence);
        let [least, most] = circle.bounds;
        in_picture.ellipses.push(vision_2d::MarkingEllipse {
            bb: around((least + most) / 2.0, most - least),
            center: pixel(circle.pixel),
            confidence,
        });
        let mut ellipse = vision_3d::MarkingEllipse {
            diameter: field.circle_diameter,
            confidence,
            ..vision_3d::MarkingEllipse::default()
        };
        ellipse.center.position = place(circle.place);
        ellipse.center.orientation.w = 1.0;
        on_floor.ellipses.push(ellipse);
    }
    ctx.publish(ctx.ports.markings_in_picture, in_picture);
    ctx.publish(ctx.ports.markings, on_floor);
}

/// The direction of an arm in the picture, in rad from the right, downwards.
fn heading_in_picture(of: &SeenIntersection, arm: DVec2, view: &View) -> Option<f64> {
    let along = view.pixel_of((of.place + arm * 0.05).extend(0.0))? - of.pixel;
    Some(along.to_angle())
}

fn pixel(of: DVec2) -> Point2D {
    Point2D { x: of.x, y: of.y }
}

fn place(of: DVec2) -> Point {
    Point { x: of.x, y: of.y, z: 0.0 }
}

fn confidence(of: f64) -> Confidence {
    Confidence { confidence: of as f32 }
}

fn around(centre: DVec2, size: DVec2) -> BoundingBox2D {
    let mut bounds = BoundingBox2D { size_x: size.x, size_y: size.y, ..BoundingBox2D::default() };
    bounds.center.position = pixel(centre);
    bounds
}

fn standing(foot: DVec2, size: DVec2) -> BoundingBox2D {
    around(DVec2::new(foot.x, foot.y - size.y / 2.0), size)
}

fn standing_on(foot: DVec2, [x, y, z]: [f64; 3]) -> BoundingBox3D {
    let mut bounds = BoundingBox3D { size: Vector3 { x, y, z }, ..BoundingBox3D::default() };
    bounds.center.position = Point { z: z / 2.0, ..place(foot) };
    bounds.center.orientation.w = 1.0;
    bounds
}
