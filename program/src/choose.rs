//! Selection of a running robot.

use std::thread;
use std::time::{Duration, Instant};

use anyhow::bail;
use downbeat_robot::inspect::{RunningRobot, SocketDirectory};

/// How long a robot may take from its node, which others see, to its socket.
const PATIENCE: Duration = Duration::from_secs(10);

/// Returns the running robot whose name or process id is `wanted`, or the only running robot if `wanted` is
/// `None`. Waits for a starting robot for at most [`PATIENCE`].
pub(crate) fn choose(wanted: Option<&str>) -> anyhow::Result<RunningRobot> {
    let directory = SocketDirectory::open()?;
    let started = Instant::now();
    loop {
        let starting = directory.starting()?;
        let chosen = choose_among(wanted, directory.running()?);
        if chosen.is_ok() || !is_starting(wanted, &starting) || started.elapsed() >= PATIENCE {
            return chosen;
        }
        thread::sleep(Duration::from_millis(20));
    }
}

fn is_starting(wanted: Option<&str>, starting: &[(String, u32)]) -> bool {
    let is_wanted =
        |name: &str, pid: &u32| wanted.is_none_or(|wanted| name == wanted || pid.to_string() == wanted);
    starting.iter().any(|(name, pid)| is_wanted(name, pid))
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
    fn only_a_robot_that_is_wanted_is_waited_for() {
        let starting = [("nao".to_owned(), 7)];
        assert!(is_starting(None, &starting) && is_starting(Some("nao"), &starting));
        assert!(is_starting(Some("7"), &starting) && !is_starting(Some("darwin"), &starting));
        assert!(!is_starting(None, &[]));
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
