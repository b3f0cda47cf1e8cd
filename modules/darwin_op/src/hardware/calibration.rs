//! The calibration of the gyroscope: what it reads at rest.

/// The number of samples of an attempt: 0.8 s.
const SAMPLES: usize = 100;
/// The robot stands still if no axis varies more, as a standard deviation in steps.
const STILL_LSB: f64 = 2.0;

/// Measures what the gyroscope reads at rest, as in the DARwIn-OP framework: the mean of 100 samples, if the
/// robot stood still meanwhile; else it begins again.
#[derive(Clone, Debug, Default, PartialEq)]
pub(super) struct GyroCalibration {
    samples: Vec<[u16; 3]>,
    rest: Option<[f64; 3]>,
}

impl GyroCalibration {
    /// What the gyroscope reads at rest, once that is known.
    pub(super) fn rest(&self) -> Option<[f64; 3]> {
        self.rest
    }

    /// Takes a sample, until the calibration is done.
    pub(super) fn take(&mut self, gyro: [u16; 3]) {
        if self.rest.is_some() {
            return;
        }
        self.samples.push(gyro);
        if self.samples.len() < SAMPLES {
            return;
        }
        let samples = std::mem::take(&mut self.samples);
        let axis = |axis: usize| samples.iter().map(move |sample| f64::from(sample[axis]));
        let mean = [0, 1, 2].map(|index| axis(index).sum::<f64>() / SAMPLES as f64);
        let deviation = [0, 1, 2].map(|index: usize| {
            (axis(index).map(|value| (value - mean[index]).powi(2)).sum::<f64>() / SAMPLES as f64).sqrt()
        });
        if deviation.iter().all(|deviation| *deviation < STILL_LSB) {
            tracing::info!("the gyroscope is calibrated: it reads {mean:.1?} at rest");
            self.rest = Some(mean);
        } else {
            tracing::warn!(
                "the gyroscope is not calibrated: the robot moves (by {deviation:.1?} steps); trying again"
            );
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_mean_of_a_robot_that_stands_still_is_taken() {
        let mut calibration = GyroCalibration::default();
        for sample in 0..SAMPLES as u16 {
            assert_eq!(calibration.rest(), None);
            calibration.take([515 + sample % 2, 510, 512]);
        }
        assert_eq!(calibration.rest(), Some([515.5, 510.0, 512.0]));
        calibration.take([900; 3]);
        assert_eq!(calibration.rest(), Some([515.5, 510.0, 512.0]));
    }

    #[test]
    fn a_robot_that_moves_is_waited_for() {
        let mut calibration = GyroCalibration::default();
        (0..SAMPLES as u16).for_each(|sample| calibration.take([512, 500 + sample % 20, 512]));
        assert_eq!(calibration.rest(), None);
        (0..SAMPLES).for_each(|_| calibration.take([512; 3]));
        assert_eq!(calibration.rest(), Some([512.0; 3]));
    }
}
