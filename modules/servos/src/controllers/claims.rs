//! Which controller commands which joints: a joint of a topic of commands belongs to one active controller at
//! a time.
//!
//! A controller claims its joints when it is activated, and gives them back when it is deactivated, fails or
//! leaves, as controllers of ros2_control do with command interfaces. While another one has them its
//! activation is refused. Of two that are activated in the same cycle, the first of the robot file has them,
//! and the other deactivates itself.
//!
//! In cores without this mechanism, and on threads of their own, controllers claim nothing.

use downbeat_executor::{
    Context, Mechanism, MechanismKey, Module, ModuleChange, ModuleId, Port, Setup, SyncPhase, Transition,
    TransitionError, Version,
};
use std::collections::BTreeMap;

/// The mechanism that keeps the claims; see the [module page](self).
#[derive(Debug, Default)]
pub struct Claims {
    held: Held,
}

/// The topic of commands and the joint.
type Claim = (String, String);

/// By claim, the controller that has it.
type Held = BTreeMap<Claim, (ModuleId, String)>;

/// What a controller asks for in a cycle.
#[derive(Debug, Default)]
pub struct ClaimsPort(Vec<Request>);

#[derive(Debug)]
enum Request {
    Take(Vec<Claim>),
    GiveBack,
}

impl Port for ClaimsPort {
    fn changed(&mut self, change: ModuleChange<'_>) -> bool {
        let has_failed = matches!(change, ModuleChange::Panicked);
        if has_failed {
            self.0 = vec![Request::GiveBack];
        }
        has_failed
    }
}

impl Mechanism for Claims {
    type View = BTreeMap<Claim, String>;
    type Port = ClaimsPort;

    const NAME: &'static str = "claims of joints";
    const VERSION: Version = Version::new(1, 0);

    fn view(&self) -> Self::View {
        BTreeMap::new()
    }

    fn sync(&mut self, phase: &mut SyncPhase<'_>) {
        let mut requests = Vec::new();
        phase.each_port::<Self>(|module, port| {
            requests.extend(port.0.drain(..).map(|request| (module, request)));
        });
        if requests.is_empty() {
            return;
        }
        for (module, request) in requests {
            match request {
                Request::GiveBack => self.held.retain(|_, (holder, _)| *holder != module),
                Request::Take(claims) => {
                    let is_free = claims
                        .iter()
                        .all(|claim| self.held.get(claim).is_none_or(|(holder, _)| *holder == module));
                    let Some(name) = phase.module_name(module).filter(|_| is_free) else { continue };
                    self.held.extend(claims.into_iter().map(|claim| (claim, (module, name.to_owned()))));
                }
            }
        }
        self.show(phase);
    }

    fn module_left(&mut self, module: ModuleId, phase: &mut SyncPhase<'_>) {
        let before = self.held.len();
        self.held.retain(|_, (holder, _)| *holder != module);
        if self.held.len() != before {
            self.show(phase);
        }
    }
}

impl Claims {
    fn show(&self, phase: &mut SyncPhase<'_>) {
        let shown = self.held.iter().map(|(claim, (_, name))| (claim.clone(), name.clone()));
        *phase.view::<Self>() = shown.collect();
    }
}

/// The claims of a controller.
#[derive(Default)]
pub(super) struct OwnClaims {
    key: Option<MechanismKey<Claims>>,
    claims: Vec<Claim>,
    has_lost: bool,
}

impl std::fmt::Debug for OwnClaims {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("OwnClaims").finish_non_exhaustive()
    }
}

impl OwnClaims {
    /// Declares, in a setup, that the controller commands these joints on a topic of its own.
    pub(super) fn declare<M: Module>(setup: &mut Setup<'_, M>, topic: &str, joints: &[String]) -> Self {
        let topic = setup.remapped(topic);
        let claims = joints.iter().map(|joint| (topic.clone(), joint.clone())).collect();
        Self { key: setup.mechanism(Claims::VERSION).ok(), claims, has_lost: false }
    }

    /// Takes the joints, in the controller's activation.
    pub(super) fn take<P>(&mut self, ctx: &mut Context<'_, P>) -> Result<(), TransitionError> {
        self.has_lost = false;
        let Some(key) = self.key else { return Ok(()) };
        if let Some(((topic, joint), holder)) = self.held_by_another(key, ctx) {
            let reason = format!(
                "\"{holder}\" commands the joint \"{joint}\" on \"{topic}\": deactivate it first, or let this one publish on \
                 another topic (`remap`)"
            );
            return Err(TransitionError::new(reason));
        }
        ctx.port(key).0.push(Request::Take(self.claims.clone()));
        Ok(())
    }

    /// Gives the joints back, in the controller's deactivation.
    pub(super) fn give_back<P>(&self, ctx: &mut Context<'_, P>) {
        if let Some(key) = self.key {
            ctx.port(key).0.push(Request::GiveBack);
        }
    }

    /// True if the controller may command. One that was activated together with another one of the same
    /// joints and has not got them deactivates itself.
    pub(super) fn are_granted<P>(&mut self, ctx: &mut Context<'_, P>) -> bool {
        let Some(key) = self.key else { return true };
        let Some(((topic, joint), holder)) = self.held_by_another(key, ctx) else { return true };
        if !std::mem::replace(&mut self.has_lost, true) {
            tracing::error!(
                "is deactivated: \"{holder}\" commands the joint \"{joint}\" on \"{topic}\": activate one of them only \
                 (`initial_state = \"inactive\"`), or let them publish on different topics (`remap`)"
            );
            let name = ctx.module_name().to_owned();
            ctx.transition(&name, Transition::Deactivate);
        }
        false
    }

    fn held_by_another<P>(&self, key: MechanismKey<Claims>, ctx: &Context<'_, P>) -> Option<(Claim, String)> {
        let held = ctx.view(key);
        self.claims.iter().find_map(|claim| {
            let holder = held.get(claim).filter(|holder| **holder != *ctx.module_name())?;
            Some((claim.clone(), holder.clone()))
        })
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;
    use crate::controllers::forward_command::ForwardCommandController;
    use crate::controllers::joint_trajectory::JointTrajectoryController;
    use crate::testing::{Collector, core_at_zero};
    use downbeat_executor::{
        Core, LifecycleState, ManualClock, ModuleOptions, SettingValue, TransitionRefused,
    };
    use downbeat_msgs::sensor_msgs::msg::JointState;
    use downbeat_msgs::std_msgs::msg::Float64MultiArray;
    use downbeat_msgs::trajectory_msgs::msg::{JointTrajectory, JointTrajectoryPoint};
    use std::time::Duration;

    /// A joint that is where it was commanded to be, and what it was commanded.
    struct Arm {
        core: Core,
        clock: ManualClock,
        commands: Collector<JointState>,
        position: f64,
        commanded: Vec<f64>,
    }

    fn options(initial_state: LifecycleState, remaps: &[(&str, &str)]) -> ModuleOptions {
        let joints: SettingValue = vec!["elbow".to_owned()].into();
        ModuleOptions {
            settings: [("joints".to_owned(), joints)].into(),
            remaps: remaps.iter().map(|(from, to)| ((*from).to_owned(), (*to).to_owned())).collect(),
            initial_state,
            ..ModuleOptions::default()
        }
    }

    impl Arm {
        fn new(add: impl FnOnce(&mut Core)) -> Self {
            let (core, clock) = core_at_zero();
            let mut core = core.with_mechanism(Claims::default());
            add(&mut core);
            let commands = Collector::add(&mut core, "joint_commands");
            Self { core, clock, commands, position: 0.25, commanded: Vec::new() }
        }

        /// Lets the time pass in periods of 8 ms.
        fn run(&mut self, periods: u32) {
            let states = self.core.inlet("joint_states").unwrap();
            for _ in 0..periods {
                let (name, position) = (vec!["elbow".into()], vec![self.position]);
                states.publish(JointState { name, position, ..JointState::default() }).unwrap();
                self.clock.advance(Duration::from_millis(8));
                (0..3).for_each(|_| self.core.cycle().unwrap());
                for command in self.commands.take() {
                    self.position = command.position[0];
                    self.commanded.push(self.position);
                }
            }
        }

        fn make(
            &mut self,
            module: &str,
            transition: Transition,
        ) -> Result<LifecycleState, TransitionRefused> {
            let made = self.core.handle().transition(module, transition);
            self.run(2);
            made.try_take().unwrap()
        }

        fn state(&self, module: &str) -> LifecycleState {
            self.core.modules().iter().find(|known| *known.name == *module).unwrap().state
        }

        /// Sends the trajectory controller to a position within 0.4 s.
        fn go(&mut self, position: f64) {
            let point = JointTrajectoryPoint {
                positions: vec![position],
                time_from_start: downbeat_msgs::builtin_interfaces::msg::Duration {
                    sec: 0,
                    nanosec: 400_000_000,
                },
                ..JointTrajectoryPoint::default()
            };
            let joint_names = vec!["elbow".into()];
            let trajectory =
                JointTrajectory { joint_names, points: vec![point], ..JointTrajectory::default() };
            self.core.inlet("trajectory/joint_trajectory").unwrap().publish(trajectory).unwrap();
            self.run(60);
        }

        fn forward(&mut self, position: f64) {
            let data = vec![position];
            let array = Float64MultiArray { data, ..Float64MultiArray::default() };
            self.core.inlet("forward/commands").unwrap().publish(array).unwrap();
            self.run(2);
        }

        fn largest_step(&mut self) -> f64 {
            let steps = self.commanded.windows(2).map(|pair| (pair[1] - pair[0]).abs());
            let largest = steps.fold(0.0, f64::max);
            self.commanded.clear();
            largest
        }
    }

    fn both(forward: LifecycleState) -> impl FnOnce(&mut Core) {
        move |core| {
            let trajectory = JointTrajectoryController::default;
            core.add_with("trajectory", trajectory(), options(LifecycleState::Active, &[])).unwrap();
            core.add_with("forward", ForwardCommandController::default(), options(forward, &[])).unwrap();
        }
    }

    #[test]
    fn controllers_of_one_joint_are_switched_without_a_jump() {
        let mut arm = Arm::new(both(LifecycleState::Inactive));
        arm.run(2);
        arm.go(0.5);
        assert!((arm.position - 0.5).abs() < 1e-6, "{}", arm.position);
        let refused = arm.make("forward", Transition::Activate).unwrap_err().to_string();
        for words in
            ["\"trajectory\" commands the joint \"elbow\" on \"joint_commands\"", "deactivate it first"]
        {
            assert!(refused.contains(words), "{refused}");
        }
        assert_eq!(arm.make("trajectory", Transition::Deactivate), Ok(LifecycleState::Inactive));
        assert_eq!(arm.make("forward", Transition::Activate), Ok(LifecycleState::Active));
        assert!(arm.largest_step() < 0.01);
        for step in 1..=10 {
            arm.forward(0.5 + 0.01 * f64::from(step));
        }
        assert!(arm.make("trajectory", Transition::Activate).is_err());
        arm.make("forward", Transition::Deactivate).unwrap();
        arm.make("trajectory", Transition::Activate).unwrap();
        // From where the joint is now, not from where this controller had left it.
        arm.go(0.7);
        assert!((arm.position - 0.7).abs() < 1e-6 && arm.largest_step() < 0.0101, "{}", arm.position);
    }

    #[test]
    fn of_two_that_start_together_the_second_is_deactivated() {
        let mut arm = Arm::new(both(LifecycleState::Active));
        arm.run(5);
        assert_eq!(arm.state("forward"), LifecycleState::Active, "it notices when it is to command");
        arm.forward(0.9);
        arm.run(3);
        assert_eq!(
            (arm.state("trajectory"), arm.state("forward")),
            (LifecycleState::Active, LifecycleState::Inactive)
        );
        assert_eq!(arm.position, 0.25, "nothing was commanded");
        drop(arm.core.handle().remove("trajectory"));
        arm.run(2);
        arm.make("forward", Transition::Activate).unwrap();
        arm.forward(0.9);
        assert_eq!(arm.position, 0.9, "the claim of a module that was removed is free");
    }

    #[test]
    fn the_commands_of_a_controller_are_the_reference_of_another() {
        let mut arm = Arm::new(|core| {
            let upper = options(LifecycleState::Active, &[("joint_commands", "forward/reference")]);
            core.add_with("trajectory", JointTrajectoryController::default(), upper).unwrap();
            let lower = options(LifecycleState::Active, &[]);
            core.add_with("forward", ForwardCommandController::default(), lower).unwrap();
        });
        arm.run(2);
        arm.go(0.5);
        assert!((arm.position - 0.5).abs() < 1e-6 && arm.largest_step() < 0.02, "{}", arm.position);
        assert_eq!(
            (arm.state("trajectory"), arm.state("forward")),
            (LifecycleState::Active, LifecycleState::Active)
        );
    }
}
