//! How a chip is mounted.

use std::str::FromStr;

/// Which axes of a chip point forward, left and up.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Axes([Axis; 3]);

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Axis {
    index: usize,
    is_reversed: bool,
}

/// Why a text names no axes.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum AxesError {
    /// Not three axes.
    #[error(
        "\"{0}\" must be three of x, y, z, -x, -y and -z: the chip's axes that point forward, left and up, such as \"-y x z\""
    )]
    Names(String),
    /// A mirror image.
    #[error(
        "no chip is mounted with the axes \"{0}\" forward, left and up: they are left-handed, turn one of them round"
    )]
    Mirrored(String),
}

impl FromStr for Axes {
    type Err = AxesError;

    fn from_str(text: &str) -> Result<Self, AxesError> {
        let axis = |name: &str| {
            let index = ["x", "y", "z"].iter().position(|axis| *axis == name.trim_start_matches('-'))?;
            (name.len() <= 2).then_some(Axis { index, is_reversed: name.starts_with('-') })
        };
        let axes: Option<Vec<Axis>> = text.split_whitespace().map(axis).collect();
        let axes: Option<[Axis; 3]> = axes.and_then(|axes| axes.try_into().ok());
        let axes = axes.filter(|[x, y, z]| x.index != y.index && y.index != z.index && z.index != x.index);
        let axes = Self(axes.ok_or_else(|| AxesError::Names(text.to_owned()))?);
        if axes.determinant() < 0.0 { Err(AxesError::Mirrored(text.to_owned())) } else { Ok(axes) }
    }
}

impl Axes {
    /// A vector of the chip as forward, left and up.
    #[must_use]
    pub fn turn(self, of_chip: [f64; 3]) -> [f64; 3] {
        self.0.map(|axis| {
            let value = of_chip.get(axis.index).copied().unwrap_or(f64::NAN);
            if axis.is_reversed { -value } else { value }
        })
    }

    /// The orientation of the body from that of the chip: x, y, z, w.
    #[must_use]
    pub fn turn_orientation(self, world_from_chip: [f64; 4]) -> [f64; 4] {
        multiply(world_from_chip, self.chip_from_body())
    }

    /// The rows are forward, left and up in the axes of the chip.
    fn matrix(self) -> [[f64; 3]; 3] {
        let unit = |index| std::array::from_fn(|at| if at == index { 1.0 } else { 0.0 });
        self.0.map(|axis| unit(axis.index).map(|value: f64| if axis.is_reversed { -value } else { value }))
    }

    fn determinant(self) -> f64 {
        let [a, b, c] = self.matrix();
        a[0] * (b[1] * c[2] - b[2] * c[1]) - a[1] * (b[0] * c[2] - b[2] * c[0])
            + a[2] * (b[0] * c[1] - b[1] * c[0])
    }

    /// The rotation whose matrix has forward, left and up as its columns.
    fn chip_from_body(self) -> [f64; 4] {
        let rows = self.matrix();
        let m = |row: usize, column: usize| rows[column][row];
        // The largest component first: none of the entries is rounded.
        let squares = [
            1.0 + m(0, 0) - m(1, 1) - m(2, 2),
            1.0 - m(0, 0) + m(1, 1) - m(2, 2),
            1.0 - m(0, 0) - m(1, 1) + m(2, 2),
            1.0 + m(0, 0) + m(1, 1) + m(2, 2),
        ];
        let largest = (0..4).max_by(|&a, &b| squares[a].total_cmp(&squares[b])).unwrap_or(3);
        let unscaled = match largest {
            0 => [squares[0], m(0, 1) + m(1, 0), m(0, 2) + m(2, 0), m(2, 1) - m(1, 2)],
            1 => [m(0, 1) + m(1, 0), squares[1], m(1, 2) + m(2, 1), m(0, 2) - m(2, 0)],
            2 => [m(0, 2) + m(2, 0), m(1, 2) + m(2, 1), squares[2], m(1, 0) - m(0, 1)],
            _ => [m(2, 1) - m(1, 2), m(0, 2) - m(2, 0), m(1, 0) - m(0, 1), squares[3]],
        };
        let scale = 0.5 / squares[largest].sqrt();
        unscaled.map(|component| component * scale)
    }
}

/// The product of two quaternions: x, y, z, w.
fn multiply([ax, ay, az, aw]: [f64; 4], [bx, by, bz, bw]: [f64; 4]) -> [f64; 4] {
    [
        aw * bx + ax * bw + ay * bz - az * by,
        aw * by - ax * bz + ay * bw + az * bx,
        aw * bz + ax * by - ay * bx + az * bw,
        aw * bw - ax * bx - ay * by - az * bz,
    ]
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    fn rotated(quaternion: [f64; 4], [x, y, z]: [f64; 3]) -> [f64; 3] {
        let [qx, qy, qz, qw] = quaternion;
        let [rx, ry, rz, _] = multiply(multiply(quaternion, [x, y, z, 0.0]), [-qx, -qy, -qz, qw]);
        [rx, ry, rz]
    }

    #[test]
    fn vectors_are_turned_as_the_axes_say() {
        let axes: Axes = "-y x z".parse().unwrap();
        assert_eq!(axes.turn([1.0, 2.0, 3.0]), [-2.0, 1.0, 3.0]);
        assert_eq!("x y z".parse::<Axes>().unwrap().turn([1.0, 2.0, 3.0]), [1.0, 2.0, 3.0]);
    }

    /// A vector is the same in the world, whether it is turned to the body first or not.
    #[test]
    fn vectors_and_orientations_are_turned_alike_for_each_mounting() {
        let names = ["x", "y", "z", "-x", "-y", "-z"];
        let mut mountings = 0;
        let world_from_chip = [0.5, 0.1, -0.7, 0.5].map(|component: f64| component);
        for first in names {
            for second in names {
                for third in names {
                    let Ok(axes) = format!("{first} {second} {third}").parse::<Axes>() else { continue };
                    mountings += 1;
                    let vector = [1.0, 2.0, 3.0];
                    let by_chip = rotated(world_from_chip, vector);
                    let by_body = rotated(axes.turn_orientation(world_from_chip), axes.turn(vector));
                    let differs = by_chip.iter().zip(by_body).any(|(a, b)| (a - b).abs() > 1e-9);
                    assert!(!differs, "{first} {second} {third}: {by_chip:?} {by_body:?}");
                }
            }
        }
        assert_eq!(mountings, 24, "a cube has 24 orientations");
    }

    #[test]
    fn what_is_no_mounting_is_refused_with_the_reason() {
        let error = |text: &str| text.parse::<Axes>().unwrap_err().to_string();
        for text in ["x y", "x y y", "x y w", "--x y z", ""] {
            assert!(error(text).contains("three of x, y, z, -x, -y and -z"), "{text}");
        }
        assert!(error("y x z").contains("left-handed"));
    }
}
