//! A camera on its own thread. Its pictures of 1 MiB are shared, never copied.

use std::process::ExitCode;
use std::time::Duration;

use downbeat::App;
use downbeat::executor::{Context, Kept, Module, Publication, Received, Setup, SetupError};
use downbeat::msgs::sensor_msgs::msg::Image;
use downbeat::msgs::std_msgs::msg::{Float64, Header};
use downbeat::robot::Kind;

/// Width and height of a picture, in pixels of one byte.
const SIDE: usize = 1024;

/// The side of the square in the pictures, in pixels.
const SQUARE: usize = 256;

/// A camera whose pictures are synthetic: a bright square that moves from left to right.
#[derive(Default)]
struct Camera {
    frame: usize,
}

struct CameraPorts {
    image: Publication<Image>,
}

impl Module for Camera {
    type Ports = CameraPorts;

    fn setup(&mut self, setup: &mut Setup<'_, Self>) -> Result<CameraPorts, SetupError> {
        setup.every(Duration::from_millis(33), Self::take)?;
        Ok(CameraPorts { image: setup.publish("image")? })
    }
}

impl Camera {
    fn take(&mut self, ctx: &mut Context<'_, CameraPorts>) {
        let mut data = vec![30_u8; SIDE * SIDE];
        let left = self.frame * 8 % (SIDE - SQUARE);
        data.chunks_exact_mut(SIDE).take(SQUARE).for_each(|row| row[left..left + SQUARE].fill(220));
        self.frame += 1;
        let stamp = downbeat::msgs::builtin_interfaces::msg::Time::from_nanos(ctx.now().as_nanos());
        let image = Image {
            header: Header { stamp, frame_id: "camera".into() },
            width: SIDE as u32,
            height: SIDE as u32,
            encoding: "mono8".into(),
            step: SIDE as u32,
            data,
            ..Image::default()
        };
        ctx.publish(ctx.ports.image, image); // Moved: the pixels stay where they are.
    }
}

/// Keeps the first picture and publishes which share of each later one differs from it.
#[derive(Default)]
struct Motion {
    background: Option<Kept<Image>>,
}

struct MotionPorts {
    changed: Publication<Float64>,
}

impl Module for Motion {
    type Ports = MotionPorts;

    fn setup(&mut self, setup: &mut Setup<'_, Self>) -> Result<MotionPorts, SetupError> {
        setup.subscribe("image", Self::look)?;
        Ok(MotionPorts { changed: setup.publish("changed")? })
    }
}

impl Motion {
    fn look(&mut self, image: Received<'_, Image>, ctx: &mut Context<'_, MotionPorts>) {
        let Some(background) = &self.background else {
            let kept = image.keep();
            let is_same_memory = std::ptr::eq(kept.data.as_ptr(), image.data.as_ptr());
            let how = if is_same_memory { "without copying it" } else { "as a copy" };
            tracing::info!("keeps a picture of {} bytes {how}", kept.data.len());
            self.background = Some(kept);
            return;
        };
        // One pixel of 64 is enough to see a square.
        let pixels = background.data.iter().zip(&image.data).step_by(64);
        let changed = pixels.clone().filter(|(then, now)| then != now).count();
        let share = changed as f64 / pixels.len() as f64;
        tracing::info!("{:.1} % of the pixels have changed", share * 100.0);
        ctx.publish(ctx.ports.changed, Float64 { data: share });
    }
}

fn app() -> App {
    let camera = Kind::new("camera", "a camera with synthetic pictures of 1 MiB", Camera::default);
    App::new().add_kind(camera.detached()).kind(
        "motion",
        "which share of a picture has changed",
        Motion::default,
    )
}

fn main() -> ExitCode {
    app().main()
}
