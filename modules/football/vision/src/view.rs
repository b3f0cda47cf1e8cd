//! From pixels to the field and back.

use downbeat_msgs::sensor_msgs::msg::CameraInfo;
use downbeat_transforms::Isometry;
use glam::{DVec2, DVec3};

/// A pinhole camera. Lengths in pixels.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Camera {
    /// Columns and rows.
    pub size: [u32; 2],
    /// Focal lengths, horizontal and vertical.
    pub focal: DVec2,
    /// Where the optical axis meets the picture.
    pub centre: DVec2,
}

/// Why a camera is refused.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum CameraError {
    /// Numbers are missing or not possible.
    #[error(
        "camera_info has no usable matrix k; calibrate the camera, or set its field of view in its driver"
    )]
    Matrix,
    /// The picture has another size than the calibration.
    #[error(
        "the picture has {picture:?} pixels, camera_info is for {calibrated:?}; set the camera to the size it was calibrated with"
    )]
    Size {
        /// Of the picture.
        picture: [u32; 2],
        /// Of camera_info.
        calibrated: [u32; 2],
    },
    /// Its lens is distorted.
    #[error(
        "camera_info declares distortion (d is not 0); rectify pictures first, as image_proc does, or set d to 0"
    )]
    Distorted,
}

impl Camera {
    /// The camera of a message.
    ///
    /// # Errors
    /// [`CameraError`].
    pub fn of(info: &CameraInfo) -> Result<Self, CameraError> {
        let [fx, _, cx, _, fy, cy, ..] = info.k;
        let is_possible = |focal: f64| (1.0..1e5).contains(&focal);
        if !(is_possible(fx) && is_possible(fy) && cx.abs() < 1e5 && cy.abs() < 1e5) {
            return Err(CameraError::Matrix);
        }
        if info.d.iter().any(|part| part.is_nan() || part.abs() > 1e-6) {
            return Err(CameraError::Distorted);
        }
        let size = [info.width, info.height];
        Ok(Self { size, focal: DVec2::new(fx, fy), centre: DVec2::new(cx, cy) })
    }
}

/// A camera above the field.
#[derive(Clone, Copy, Debug)]
pub struct View {
    /// The camera.
    pub camera: Camera,
    /// The pose of the optical frame (z forward, x right, y down) in `base_footprint`.
    pub ground_from_camera: Isometry,
}

impl View {
    /// The direction through a pixel, of length 1 along the optical axis.
    #[must_use]
    pub fn ray(&self, pixel: DVec2) -> DVec3 {
        let at = (pixel - self.camera.centre) / self.camera.focal;
        self.ground_from_camera.rotation * DVec3::new(at.x, at.y, 1.0)
    }

    /// The point at this height that a pixel shows, if the camera looks at it.
    #[must_use]
    pub fn at_height(&self, pixel: DVec2, height: f64) -> Option<DVec2> {
        let (eye, ray) = (self.ground_from_camera.translation, self.ray(pixel));
        let depth = (height - eye.z) / ray.z;
        let point = eye + ray * depth;
        // Beyond it a hundredth of a degree is metres.
        (depth.is_finite() && depth > 0.0 && depth < 50.0).then(|| point.truncate())
    }

    /// The point of the floor that a pixel shows.
    #[must_use]
    pub fn on_floor(&self, pixel: DVec2) -> Option<DVec2> {
        self.at_height(pixel, 0.0)
    }

    /// The pixel that shows a point, also outside of the picture; `None` if it is not in front of the camera.
    #[must_use]
    pub fn pixel_of(&self, point: DVec3) -> Option<DVec2> {
        let in_camera = self.ground_from_camera.inverse().transform_point(point);
        (in_camera.z > 0.02)
            .then(|| in_camera.truncate() / in_camera.z * self.camera.focal + self.camera.centre)
    }

    /// How many pixels wide something of this width is at a point.
    #[must_use]
    pub fn width_at(&self, point: DVec3, width: f64) -> f64 {
        let depth = self.ground_from_camera.inverse().transform_point(point).z;
        self.camera.focal.x * width / depth.max(0.02)
    }

    /// How many pixels high something of this height that stands on the floor at a point is.
    #[must_use]
    pub fn height_at(&self, point: DVec2, height: f64) -> Option<f64> {
        Some(self.pixel_of(point.extend(0.0))?.distance(self.pixel_of(point.extend(height))?))
    }

    /// The height above a place on the floor at which the line of sight of a pixel passes it, in m; the pixel
    /// is about above that of the place.
    #[must_use]
    pub fn height_over(&self, place: DVec2, pixel: DVec2) -> f64 {
        let (eye, ray) = (self.ground_from_camera.translation, self.ray(pixel));
        let ahead = ray.truncate().dot((place - eye.truncate()).normalize_or_zero());
        let slope = if ahead > 1e-3 { ray.z / ahead } else { f64::INFINITY };
        eye.z + place.distance(eye.truncate()) * slope
    }

    /// The row of the horizon in a column; may be far outside of the picture.
    #[must_use]
    pub fn horizon(&self, column: f64) -> f64 {
        // Solves ray.z = 0, which is linear in the row.
        let at = |row: f64| self.ray(DVec2::new(column, row)).z;
        let (first, slope) = (at(0.0), at(1.0) - at(0.0));
        if slope.abs() < 1e-12 { f64::NEG_INFINITY } else { -first / slope }
    }

    /// How far the projection of a pixel may be off along the direction of view for an error of one pixel, in
    /// m.
    #[must_use]
    pub fn pixel_at(&self, point: DVec2) -> f64 {
        let eye = self.ground_from_camera.translation;
        let height = eye.z.max(0.05);
        (point.distance_squared(eye.truncate()) + height * height) / (height * self.camera.focal.y)
    }

    /// The covariance of a point on the floor; see [`downbeat_football::floor_covariance`].
    #[must_use]
    pub fn covariance(&self, point: DVec2, angle_deviation: f64) -> [[f64; 2]; 2] {
        let eye = self.ground_from_camera.translation;
        downbeat_football::floor_covariance(eye.z, point - eye.truncate(), angle_deviation)
    }
}
