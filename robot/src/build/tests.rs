#![allow(clippy::unwrap_used)]
use std::path::Path;
use std::sync::Mutex;
use std::time::Duration;

use downbeat_executor::{Clock, Context, LifecycleState, ManualClock, Module, Publication, Setup, Time};

use super::*;
use crate::Kind;
use crate::file::Source;

/// Serves "answer", and panics in its first two ticks.
#[derive(Default)]
struct Fragile {
    lives: Option<Publication<u32>>,
}

static PANICS: Mutex<u32> = Mutex::new(0);

impl Module for Fragile {
    type Ports = ();

    fn setup(&mut self, setup: &mut Setup<'_, Self>) -> std::result::Result<(), SetupError> {
        self.lives = Some(setup.publish("lives")?);
        setup.serve("answer", |_: &mut Self, question: &u32, _| Ok(*question))?;
        setup.every(Duration::from_millis(10), Self::tick)
    }
}

impl Fragile {
    fn tick(&mut self, ctx: &mut Context<'_>) {
        let panics = *PANICS.lock().unwrap();
        if panics < 2 {
            *PANICS.lock().unwrap() += 1;
            panic!("tick {panics}");
        }
        if let Some(lives) = self.lives {
            ctx.publish(lives, panics);
        }
    }
}

/// A robot of fragile modules.
fn robot(modules: &str) -> RobotFile {
    let text = format!("[robot]\nname = \"r\"\n{modules}");
    let mut file =
        RobotFile::parse(Source::new(Path::new("robot.toml"), text), &crate::Catalog::built_in()).unwrap().0;
    let fragile = Kind::new("fragile", "panics", Fragile::default);
    file.modules.iter_mut().for_each(|module| module.kind = fragile.clone());
    file
}

#[test]
fn a_module_is_restarted_as_often_as_the_file_specifies() {
    let file = robot(
        "[[module]]\nkind = \"stand_nod_wave\"\nname = \"a\"\nrestart = { times = 2, backoff = \"100ms\" }\ndeadline = \"1h\"",
    );
    let clock = ManualClock::new(Time::ZERO);
    let mut robot = file.build(Core::new().with_clock(clock.clone())).unwrap();
    let state =
        |robot: &Robot| robot.core.modules().iter().find(|module| &*module.name == "a").unwrap().state;
    let run_for = |robot: &mut Robot, time: Duration| {
        let end = clock.now() + time;
        while let Some(next) = robot.core.next_event().filter(|&next| next <= end) {
            clock.set(next);
            robot.core.cycle().unwrap();
        }
        clock.set(end);
    };
    run_for(&mut robot, Duration::from_millis(50));
    assert_eq!((*PANICS.lock().unwrap(), state(&robot)), (1, LifecycleState::Finalized));
    run_for(&mut robot, Duration::from_secs(1));
    assert_eq!((*PANICS.lock().unwrap(), state(&robot)), (2, LifecycleState::Active));
    let lives = robot.core.topics().find(|topic| &*topic.name == "lives").unwrap();
    assert!(lives.counter.messages() > 10);
}

#[test]
fn two_servers_of_one_service_are_reported_with_the_line_of_the_second() {
    let second = "[[module]]\nkind = \"stand_nod_wave\"\nname = \"a\"\n[[module]]\nkind = \"stand_nod_wave\"\nname = \"b\"";
    let problem = robot(second).build(Core::new()).err().unwrap().to_string();
    assert!(
        problem.starts_with("robot.toml:8: module \"b\": service \"answer\" is served by module \"a\""),
        "{problem}"
    );
    let remapped = format!("{second}\nremap = {{ answer = \"reply\" }}");
    robot(&remapped).build(Core::new()).unwrap();
    let back = format!(
        "[[module]]\nkind = \"stand_nod_wave\"\nname = \"c\"\nremap = {{ answer = \"/reply\" }}\n{remapped}"
    );
    let problem = robot(&back).build(Core::new()).err().unwrap().to_string();
    assert!(problem.starts_with("robot.toml:13: module \"b\": service"), "{problem}");
    let unknown = "[[module]]\nkind = \"stand_nod_wave\"\nname = \"a\"\nremap = { anwser = \"reply\" }";
    let problem = robot(unknown).build(Core::new()).err().unwrap().to_string();
    assert!(
        problem.starts_with("robot.toml:6: ") && problem.ends_with("did you mean \"answer\"?"),
        "{problem}"
    );
}

#[test]
fn a_cycle_that_takes_longer_than_its_deadline_is_reported() {
    let text = "[launcher]\nkind = \"linear\"\ndeadline = \"1us\"\n[[module]]\nkind = \"stand_nod_wave\"";
    let mut core = robot(text).build(Core::new()).unwrap().core;
    let (sender, overruns) = std::sync::mpsc::channel();
    core.on_overrun(move |overrun| drop(sender.send(overrun.what.to_string())));
    let overrun = std::iter::repeat_with(|| core.cycle().unwrap()).find_map(|()| overruns.try_recv().ok());
    assert_eq!(overrun.unwrap(), "the cycle");
}

#[cfg(target_os = "linux")]
#[test]
fn a_missing_cpu_is_reported_with_its_line_and_ignored_by_a_replay() {
    let module = "[[module]]\nkind = \"darwin_op\"\nname = \"a\"\ncpus = [65535]";
    let launcher = "[launcher]\nkind = \"pool\"\nthreads = 1\ncpus = [65535]\n";
    for (text, line) in [(module.to_owned(), 6), (format!("{launcher}[[module]]\nkind = \"darwin_op\""), 3)] {
        let problems: Vec<_> = robot(&text).thread_problems().iter().map(ToString::to_string).collect();
        assert_eq!(problems.len(), 1);
        let problem = robot(&text).build(Core::new()).err().unwrap().to_string();
        assert_eq!(problems, std::slice::from_ref(&problem));
        assert!(
            problem.starts_with(&format!("robot.toml:{line}: ")) && problem.contains("65535"),
            "{problem}"
        );
        robot(&text).on_any_machine().build(Core::new()).unwrap();
    }
}
