//! Which controllers a request to switch activates and deactivates.

use super::Controller;
use downbeat_executor::LifecycleState;
use downbeat_msgs::controller_manager_msgs::srv::SwitchControllerRequest;

/// A controller and its state.
pub(super) struct Known<'a> {
    pub(super) controller: &'a Controller,
    pub(super) state: LifecycleState,
}

/// What a request comes to.
#[derive(Debug, Default, PartialEq, Eq)]
pub(super) struct Switch {
    pub(super) deactivate: Vec<String>,
    pub(super) activate: Vec<String>,
    /// What was left out, and why.
    pub(super) left_out: Vec<String>,
}

/// How strict a request is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Strictness {
    /// What cannot be done is left out.
    BestEffort,
    /// Nothing is done if something cannot be done.
    Strict,
    /// As strict, and controllers that are in the way are deactivated.
    ForceAuto,
}

impl Strictness {
    /// Chains are resolved by the robot itself, so `AUTO` adds nothing to `STRICT`.
    pub(super) fn of(number: i32) -> Self {
        match number {
            SwitchControllerRequest::STRICT | SwitchControllerRequest::AUTO => Self::Strict,
            SwitchControllerRequest::FORCE_AUTO => Self::ForceAuto,
            _ => Self::BestEffort,
        }
    }
}

/// Decides what to switch.
///
/// # Errors
/// What cannot be done, unless it may be left out.
pub(super) fn plan(known: &[Known<'_>], asked: &SwitchControllerRequest) -> Result<Switch, String> {
    let strictness = Strictness::of(asked.strictness);
    let mut switch = Switch::default();
    let find = |name: &String| known.iter().find(|known| known.controller.name == *name);
    let problem = |switch: &mut Switch, problem: String| match strictness {
        Strictness::BestEffort => {
            switch.left_out.push(problem);
            Ok(())
        }
        Strictness::Strict | Strictness::ForceAuto => Err(problem),
    };
    for name in &asked.deactivate_controllers {
        match find(name).map(|known| known.state) {
            Some(LifecycleState::Active) => switch.deactivate.push(name.clone()),
            // Nothing is to be done.
            Some(_) if strictness == Strictness::BestEffort => {}
            Some(state) => {
                problem(&mut switch, format!("\"{name}\" is {state}, so it cannot be deactivated"))?
            }
            None => problem(&mut switch, unknown(name, known))?,
        }
    }
    for name in &asked.activate_controllers {
        let Some(found) = find(name) else {
            problem(&mut switch, unknown(name, known))?;
            continue;
        };
        match found.state {
            LifecycleState::Inactive => {}
            LifecycleState::Active if switch.deactivate.contains(name) => {}
            LifecycleState::Active if strictness == Strictness::BestEffort => continue,
            LifecycleState::Active => {
                problem(&mut switch, format!("\"{name}\" is active already"))?;
                continue;
            }
            state => {
                problem(&mut switch, format!("\"{name}\" is {state}: configure it first"))?;
                continue;
            }
        }
        let rival = known.iter().find(|other| {
            let name = &other.controller.name;
            let remains = other.state == LifecycleState::Active && !switch.deactivate.contains(name);
            let is_other = *name != found.controller.name && (remains || switch.activate.contains(name));
            is_other && other.controller.commands.iter().any(|one| found.controller.commands.contains(one))
        });
        match rival.map(|rival| &rival.controller.name) {
            None => switch.activate.push(name.clone()),
            Some(rival) if strictness == Strictness::ForceAuto && !switch.activate.contains(rival) => {
                switch.deactivate.push(rival.clone());
                switch.activate.push(name.clone());
            }
            Some(rival) => {
                problem(&mut switch, format!("\"{name}\" commands joints that \"{rival}\" has"))?;
            }
        }
    }
    Ok(switch)
}

pub(super) fn unknown(name: &str, known: &[Known<'_>]) -> String {
    let names: Vec<_> = known.iter().map(|known| &*known.controller.name).collect();
    format!("there is no controller \"{name}\"; there are {}", names.join(", "))
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;
    use LifecycleState::{Active, Inactive, Unconfigured};

    fn controller(name: &str, commands: &[&str]) -> Controller {
        let commands = commands.iter().map(|name| (*name).to_owned()).collect();
        Controller { name: name.to_owned(), module: name.to_owned(), commands, ..Controller::default() }
    }

    fn planned(strictness: i32, deactivate: &[&str], activate: &[&str]) -> Result<Switch, String> {
        let controllers = [
            controller("arm", &["elbow/position"]),
            controller("by_hand", &["elbow/position", "wrist/position"]),
            controller("gripper", &["finger/position"]),
            controller("new", &["finger/effort"]),
        ];
        let states = [Active, Inactive, Inactive, Unconfigured];
        let known: Vec<_> =
            controllers.iter().zip(states).map(|(controller, state)| Known { controller, state }).collect();
        let names = |names: &[&str]| names.iter().map(|name| (*name).to_owned()).collect();
        plan(
            &known,
            &SwitchControllerRequest {
                activate_controllers: names(activate),
                deactivate_controllers: names(deactivate),
                strictness,
                ..SwitchControllerRequest::default()
            },
        )
    }

    #[test]
    fn a_strict_request_is_refused_as_a_whole() {
        let strict = SwitchControllerRequest::STRICT;
        let refused =
            |deactivate: &[&str], activate: &[&str]| planned(strict, deactivate, activate).unwrap_err();
        assert!(refused(&[], &["gripper", "grip"]).contains("no controller \"grip\""));
        assert!(refused(&[], &["new"]).contains("\"new\" is unconfigured: configure it first"));
        assert!(refused(&[], &["arm"]).contains("active already"));
        assert!(refused(&["gripper"], &[]).contains("\"gripper\" is inactive"));
        assert!(refused(&[], &["by_hand"]).contains("\"by_hand\" commands joints that \"arm\" has"));
        let switch = planned(strict, &["arm"], &["by_hand", "gripper"]).unwrap();
        assert_eq!(
            (switch.deactivate, switch.activate),
            (vec!["arm".into()], vec!["by_hand".into(), "gripper".into()])
        );
    }

    #[test]
    fn best_effort_leaves_out_what_cannot_be_done() {
        let switch =
            planned(SwitchControllerRequest::BEST_EFFORT, &["nobody"], &["by_hand", "gripper", "arm"]);
        let switch = switch.unwrap();
        assert_eq!((switch.deactivate.len(), switch.activate), (0, vec!["gripper".to_owned()]));
        assert_eq!(switch.left_out.len(), 2, "{:?}", switch.left_out);
    }

    #[test]
    fn force_auto_deactivates_who_is_in_the_way() {
        let switch = planned(SwitchControllerRequest::FORCE_AUTO, &[], &["by_hand"]).unwrap();
        assert_eq!(
            (switch.deactivate, switch.activate),
            (vec!["arm".to_owned()], vec!["by_hand".to_owned()])
        );
    }
}
