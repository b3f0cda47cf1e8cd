//! Selection of a running robot.

use crate::inspect::{RunningRobot, SocketDirectory};
use anyhow::bail;

/// The running robot with that name or process id; without one, the only running robot.
pub(crate) fn choose(wanted: Option<&str>) -> anyhow::Result<RunningRobot> {
    choose_among(wanted, SocketDirectory::open()?.running()?)
}

fn choose_among(wanted: Option<&str>, robots: Vec<RunningRobot>) -> anyhow::Result<RunningRobot> {
    if robots.is_empty() {
        bail!("no robot of this user is running on this machine; start one with `downbeat run ROBOT.toml`");
    }
    let is_wanted = |robot: &RunningRobot| {
        wanted.is_none_or(|wanted| robot.name == wanted || robot.pid.to_string() == wanted)
    };
    let (matching, others): (Vec<_>, Vec<_>) = robots.into_iter().partition(is_wanted);
    match (<[RunningRobot; 1]>::try_from(matching), wanted) {
        (Ok([robot]), _) => Ok(robot),
        (Err(none), Some(wanted)) if none.is_empty() => {
            bail!("no robot \"{wanted}\" is running on this machine; running: {}", list(&others))
        }
        (Err(several), _) => {
            bail!("several robots are running: {}; give a name or a process id", list(&several))
        }
    }
}

fn list(robots: &[RunningRobot]) -> String {
    robots.iter().map(ToString::to_string).collect::<Vec<_>>().join(", ")
}

#[cfg(test)]
mod tests {
    use super::*;

    fn of(wanted: Option<&str>, robots: &[(&str, u32)]) -> Result<u32, String> {
        let running = |&(name, pid): &(&str, u32)| RunningRobot { name: name.into(), pid, socket: "".into() };
        let robots = robots.iter().map(running).collect();
        choose_among(wanted, robots).map(|robot| robot.pid).map_err(|error| error.to_string())
    }

    #[test]
    fn the_only_robot_is_chosen_unless_another_is_named() {
        assert_eq!(of(None, &[("nao", 7)]), Ok(7));
        assert_eq!(of(Some("nao"), &[("darwin", 5), ("nao", 7)]), Ok(7));
        assert_eq!(of(Some("5"), &[("darwin", 5), ("darwin", 6)]), Ok(5));
    }

    #[test]
    fn candidates_are_listed_if_the_choice_is_ambiguous() {
        assert!(of(None, &[]).is_err_and(|error| error.contains("downbeat run")));
        let error = of(Some("nao"), &[("darwin", 5)]);
        assert!(error.is_err_and(|error| error.contains("\"nao\"") && error.contains("darwin (process 5)")));
        let error = of(Some("darwin"), &[("darwin", 5), ("darwin", 6), ("nao", 7)]);
        assert!(error.is_err_and(|error| error.contains("process 6") && !error.contains("nao")));
        assert!(of(None, &[("darwin", 5), ("nao", 7)]).is_err_and(|error| error.contains("several robots")));
    }
}
