//! Motions as messages, and as tables of their file.

use super::Path;
use super::file::Motions;
use super::motion::{Balance, Interpolation, Motion};
use crate::joints::{Joint, Joints};
use downbeat_msgs::downbeat_interfaces::msg::{Motion as MotionMessage, MotionFrame};
use toml_edit::{ArrayOfTables, DocumentMut, InlineTable, Item, Table, value};

/// The most poses of a motion that is shown.
const MOST_POSES: usize = 500;
/// The shortest time between two of them, in s.
const SHORTEST_PERIOD: f64 = 0.02;

/// A motion as a message.
pub(super) fn message(name: &str, motion: &Motion, mirror_of: Option<&str>) -> MotionMessage {
    let Balance { tilt, rate } = motion.balance.unwrap_or(Balance { tilt: 0.0, rate: 0.0 });
    let interpolation = match motion.interpolation {
        Interpolation::Smooth => "smooth",
        Interpolation::Through => "through",
        Interpolation::Linear => "linear",
    };
    let frames = motion.frames.iter().map(|frame| MotionFrame {
        duration: frame.duration,
        pause: frame.pause,
        positions: frame.positions.iter().map(|position| position.unwrap_or(f64::NAN)).collect(),
    });
    MotionMessage {
        name: name.to_owned(),
        about: motion.about.clone(),
        mirror_of: mirror_of.unwrap_or_default().to_owned(),
        interpolation: interpolation.to_owned(),
        stiffness: motion.stiffness,
        balance_tilt: tilt,
        balance_rate: rate,
        frames: frames.collect(),
    }
}

/// The motions with another one, or one replaced. Everything else in their file stays as it is.
pub(super) fn with(
    motions: &Motions,
    file: &str,
    edited: &MotionMessage,
    joints: &Joints,
) -> Result<Motions, String> {
    let name = &edited.name;
    if name.is_empty() || !name.chars().all(|c| c.is_ascii_alphanumeric() || "_-".contains(c)) {
        return Err(format!("{name:?} is no name of a motion; use letters, digits, _ and -"));
    }
    let is_whole = |frame: &MotionFrame| frame.positions.len() == joints.len();
    if let Some(number) = edited.frames.iter().position(|frame| !is_whole(frame)) {
        return Err(format!(
            "frame {} does not have {} positions, one for each joint",
            number + 1,
            joints.len()
        ));
    }
    let mut document: DocumentMut = motions.text().parse().map_err(|error| format!("{file}: {error}"))?;
    let entry = document.entry(name).or_insert(Item::Table(Table::new())).as_table_mut();
    let table = entry.ok_or_else(|| format!("{file}: \"{name}\" is not written as a table [{name}]"))?;
    write(table, edited, joints);
    let text = document.to_string();
    Motions::parse(file, &text, joints).map_err(|error| error.to_string())
}

fn write(table: &mut Table, edited: &MotionMessage, joints: &[Joint]) {
    let mut set = |key: &str, is_default: bool, mut new: Item| match table.get_mut(key) {
        _ if is_default => drop(table.remove(key)),
        Some(old) => {
            // With the comment behind it.
            if let (Some(old), Some(new)) = (old.as_value(), new.as_value_mut()) {
                *new.decor_mut() = old.decor().clone();
            }
            *old = new;
        }
        None => drop(table.insert(key, new)),
    };
    set("mirror_of", edited.mirror_of.is_empty(), value(&edited.mirror_of));
    set("about", edited.about.is_empty(), value(&edited.about));
    set("interpolation", ["", "smooth"].contains(&&*edited.interpolation), value(&edited.interpolation));
    set("stiffness", [0.0, 1.0].contains(&edited.stiffness), value(edited.stiffness));
    let [tilt, rate] = [edited.balance_tilt, edited.balance_rate];
    let balance: InlineTable = [("tilt", tilt), ("rate", rate)].into_iter().collect();
    set("balance", tilt == 0.0 && rate == 0.0, value(balance));
    let mut frames = ArrayOfTables::new();
    let mut before = vec![f64::NAN; joints.len()];
    for MotionFrame { duration, pause, positions } in &edited.frames {
        let mut frame = Table::new();
        frame.insert("duration_s", value(*duration));
        if *pause != 0.0 {
            frame.insert("pause_s", value(*pause));
        }
        let mut angles = InlineTable::new();
        for ((joint, position), before) in joints.iter().zip(positions).zip(&mut before) {
            let angle = hundredths(*position, joint);
            // A joint keeps the angle that it is not given.
            if !position.is_nan() && angle != *before {
                angles.insert(&joint.name, angle.into());
                *before = angle;
            }
        }
        frame.insert("degrees", value(angles));
        frames.push(frame);
    }
    set("frame", edited.frames.is_empty(), Item::ArrayOfTables(frames));
}

/// An angle in degrees with two decimals; a limit stays inside.
fn hundredths(position: f64, joint: &Joint) -> f64 {
    let [lower, upper] = joint.limits.map(f64::to_degrees);
    let rounded = (position.to_degrees() * 100.0).round();
    let inside = if position < joint.limits[0] || position > joint.limits[1] {
        rounded
    } else {
        rounded.clamp((lower * 100.0).ceil(), (upper * 100.0).floor())
    };
    inside / 100.0
}

/// All joints, pose after pose, from the first frame of a motion to its end, and the time between two poses.
pub(super) fn poses(motion: &Motion, joints: &Joints) -> (f64, Vec<f64>) {
    let stand = joints.stand();
    let start = motion.frames[0].positions.iter().zip(&stand);
    let start: Vec<f64> = start.map(|(position, stand)| position.unwrap_or(*stand)).collect();
    let path = Path::new(motion, &start, 0.0);
    let (from, to) = (motion.frames[0].duration, path.duration());
    let period = ((to - from) / MOST_POSES as f64).max(SHORTEST_PERIOD);
    let count = ((to - from) / period).floor() as usize;
    let poses = (0..=count).flat_map(|number| path.pose(from + number as f64 * period));
    (period, poses.chain(path.pose(to)).collect())
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]

    use super::*;
    use crate::humanoid::Humanoid;
    use std::sync::Arc;

    const FILE: &str = "\
# Of a robot that nods.

[nod]
about = \"nods\" # politely

[[nod.frame]]
duration_s = 1.0
degrees = { head_tilt = 10 }

# The other way.
[shake]
interpolation = \"through\"

[[shake.frame]]
duration_s = 0.5
degrees = { head_pan = 20 }

[shake_left]
mirror_of = \"shake\"
";

    fn joints() -> Arc<Joints> {
        Arc::clone(Humanoid::darwin_op().joints())
    }

    fn file() -> Motions {
        Motions::parse("a.toml", FILE, &joints()).unwrap()
    }

    fn frame(duration: f64, angles: &[(&str, f64)]) -> MotionFrame {
        let joints = joints();
        let mut positions = vec![f64::NAN; joints.len()];
        for (joint, degrees) in angles {
            positions[joints.index_of(joint).unwrap()] = f64::to_radians(*degrees);
        }
        MotionFrame { duration, pause: 0.0, positions }
    }

    #[test]
    fn a_motion_that_is_not_changed_stays_the_same() {
        for (name, mirror_of) in [("nod", None), ("shake", None), ("shake_left", Some("shake"))] {
            let mut sent = message(name, file().get(name).unwrap(), mirror_of);
            if mirror_of.is_some() {
                sent.frames.clear();
            }
            let edited = with(&file(), "a.toml", &sent, &joints()).unwrap();
            assert!(edited.names().all(|name| edited.get(name) == file().get(name)), "{}", edited.text());
        }
    }

    #[test]
    fn one_motion_is_replaced_and_the_rest_of_the_file_stays() {
        let mut sent = message("nod", file().get("nod").unwrap(), None);
        let up = frame(0.5, &[("head_tilt", 10.0), ("head_pan", 5.0)]);
        sent.frames = vec![up, frame(0.25, &[("head_tilt", 20.004), ("head_pan", 5.0)])];
        let edited = with(&file(), "a.toml", &sent, &joints()).unwrap();
        let expected = FILE.replace(
            "duration_s = 1.0\ndegrees = { head_tilt = 10 }\n",
            "duration_s = 0.5\ndegrees = { head_pan = 5.0, head_tilt = 10.0 }\n\n[[nod.frame]]\nduration_s = 0.25\ndegrees = { head_tilt = 20.0 }\n",
        );
        assert_eq!(edited.text(), expected);
    }

    #[test]
    fn another_motion_follows_the_others() {
        let sent = MotionMessage {
            name: "look".into(),
            interpolation: "linear".into(),
            frames: vec![frame(1.0, &[("head_pan", -30.0)])],
            ..MotionMessage::default()
        };
        let edited = with(&file(), "a.toml", &sent, &joints()).unwrap();
        let added = "\n[look]\ninterpolation = \"linear\"\n\n[[look.frame]]\nduration_s = 1.0\ndegrees = { head_pan = -30.0 }\n";
        assert_eq!(edited.text(), format!("{FILE}{added}"));
    }

    #[test]
    fn what_cannot_be_played_is_refused() {
        let refused = |name: &str, frames: Vec<MotionFrame>| {
            let sent = MotionMessage { name: name.into(), frames, ..MotionMessage::default() };
            with(&file(), "a.toml", &sent, &joints()).unwrap_err()
        };
        let nod = || vec![frame(1.0, &[("head_tilt", 10.0)])];
        assert!(refused("", nod()).contains("is no name"));
        assert!(refused("a b", nod()).contains("is no name"));
        assert!(refused("a", Vec::new()).contains("has no frames"));
        assert!(refused("a", vec![MotionFrame::default()]).contains("frame 1 does not have 20 positions"));
        let beyond = vec![frame(1.0, &[("head_tilt", 170.0)])];
        assert!(refused("a", beyond).contains("head_tilt = 170 is beyond the limits"));
        let fast = vec![frame(1.0, &[("head_pan", -60.0)]), frame(0.02, &[("head_pan", 60.0)])];
        assert!(refused("a", fast).contains("head_pan would turn at"));
        let later = [nod(), vec![frame(1.0, &[("head_pan", 10.0)])]].concat();
        assert!(refused("a", later).contains("the first frame of the motion must name head_pan"));
        assert!(refused("a", vec![frame(f64::NAN, &[])]).contains("duration_s"));
    }

    #[test]
    fn a_limit_stays_inside() {
        let joints = joints();
        for joint in joints.iter() {
            for limit in joint.limits {
                let [lower, upper] = joint.limits;
                let written = hundredths(limit, joint).to_radians();
                assert!(
                    lower <= written && written <= upper && (written - limit).abs() < 2e-4,
                    "{}",
                    joint.name
                );
            }
        }
    }

    #[test]
    fn the_poses_begin_at_the_first_frame_and_end_at_the_last() {
        let joints = joints();
        let sent = MotionMessage {
            name: "look".into(),
            frames: vec![frame(1.0, &[("head_pan", -30.0)]), frame(1.0, &[("head_pan", 30.0)])],
            ..MotionMessage::default()
        };
        let motions = with(&file(), "a.toml", &sent, &joints).unwrap();
        let (period, poses) = poses(motions.get("look").unwrap(), &joints);
        let pan = joints.index_of("head_pan").unwrap();
        let pans: Vec<f64> = poses.chunks(joints.len()).map(|pose| pose[pan].to_degrees()).collect();
        assert_eq!(period, 0.02);
        assert!((50..=52).contains(&pans.len()), "{}", pans.len());
        assert!((pans[0] + 30.0).abs() < 1e-9 && (pans[pans.len() - 1] - 30.0).abs() < 1e-9);
        assert!(pans.is_sorted());
    }
}
