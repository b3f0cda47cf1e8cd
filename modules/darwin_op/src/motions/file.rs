//! Files of motions: key frames by joint name, in TOML.
//!
//! ```toml
//! [wave]
//! about = "waves with the right arm"
//! interpolation = "smooth"    # the default; "through" and "linear" do not stop at each frame
//! stiffness = 1.0             # the default; 2 holds the joints as with twice the P gain
//! balance = { tilt = 0.5, rate = 0.1 } # the default is none: see below
//!
//! [[wave.frame]]
//! duration_s = 1.0            # from the frame before, or from the present pose
//! pause_s = 0.5               # at this frame; 0 if it is missing
//! degrees = { r_sho_pitch = 130.0, r_el = -40.0 }
//!
//! [[wave.frame]]
//! duration_s = 0.4
//! radians = { r_sho_roll = 0.35 }
//!
//! [wave_left]
//! mirror_of = "wave"
//! ```
//!
//! A name without `r_` or `l_` stands for both joints: the right one gets this angle, the left one its mirror
//! image. A joint keeps the angle of the frame before if a frame does not name it. The first frame must name
//! all joints of its motion, so that the motion is the same from wherever it starts.
//!
//! With `balance` the ankles turn against a trunk that tilts other than it would with a flat sole: by `tilt`
//! rad for each rad that it is off, and by `rate` rad for each rad/s.

use super::motion::{Balance, Frame, Interpolation, Motion};
use super::path::Path;
use crate::joints::Joints;
use downbeat_files::toml::{self, Spanned};
use serde::Deserialize;
use std::collections::BTreeMap;
use std::sync::Arc;

/// The largest stiffness: beyond it, joints oscillate.
pub const MAX_STIFFNESS: f64 = 4.0;

/// The largest gains against a fall: beyond them, ankles oscillate.
pub const MAX_BALANCE: Balance = Balance { tilt: 2.0, rate: 0.5 };

/// The largest file, in bytes.
pub const MAX_BYTES: u64 = 1 << 20;

/// The most frames of all motions of a file, with those of mirror images.
pub const MAX_FRAMES: usize = 50_000;

/// The motions of a robot, by name.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Motions {
    motions: BTreeMap<String, Arc<Motion>>,
    /// The motions that mirror images are of.
    originals: BTreeMap<String, String>,
    text: String,
}

/// What is wrong with a file of motions.
pub use downbeat_files::toml::Error as MotionFileError;

impl Motions {
    /// Reads a file of motions of a robot with these joints.
    ///
    /// # Errors
    /// Returns an error with file and line if it cannot be read, or contains something invalid: an unknown
    /// joint, an angle beyond the limits of a joint, a speed beyond that of its servo.
    pub fn read(file: &str, joints: &Joints) -> Result<Self, MotionFileError> {
        let source = toml::Source::read(file, "motions from", MAX_BYTES)?;
        Self::checked(&Source { source, joints })
    }

    /// Parses the text of a file, which is named in errors.
    ///
    /// # Errors
    /// As [`Motions::read`].
    pub fn parse(file: &str, text: &str, joints: &Joints) -> Result<Self, MotionFileError> {
        Self::checked(&Source { source: toml::Source::new(file, text), joints })
    }

    fn checked(source: &Source<'_>) -> Result<Self, MotionFileError> {
        let entries: BTreeMap<Spanned<String>, MotionEntry> = source.source.parse()?;
        let (mut motions, mut originals) = (BTreeMap::new(), BTreeMap::new());
        for (name, entry) in entries.iter().filter(|(_, entry)| entry.mirror_of.is_none()) {
            motions.insert(name.get_ref().clone(), Arc::new(entry.motion(name, source)?));
        }
        let mut count: usize = motions.values().map(|motion: &Arc<Motion>| motion.frames.len()).sum();
        for (name, entry) in &entries {
            let Some(original) = &entry.mirror_of else { continue };
            let Some(motion) = motions.get(original.get_ref()).filter(|_| entry.frame.is_empty()) else {
                let problem = match entry.frame.is_empty() {
                    false => format!("\"{}\" is a mirror image and cannot have frames", name.get_ref()),
                    true => format!("there is no motion \"{}\" with frames to mirror", original.get_ref()),
                };
                return Err(source.error(original.span().start, problem));
            };
            // Mirror images of a long motion would fill the memory.
            count += motion.frames.len();
            if count > MAX_FRAMES {
                let problem =
                    format!("the motions have more than {MAX_FRAMES} frames with their mirror images");
                return Err(source.error(original.span().start, problem));
            }
            let mirrored = Motion {
                about: entry.about.clone().unwrap_or_else(|| format!("{}, mirrored", motion.about)),
                ..motion.mirrored(source.joints)
            };
            motions.insert(name.get_ref().clone(), Arc::new(mirrored));
            originals.insert(name.get_ref().clone(), original.get_ref().clone());
        }
        Ok(Self { motions, originals, text: source.source.text().to_owned() })
    }

    /// The motion of that name.
    #[must_use]
    pub fn get(&self, name: &str) -> Option<&Arc<Motion>> {
        self.motions.get(name)
    }

    /// The motion whose mirror image the motion of that name is.
    pub(super) fn original_of(&self, name: &str) -> Option<&str> {
        self.originals.get(name).map(String::as_str)
    }

    /// The text of the file.
    pub(super) fn text(&self) -> &str {
        &self.text
    }

    /// A motion that keeps its balance, if there is one.
    pub(super) fn balancing(&self) -> Option<&str> {
        let mut motions = self.motions.iter();
        motions.find(|(_, motion)| motion.balance.is_some()).map(|(name, _)| name.as_str())
    }

    /// The names of all motions, sorted.
    pub fn names(&self) -> impl Iterator<Item = &str> {
        self.motions.keys().map(String::as_str)
    }
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct MotionEntry {
    about: Option<String>,
    #[serde(default)]
    interpolation: Interpolation,
    stiffness: Option<Spanned<f64>>,
    balance: Option<Spanned<Balance>>,
    mirror_of: Option<Spanned<String>>,
    #[serde(default)]
    frame: Vec<Spanned<FrameEntry>>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct FrameEntry {
    duration_s: Spanned<f64>,
    pause_s: Option<Spanned<f64>>,
    #[serde(default)]
    degrees: BTreeMap<Spanned<String>, Spanned<f64>>,
    #[serde(default)]
    radians: BTreeMap<Spanned<String>, Spanned<f64>>,
}

/// The longest duration or pause of a frame, in s.
const LONGEST: f64 = 600.0;

impl MotionEntry {
    fn motion(&self, name: &Spanned<String>, source: &Source<'_>) -> Result<Motion, MotionFileError> {
        let mut frames: Vec<Frame> = Vec::with_capacity(self.frame.len());
        for entry in &self.frame {
            let frame = entry.get_ref().frame(source)?;
            let at = entry.get_ref().duration_s.span().start;
            let frame = match frames.last() {
                None => frame,
                Some(before) => frame.after(before, at, source)?,
            };
            frames.push(frame);
        }
        if frames.is_empty() {
            let name = name.get_ref();
            let problem = format!("motion \"{name}\" has no frames; add a table [[{name}.frame]] for each");
            return Err(source.error(self.frame_error_at(name, source), problem));
        }
        let motion = Motion {
            about: self.about.clone().unwrap_or_default(),
            interpolation: self.interpolation,
            stiffness: self.stiffness(source)?,
            balance: self.balance(source)?,
            frames,
        };
        self.check_speeds(&motion, source)?;
        Ok(motion)
    }

    fn stiffness(&self, source: &Source<'_>) -> Result<f64, MotionFileError> {
        let Some(stiffness) = &self.stiffness else { return Ok(1.0) };
        let value = *stiffness.get_ref();
        if (1.0..=MAX_STIFFNESS).contains(&value) {
            return Ok(value);
        }
        let problem = format!("stiffness = {value} is out of range, 1 to {MAX_STIFFNESS} is allowed");
        Err(source.error(stiffness.span().start, problem))
    }

    fn balance(&self, source: &Source<'_>) -> Result<Option<Balance>, MotionFileError> {
        let Some(balance) = &self.balance else { return Ok(None) };
        let Balance { tilt, rate } = *balance.get_ref();
        if (0.0..=MAX_BALANCE.tilt).contains(&tilt) && (0.0..=MAX_BALANCE.rate).contains(&rate) {
            return Ok(Some(Balance { tilt, rate }));
        }
        let problem = format!(
            "balance is out of range, tilt from 0 to {} and rate from 0 to {} are allowed",
            MAX_BALANCE.tilt, MAX_BALANCE.rate
        );
        Err(source.error(balance.span().start, problem))
    }

    fn frame_error_at(&self, name: &str, source: &Source<'_>) -> usize {
        source.source.text().find(&format!("[{name}]")).unwrap_or(0)
    }

    fn check_speeds(&self, motion: &Motion, source: &Source<'_>) -> Result<(), MotionFileError> {
        let first = motion.frames[0].positions.iter();
        let start: Vec<f64> = first.map(|position| position.unwrap_or(0.0)).collect();
        let path = Path::new(motion, &start, 0.0);
        for (number, entry) in self.frame.iter().enumerate().skip(1) {
            for (index, joint) in source.joints.iter().enumerate() {
                let (speed, max_speed) = (path.peak_speed(number, index), joint.max_speed);
                if speed > max_speed {
                    let (name, duration) = (&joint.name, motion.frames[number].duration);
                    let problem = format!(
                        "{name} would turn at {speed:.1} rad/s, its servo at most at {max_speed}; a duration_s of \
                         {:.2} suffices",
                        duration * speed / max_speed + 0.005
                    );
                    return Err(source.error(entry.get_ref().duration_s.span().start, problem));
                }
            }
        }
        Ok(())
    }
}

impl FrameEntry {
    fn frame(&self, source: &Source<'_>) -> Result<Frame, MotionFileError> {
        let time = |value: &Spanned<f64>, least: f64, name: &str| {
            let seconds = *value.get_ref();
            if (least..=LONGEST).contains(&seconds) {
                return Ok(seconds);
            }
            let problem = format!("{name} = {seconds} is out of range, {least} to {LONGEST} is allowed");
            Err(source.error(value.span().start, problem))
        };
        let joints = source.joints;
        let mut positions = vec![None; joints.len()];
        let named = [(&self.degrees, std::f64::consts::PI / 180.0), (&self.radians, 1.0)];
        for (angles, scale) in named {
            for (name, angle) in angles {
                for (index, sign) in joints_named(name, source)? {
                    let joint = &joints[index];
                    let [min, max] = joint.limits;
                    let position = angle.get_ref() * scale * sign;
                    // A limit as written in degrees is inside.
                    let slack = 1e-9;
                    if !(min - slack..=max + slack).contains(&position) {
                        let (min, max) = (min / scale, max / scale);
                        let problem = format!(
                            "{} = {} is beyond the limits of the joint, {min:.4} to {max:.4}",
                            joint.name,
                            angle.get_ref() * sign
                        );
                        return Err(source.error(angle.span().start, problem));
                    }
                    if positions[index].replace(position).is_some() {
                        let problem = format!("this frame names {} twice", joint.name);
                        return Err(source.error(name.span().start, problem));
                    }
                }
            }
        }
        Ok(Frame {
            duration: time(&self.duration_s, 0.01, "duration_s")?,
            pause: self.pause_s.as_ref().map_or(Ok(0.0), |pause| time(pause, 0.0, "pause_s"))?,
            positions,
        })
    }
}

impl Frame {
    /// This frame with the angles that it takes over from the frame before.
    fn after(self, before: &Self, at: usize, source: &Source<'_>) -> Result<Self, MotionFileError> {
        let mut positions = before.positions.clone();
        for (index, position) in self.positions.iter().enumerate() {
            let Some(position) = position else { continue };
            if positions[index].replace(*position).is_none() {
                let name = &source.joints[index].name;
                let problem = format!("the first frame of the motion must name {name}, as this one does");
                return Err(source.error(at, problem));
            }
        }
        Ok(Self { positions, ..self })
    }
}

/// The joints that a name stands for, with the sign of their angle: one, or one of each side.
fn joints_named(name: &Spanned<String>, source: &Source<'_>) -> Result<Vec<(usize, f64)>, MotionFileError> {
    let named = source.joints.named(name.get_ref());
    named.ok_or_else(|| source.error(name.span().start, source.joints.none_named(name.get_ref())))
}

/// A file, and the robot whose motions it has.
struct Source<'a> {
    source: toml::Source<'a>,
    joints: &'a Joints,
}

impl Source<'_> {
    fn error(&self, position: usize, problem: String) -> MotionFileError {
        self.source.error(position, problem)
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]

    use super::*;
    use crate::humanoid::Humanoid;

    const WAVE: &str = "\
[wave]
interpolation = \"linear\"

[[wave.frame]]
duration_s = 1
degrees = { r_sho_pitch = 90, hip_pitch = -30.0 }

[[wave.frame]]
duration_s = 0.5
pause_s = 0.1
radians = { r_sho_pitch = 1.0 }

[wave_left]
mirror_of = \"wave\"
";

    fn parse(text: &str) -> Result<Motions, MotionFileError> {
        Motions::parse("a.toml", text, Humanoid::darwin_op().joints())
    }

    fn positions(motion: &Motion, frame: usize) -> Vec<(String, f64)> {
        let humanoid = Humanoid::darwin_op();
        let positions = motion.frames[frame].positions.iter().zip(humanoid.joints().iter());
        positions.filter_map(|(position, joint)| Some((joint.name.clone(), (*position)?))).collect()
    }

    /// The error for a file that differs from a good one.
    fn refused(text: &str, instead: &str) -> String {
        assert!(WAVE.contains(text));
        parse(&WAVE.replacen(text, instead, 1)).unwrap_err().to_string()
    }

    #[test]
    fn a_name_without_a_side_is_both_joints_and_frames_take_over_what_they_do_not_name() {
        let motions = parse(WAVE).unwrap();
        let wave = motions.get("wave").unwrap();
        let lean = 30.0_f64.to_radians();
        let expected = [("r_sho_pitch", 1.0), ("r_hip_pitch", -lean), ("l_hip_pitch", lean)];
        assert_eq!(positions(wave, 1), expected.map(|(name, angle)| (name.to_owned(), angle)));
        assert_eq!((wave.duration(), wave.interpolation), (1.6, Interpolation::Linear));
    }

    #[test]
    fn a_motion_keeps_its_balance_with_gains_that_do_not_make_it_swing() {
        let with = |balance: &str| {
            WAVE.replacen("[[wave.frame]]", &format!("balance = {balance}\n\n[[wave.frame]]"), 1)
        };
        let motions = parse(&with("{ tilt = 0.5, rate = 0.1 }")).unwrap();
        let gains = Some(Balance { tilt: 0.5, rate: 0.1 });
        assert_eq!(["wave", "wave_left"].map(|name| motions.get(name).unwrap().balance), [gains; 2]);
        let refused = parse(&with("{ tilt = 5.0, rate = 0.1 }")).unwrap_err().to_string();
        assert_eq!(
            refused,
            "a.toml:4: balance is out of range, tilt from 0 to 2 and rate from 0 to 0.5 are allowed"
        );
    }

    #[test]
    fn a_mirror_image_moves_the_other_side() {
        let motions = parse(WAVE).unwrap();
        let lean = 30.0_f64.to_radians();
        let mirrored = [("l_sho_pitch", -1.0), ("r_hip_pitch", -lean), ("l_hip_pitch", lean)];
        let mirrored = mirrored.map(|(name, angle)| (name.to_owned(), angle));
        assert_eq!(positions(motions.get("wave_left").unwrap(), 1), mirrored);
        assert_eq!(motions.names().collect::<Vec<_>>(), ["wave", "wave_left"]);
    }

    #[test]
    fn errors_name_file_line_and_remedy() {
        assert_eq!(
            refused("r_sho_pitch = 90", "r_shoulder_pitch = 90"),
            "a.toml:6: there is no joint \"r_shoulder_pitch\", did you mean \"r_sho_pitch\"?"
        );
        assert_eq!(
            refused("hip_pitch = -30.0", "l_hip_pitch = -40.0"),
            "a.toml:6: l_hip_pitch = -40 is beyond the limits of the joint, -29.0000 to 100.0000"
        );
        assert_eq!(
            refused("duration_s = 0.5", "duration_s = 0.09"),
            "a.toml:9: r_sho_pitch would turn at 6.3 rad/s, its servo at most at 5.76; a duration_s of 0.10 suffices"
        );
        assert_eq!(
            refused("radians = { r_sho_pitch", "radians = { head_pan"),
            "a.toml:9: the first frame of the motion must name head_pan, as this one does"
        );
        assert_eq!(
            refused("pause_s = 0.1", "pause_s = -1"),
            "a.toml:10: pause_s = -1 is out of range, 0 to 600 is allowed"
        );
        assert_eq!(
            refused("mirror_of = \"wave\"", "mirror_of = \"wav\""),
            "a.toml:14: there is no motion \"wav\" with frames to mirror"
        );
        assert_eq!(
            refused("[wave_left]\nmirror_of = \"wave\"", "[wave_left]"),
            "a.toml:13: motion \"wave_left\" has no frames; add a table [[wave_left.frame]] for each"
        );
        assert_eq!(
            refused("hip_pitch = -30.0", "l_hip_pitch = 0, hip_pitch = -30.0"),
            "a.toml:6: this frame names l_hip_pitch twice"
        );
        let stiff = refused("interpolation = \"linear\"", "stiffness = 5");
        assert!(stiff.ends_with(": stiffness = 5 is out of range, 1 to 4 is allowed"), "{stiff}");
        let unknown = refused("pause_s", "pause");
        assert!(unknown.starts_with("a.toml:10: unknown field `pause`"), "{unknown}");
        let nan = refused("duration_s = 0.5", "duration_s = nan");
        assert!(nan.starts_with("a.toml:9: duration_s = NaN is out of range"), "{nan}");
    }

    #[test]
    fn a_missing_file_is_named() {
        let error =
            Motions::read("/no/such/file.toml", Humanoid::darwin_op().joints()).unwrap_err().to_string();
        assert!(error.starts_with("cannot read motions from /no/such/file.toml: "), "{error}");
    }
}
