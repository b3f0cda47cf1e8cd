//! Finds modules that command the same joints without a multiplexer between them.

use std::any::TypeId;
use std::collections::BTreeSet;

use downbeat_executor::{Core, GraphEdge, LifecycleState, SettingValue};
use downbeat_msgs::sensor_msgs::msg::JointState;

use super::file::{ModuleEntry, RobotFile};

/// The kind that decides between commands.
const MUX: &str = "joint_command_mux";

/// Returns a sentence with path and line for each topic of commands on which several modules command the same
/// joints: of their commands the last one applies, so the joints go back and forth; of two controllers, which
/// claim their joints, one is deactivated.
pub(super) fn rival_commanders(file: &RobotFile, core: &Core) -> Vec<String> {
    let graph = core.graph();
    let entry = |module: usize| {
        let name = &graph.modules.get(module)?.name;
        file.modules.iter().find(|entry| entry.name == *name)
    };
    let commands = core.topics().filter(|topic| topic.message_type_id == TypeId::of::<JointState>());
    let mut sentences = Vec::new();
    for topic in commands {
        let Some(index) = graph.topics.iter().position(|known| known.name == *topic.name) else { continue };
        let (mut publishers, mut is_obeyed, mut is_followed) = (Vec::new(), false, false);
        for edge in &graph.edges {
            match *edge {
                GraphEdge::Publishes { module, topic } if topic == index => publishers.extend(entry(module)),
                GraphEdge::Subscribes { module, topic } if topic == index => {
                    let drives = |entry: &ModuleEntry| entry.kind.uses_device() || entry.kind.name() == MUX;
                    is_obeyed |= entry(module).is_some_and(drives);
                    is_followed |= entry(module).is_some_and(|entry| entry.kind.claims_joints());
                }
                _ => {}
            }
        }
        // What a device publishes are measurements.
        publishers.retain(|publisher| !publisher.kind.uses_device());
        // The reference of a controller that commands the servos: only other controllers publish nothing but
        // commands.
        if !is_obeyed {
            publishers.retain(|publisher| publisher.kind.claims_joints());
        }
        if (is_obeyed || is_followed)
            && let Some((first, second, joints)) = rivals(core, &publishers)
        {
            let joints = match joints {
                Some(joints) => format!("command {} on", joints.join(", ")),
                None => "may command the same joints on".to_owned(),
            };
            let (outcome, or) = match claim_joints(first, second) {
                true => (
                    format!("\"{}\" is deactivated", second.name),
                    ", or start one of them with `initial_state = \"inactive\"`",
                ),
                false => ("the last command applies".to_owned(), ""),
            };
            let problem = format!(
                "\"{}\" and \"{}\" both {joints} topic \"{}\", and {outcome}: let each publish on a topic of its own (`remap`), \
                 and name these in the setting `sources` of a module of kind \"{MUX}\"{or}",
                first.name, second.name, topic.name
            );
            sentences.push(file.error_at(&second.at(second.line), problem).to_string());
        }
    }
    sentences
}

fn claim_joints(first: &ModuleEntry, second: &ModuleEntry) -> bool {
    first.kind.claims_joints() && second.kind.claims_joints()
}

/// Two of the modules that have joints in common, and these; `None` where the joints of one are unknown.
/// Controllers that claim their joints do not meet if one of them does not start active.
fn rivals<'a>(
    core: &Core,
    publishers: &[&'a ModuleEntry],
) -> Option<(&'a ModuleEntry, &'a ModuleEntry, Option<Vec<String>>)> {
    for (position, second) in publishers.iter().enumerate() {
        for first in &publishers[..position] {
            let starts = |entry: &ModuleEntry| entry.options().initial_state == LifecycleState::Active;
            if claim_joints(first, second) && !(starts(first) && starts(second)) {
                continue;
            }
            let (Some(ours), Some(theirs)) = (joints(core, first), joints(core, second)) else {
                return Some((first, second, None));
            };
            let common: Vec<String> = ours.intersection(&theirs).cloned().collect();
            if !common.is_empty() {
                return Some((first, second, Some(common)));
            }
        }
    }
    None
}

/// The joints that a module names in its settings, as controllers do.
fn joints(core: &Core, module: &ModuleEntry) -> Option<BTreeSet<String>> {
    let settings = core.settings(&module.name).unwrap_or_default();
    let lists = settings.into_iter().filter_map(|setting| match setting.value {
        SettingValue::Texts(joints) if names_joints(&setting.name) => Some(joints),
        _ => None,
    });
    let joints: BTreeSet<String> = lists.flatten().collect();
    (!joints.is_empty()).then_some(joints)
}

fn names_joints(setting: &str) -> bool {
    setting == "joints" || setting.ends_with("_joints") || setting.ends_with("wheel_names")
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;
    use crate::Catalog;
    use crate::file::Source;
    use std::path::Path;

    const HARDWARE: &str = "[robot]\nname = \"r\"\n[[module]]\nkind = \"darwin_op\"\nname = \"hardware\"\n";

    fn sentences(modules: &str) -> Vec<String> {
        let source = Source::new(Path::new("robot.toml"), format!("{HARDWARE}{modules}"));
        let file = RobotFile::parse(source, &Catalog::built_in()).unwrap().0;
        let core = file.build_modules(Core::new(), |_, _| None).unwrap();
        rival_commanders(&file, &core)
    }

    fn forward(name: &str, joints: &str) -> String {
        format!(
            "[[module]]\nkind = \"forward_command\"\nname = \"{name}\"\nsettings = {{ joints = [{joints}] }}\n"
        )
    }

    #[test]
    fn two_modules_that_command_the_same_joints_are_named_with_the_multiplexer() {
        let both = [forward("arm", "\"lift\", \"turn\""), forward("hand", "\"grip\", \"turn\"")].concat();
        let expected = "robot.toml:12: \"arm\" and \"hand\" both command turn on topic \"joint_commands\", and \"hand\" is \
                        deactivated: let each publish on a topic of its own (`remap`), and name these in the setting `sources` of a \
                        module of kind \"joint_command_mux\", or start one of them with `initial_state = \"inactive\"`";
        assert_eq!(sentences(&both), [expected]);
        let inactive = both.replace("name = \"hand\"\n", "name = \"hand\"\ninitial_state = \"inactive\"\n");
        assert!(sentences(&inactive).is_empty());
        let unknown = forward("arm", "\"lift\"")
            + "[[module]]\nkind = \"gait\"\nremap = { \"gait/joint_commands\" = \"joint_commands\" }\n";
        let found = sentences(&unknown);
        assert!(
            found[0].contains("\"arm\" and \"gait\" both may command the same joints on topic")
                && found[0].contains("the last command applies"),
            "{found:?}"
        );
    }

    #[test]
    fn two_controllers_that_command_another_one_are_rivals_too() {
        let by = |name: &str| forward(name, "\"turn\"") + "remap = { joint_commands = \"head/reference\" }\n";
        let both = [by("arm"), by("hand"), forward("head", "\"turn\"")].concat();
        let found = sentences(&both);
        assert!(
            found.len() == 1
                && found[0].contains("\"arm\" and \"hand\" both command turn on topic \"head/reference\""),
            "{found:?}"
        );
    }

    #[test]
    fn modules_with_joints_of_their_own_or_behind_a_multiplexer_are_not() {
        assert!(sentences(&[forward("arm", "\"lift\""), forward("hand", "\"grip\"")].concat()).is_empty());
        let multiplexed = "[[module]]\nkind = \"gait\"\n[[module]]\nkind = \"motions\"\n[[module]]\nkind = \"joint_command_mux\"\n\
                           remap = { joint_goals = \"joint_commands\", joint_commands = \"outside\" }\n";
        assert!(sentences(multiplexed).is_empty(), "{:?}", sentences(multiplexed));
    }
}
