//! How certain projections to the floor are.

use glam::DVec2;

/// The covariance of a point on the floor that a camera sees, in m², for errors of direction.
///
/// With the camera at height h above the floor, the point at the horizontal distance d from it, and the same
/// deviation σ (rad) of the direction to both sides and up and down:
///
/// - (1) along the line of sight: σ (d² + h²) / h
/// - (2) across: σ √(d² + h²)
///
/// The messages of `soccer_vision_3d_msgs` have no covariances: who uses them computes them so, with
/// `from_camera` the point without the position of the camera.
#[must_use]
pub fn floor_covariance(height: f64, from_camera: DVec2, deviation: f64) -> [[f64; 2]; 2] {
    let height = height.max(0.05);
    let square = from_camera.length_squared() + height * height;
    let along = (deviation * square / height).powi(2);
    let across = deviation * deviation * square;
    let DVec2 { x, y } = from_camera.normalize_or(DVec2::X);
    let xy = (along - across) * x * y;
    [[along * x * x + across * y * y, xy], [xy, along * y * y + across * x * x]]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_far_is_uncertain_along_the_line_of_sight() {
        let [[xx, xy], [_, yy]] = floor_covariance(0.5, DVec2::new(2.0, 0.0), 0.01);
        // The floor 2 m away, seen 0.01 rad lower.
        let moved = 2.0 - 0.5 / libm::tan(libm::atan(0.5_f64 / 2.0) + 0.01);
        assert!((xx.sqrt() / moved - 1.0).abs() < 0.1, "{} {moved}", xx.sqrt());
        assert!(xy.abs() < 1e-15 && (yy.sqrt() - 0.01 * 4.25_f64.sqrt()).abs() < 1e-12);
    }
}
