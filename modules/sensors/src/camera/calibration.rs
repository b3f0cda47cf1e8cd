//! The calibration of a camera, as `camera_calibration` of ROS writes it.
//!
//! # References
//! `camera_calibration_parsers` of `ros-perception/image_common`: the names of the fields;
//! `sensor_msgs/CameraInfo` and `sensor_msgs/distortion_models.hpp`: their meaning.

use std::path::Path;

use downbeat_msgs::sensor_msgs::msg::CameraInfo;
use downbeat_msgs::std_msgs::msg::Header;
use serde::Deserialize;

/// The largest file, in bytes.
const MOST_BYTES: u64 = 1 << 20;

/// Models of distortion and how many coefficients they have.
const MODELS: [(&str, &[usize]); 3] =
    [("plumb_bob", &[5]), ("rational_polynomial", &[8, 12, 14]), ("equidistant", &[4])];

/// The calibration of a camera.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Calibration {
    info: CameraInfo,
}

/// A file that is no calibration: where, and why.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{file}: {problem}")]
pub struct CalibrationError {
    file: String,
    problem: String,
}

#[derive(Deserialize)]
struct File {
    image_width: u32,
    image_height: u32,
    #[serde(default)]
    distortion_model: Option<String>,
    camera_matrix: Matrix,
    distortion_coefficients: Matrix,
    rectification_matrix: Matrix,
    projection_matrix: Matrix,
}

#[derive(Deserialize)]
struct Matrix {
    rows: usize,
    cols: usize,
    data: Vec<f64>,
}

impl Calibration {
    /// Reads a file; a text with a line break is the content of one.
    ///
    /// # Errors
    /// If the file cannot be read, or is no calibration; the error names line and field.
    pub fn load(path_or_text: &str) -> Result<Self, CalibrationError> {
        if path_or_text.contains('\n') {
            return Self::parse("calibration", path_or_text);
        }
        let error = |problem: String| CalibrationError { file: path_or_text.to_owned(), problem };
        let path = Path::new(path_or_text);
        let length = std::fs::metadata(path).map_err(|problem| error(problem.to_string()))?.len();
        if length > MOST_BYTES {
            return Err(error(format!("{length} bytes are no calibration of a camera")));
        }
        let text = std::fs::read_to_string(path).map_err(|problem| error(problem.to_string()))?;
        Self::parse(path_or_text, &text)
    }

    /// Reads a text; `file` is for errors.
    ///
    /// # Errors
    /// If the text is no calibration.
    pub fn parse(file: &str, text: &str) -> Result<Self, CalibrationError> {
        let error = |problem: String| CalibrationError { file: file.to_owned(), problem };
        let of_field =
            |field: &str, problem: String| error(format!("{}{field}: {problem}", line_of(text, field)));
        let read: File = downbeat_msgs::yaml::from_str(text).map_err(|problem| error(problem.to_string()))?;
        for (field, side) in [("image_width", read.image_width), ("image_height", read.image_height)] {
            if side == 0 {
                return Err(of_field(field, "a picture has at least one pixel".to_owned()));
            }
        }
        let checked = |field: &str, matrix: &Matrix, rows: usize, columns: &[usize]| {
            let Matrix { rows: has_rows, cols, data } = matrix;
            let shape =
                columns.iter().map(|columns| format!("{rows}x{columns}")).collect::<Vec<_>>().join(" or ");
            if *has_rows != rows || !columns.contains(cols) {
                return Err(of_field(field, format!("it is {has_rows}x{cols}, expected {shape}")));
            }
            if data.len() != rows * cols {
                let count = data.len();
                return Err(of_field(field, format!("data has {count} numbers, expected {}", rows * cols)));
            }
            match data.iter().find(|number| !number.is_finite()) {
                Some(number) => Err(of_field(field, format!("data has {number}"))),
                None => Ok(()),
            }
        };
        let model = read.distortion_model.as_deref().unwrap_or("plumb_bob");
        let Some((model, counts)) = MODELS.iter().find(|(name, _)| *name == model) else {
            let known = MODELS.map(|(name, _)| name).join(", ");
            return Err(of_field("distortion_model", format!("\"{model}\" is none of {known}")));
        };
        checked("camera_matrix", &read.camera_matrix, 3, &[3])?;
        checked("distortion_coefficients", &read.distortion_coefficients, 1, counts)?;
        checked("rectification_matrix", &read.rectification_matrix, 3, &[3])?;
        checked("projection_matrix", &read.projection_matrix, 3, &[4])?;
        if let Some(place) = [0, 4].into_iter().find(|place| read.camera_matrix.data[*place] <= 0.0) {
            let focal = read.camera_matrix.data[place];
            return Err(of_field("camera_matrix", format!("a focal length is {focal} pixels")));
        }
        let info = CameraInfo {
            width: read.image_width,
            height: read.image_height,
            distortion_model: (*model).to_owned(),
            d: read.distortion_coefficients.data,
            k: array(&read.camera_matrix.data),
            r: array(&read.rectification_matrix.data),
            p: array(&read.projection_matrix.data),
            ..CameraInfo::default()
        };
        Ok(Self { info })
    }

    /// The size of the pictures it is for, in pixels.
    #[must_use]
    pub fn size(&self) -> [u32; 2] {
        [self.info.width, self.info.height]
    }

    /// The message for a picture.
    #[must_use]
    pub fn info(&self, header: Header) -> CameraInfo {
        CameraInfo { header, ..self.info.clone() }
    }
}

/// Where a field stands, for the beginning of a sentence.
fn line_of(text: &str, field: &str) -> String {
    let line = text
        .lines()
        .position(|line| line.strip_prefix(field).is_some_and(|rest| rest.trim_start().starts_with(':')));
    line.map(|line| format!("line {}, ", line + 1)).unwrap_or_default()
}

fn array<const COUNT: usize>(numbers: &[f64]) -> [f64; COUNT] {
    let mut array = [0.0; COUNT];
    for (to, from) in array.iter_mut().zip(numbers) {
        *to = *from;
    }
    array
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;
    use fuzzing::{Random, change_lines, rounds};

    /// The form of a file of `camera_calibration`.
    const TEXT: &str = "image_width: 640
image_height: 480
camera_name: front
camera_matrix:
  rows: 3
  cols: 3
  data: [438.783367, 0.000000, 305.593336, 0.000000, 437.302876, 243.738352, 0.000000, 0.000000, 1.000000]
distortion_model: plumb_bob
distortion_coefficients:
  rows: 1
  cols: 5
  data: [-0.361976, 0.110510, 0.001014, 0.000505, 0.000000]
rectification_matrix:
  rows: 3
  cols: 3
  data: [0.999978, 0.002789, -0.006046, -0.002816, 0.999986, -0.004401, 0.006034, 0.004417, 0.999972]
projection_matrix:
  rows: 3
  cols: 4
  data: [393.653800, 0.000000, 322.797939, 0.000000, 0.000000, 393.653800, 241.090902, 0.000000, 0.000000, 0.000000, 1.000000, 0.000000]
";

    #[test]
    fn a_file_of_camera_calibration_becomes_a_camera_info() {
        let calibration = Calibration::load(TEXT).unwrap();
        assert_eq!(calibration.size(), [640, 480]);
        let info = calibration.info(Header { frame_id: "front".into(), ..Header::default() });
        assert_eq!((info.header.frame_id.as_str(), info.distortion_model.as_str()), ("front", "plumb_bob"));
        assert_eq!((info.k[0], info.k[5], info.r[8]), (438.783_367, 243.738_352, 0.999_972));
        assert_eq!((info.d.as_slice().len(), info.p[6], info.p[10]), (5, 241.090_902, 1.0));
    }

    #[test]
    fn what_is_wrong_is_told_with_line_and_field() {
        let refusal = |from: &str, to: &str| {
            assert!(TEXT.contains(from), "{from}");
            Calibration::parse("front.yaml", &TEXT.replacen(from, to, 1)).unwrap_err().to_string()
        };
        assert_eq!(
            refusal(", 0.000000, 1.000000]\ndistortion_model", ", 1.000000]\ndistortion_model"),
            "front.yaml: line 4, camera_matrix: data has 8 numbers, expected 9"
        );
        assert_eq!(
            refusal("cols: 4", "cols: 3"),
            "front.yaml: line 17, projection_matrix: it is 3x3, expected 3x4"
        );
        assert_eq!(
            refusal("plumb_bob", "plum_bob"),
            "front.yaml: line 8, distortion_model: \"plum_bob\" is none of plumb_bob, rational_polynomial, equidistant"
        );
        assert_eq!(
            refusal("plumb_bob", "equidistant"),
            "front.yaml: line 9, distortion_coefficients: it is 1x5, expected 1x4"
        );
        assert_eq!(refusal("-0.361976", ".nan"), "front.yaml: line 9, distortion_coefficients: data has NaN");
        assert_eq!(
            refusal("438.783367", "-1"),
            "front.yaml: line 4, camera_matrix: a focal length is -1 pixels"
        );
        assert_eq!(
            refusal("width: 640", "width: 0"),
            "front.yaml: line 1, image_width: a picture has at least one pixel"
        );
        let word = refusal("0.110510", "much");
        assert!(word.contains("distortion_coefficients.data") && word.contains("line 12"), "{word}");
        assert!(refusal("image_height", "image_hight").contains("missing field `image_height`"));
        let no_file = Calibration::load("/nowhere/front.yaml").unwrap_err().to_string();
        assert!(no_file.starts_with("/nowhere/front.yaml: No such file"), "{no_file}");
    }

    #[test]
    fn changed_files_are_calibrations_or_errors() {
        for round in rounds(300) {
            let mut random = Random::new(round);
            let text = change_lines(TEXT, &[], &mut random);
            if let Ok(calibration) = Calibration::parse("changed", &text) {
                assert!(calibration.info.k.iter().all(|number| number.is_finite()));
            }
        }
    }
}
