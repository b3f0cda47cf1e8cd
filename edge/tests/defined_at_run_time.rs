//! Services, actions and messages of which only the definition is known.
#![allow(clippy::unwrap_used)]

use bytes::Bytes;
use downbeat_edge::foreign::{Declarations, Event, Foreign, ForeignContext, ForeignModule};
use downbeat_edge::{CoreAccess, EventContent, Interfaces};
use downbeat_executor::{Core, Failure, Inbox, ManualClock, ModuleOptions, OutletInbox, Time};
use downbeat_msgs::dynamic::DynamicMessage;
use downbeat_msgs::service_msgs::msg::ServiceEventInfo;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::mpsc::channel;
use std::time::Duration;

const LEVEL: &str = "my_msgs/srv/Level";

/// A package `my_msgs` in a new folder of that name.
fn package(test: &str) -> PathBuf {
    let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join(test);
    let _ = std::fs::remove_dir_all(&folder);
    write(&folder, "my_msgs/msg/Tilt.msg", "std_msgs/Header header\nfloat64 angle\n");
    write(
        &folder,
        "my_msgs/srv/Level.srv",
        "# How level.\nTilt tilt\nuint8 tries 3\n---\nbool is_level\nstring why\n",
    );
    write(&folder, "my_msgs/action/Turn.action", "float64 angle\n---\nfloat64 turned\n---\nfloat64 left\n");
    folder
}

fn write(folder: &Path, name: &str, text: &str) {
    let path = folder.join(name);
    std::fs::create_dir_all(path.parent().unwrap()).unwrap();
    std::fs::write(path, text).unwrap();
}

fn known(test: &str) -> Interfaces {
    let interfaces = Interfaces::carried();
    interfaces.learn_folder(&package(test)).unwrap();
    interfaces
}

/// Answers whether the tilt is small.
struct Spirit;

impl Foreign for Spirit {
    fn setup(&mut self, declarations: &mut Declarations) -> Result<(), String> {
        declarations.serve("level", LEVEL, None);
        Ok(())
    }

    fn handle(&mut self, event: Event, context: &mut ForeignContext<'_, '_>) -> Result<(), Failure> {
        let Event::Request { request, cdr, .. } = event else { return Ok(()) };
        let interfaces = known("spirit");
        let of = |part: &str| interfaces.definitions().find(&format!("{LEVEL}_{part}")).unwrap();
        let asked = DynamicMessage::from_cdr(&of("Request"), &cdr).unwrap();
        let angle = asked.get("tilt.angle").unwrap().as_f64().unwrap();
        let mut answer = DynamicMessage::new(&of("Response"));
        answer.set("is_level", angle < 0.1).unwrap();
        answer.set("why", "as measured").unwrap();
        Ok(context.reply(request, Ok(&answer.to_cdr()))?)
    }
}

fn core_with(interfaces: &Interfaces) -> Core {
    let mut core = Core::new().with_clock(ManualClock::new(Time::ZERO));
    let make = Arc::new(|| Ok(Box::new(Spirit) as Box<dyn Foreign>));
    let module = ForeignModule::new(make, interfaces.clone(), ModuleOptions::default());
    core.add("spirit", module).unwrap();
    core
}

#[test]
fn a_service_of_a_folder_is_served_and_called_as_bytes() {
    let interfaces = known("served");
    let level = interfaces.service(LEVEL).unwrap();
    assert!(
        level.is_raw() && level.hash().starts_with("RIHS01_") && level.definition().contains("# How level.")
    );
    let mut core = core_with(&interfaces);
    let info = core.service("level").unwrap();
    assert_eq!(
        (info.request_type, info.response_type),
        ("my_msgs/srv/Level_Request", "my_msgs/srv/Level_Response")
    );
    assert_eq!(interfaces.service_of(info), Some(level));
    let caller = level.caller(&mut core, "level").unwrap();
    let dynamic = |part: &str| interfaces.definitions().find(&format!("{LEVEL}_{part}")).unwrap();
    let mut request = DynamicMessage::new(&dynamic("Request"));
    assert_eq!(request.get("tries").unwrap().as_u64(), Some(3));
    request.set("tilt.angle", 0.5).unwrap();
    let (sender, answers) = channel();
    let ask = |cdr: &[u8]| {
        let sender = sender.clone();
        caller.call(cdr, Duration::from_secs(1), move |answer| {
            sender.send(answer.map(|answer| answer.into_cdr()).map_err(|error| error.to_string())).unwrap();
        });
    };
    ask(&request.to_cdr());
    // Not from the end of the request, and not as bytes that are none.
    ask(&request.to_cdr()[..20]);
    (0..4).for_each(|_| core.cycle().unwrap());
    let error = answers.recv().unwrap().unwrap_err();
    assert!(error.contains("the bytes are no my_msgs/srv/Level"), "{error}");
    let answer = DynamicMessage::from_cdr(&dynamic("Response"), &answers.recv().unwrap().unwrap()).unwrap();
    assert_eq!(answer.get("is_level").unwrap().as_bool(), Some(false));
    assert_eq!(answer.get("why").unwrap().as_str(), Some("as measured"));
}

#[test]
fn requests_of_either_byte_order_reach_the_server_as_little_endian() {
    let interfaces = known("byte_order");
    let level = interfaces.service("std_srvs/srv/SetBool").unwrap();
    assert!(!level.is_raw(), "a type that is compiled in stays one");
    let interfaces = {
        write(&package("big"), "my_msgs/srv/Big.srv", "int32 number\n---\nint32 number\n");
        let interfaces = Interfaces::carried();
        interfaces.learn_folder(&Path::new(env!("CARGO_TARGET_TMPDIR")).join("big")).unwrap();
        interfaces
    };
    struct Echo;
    impl Foreign for Echo {
        fn setup(&mut self, declarations: &mut Declarations) -> Result<(), String> {
            declarations.serve("echo", "my_msgs/srv/Big", None);
            Ok(())
        }

        fn handle(&mut self, event: Event, context: &mut ForeignContext<'_, '_>) -> Result<(), Failure> {
            let Event::Request { request, cdr, .. } = event else { return Ok(()) };
            Ok(context.reply(request, Ok(&cdr))?)
        }
    }
    let mut core = Core::new().with_clock(ManualClock::new(Time::ZERO));
    let make = Arc::new(|| Ok(Box::new(Echo) as Box<dyn Foreign>));
    core.add("echo", ForeignModule::new(make, interfaces.clone(), ModuleOptions::default())).unwrap();
    let caller = interfaces.service("my_msgs/srv/Big").unwrap().caller(&mut core, "echo").unwrap();
    let (sender, answers) = channel();
    caller.call(&[0, 0, 0, 0, 0, 0, 0, 7], Duration::from_secs(1), move |answer| {
        sender.send(answer.unwrap().into_cdr()).unwrap();
    });
    (0..4).for_each(|_| core.cycle().unwrap());
    assert_eq!(answers.recv().unwrap(), [0, 1, 0, 0, 7, 0, 0, 0]);
}

#[test]
fn events_of_it_hold_requests_and_responses() {
    let interfaces = known("events");
    let level = interfaces.service(LEVEL).unwrap();
    let dynamic = |part: &str| interfaces.definitions().find(&format!("{LEVEL}_{part}")).unwrap();
    let mut request = DynamicMessage::new(&dynamic("Request"));
    request.set("tilt.angle", 0.25).unwrap();
    let info = ServiceEventInfo { sequence_number: 9, client_gid: [7; 16], ..ServiceEventInfo::default() };
    let bytes = level.encode_event(info, EventContent::Request(&request.to_cdr())).unwrap();
    let event = DynamicMessage::from_cdr(&dynamic("Event"), &bytes).unwrap();
    assert_eq!(event.get("request[0].tilt.angle").unwrap().as_f64(), Some(0.25));
    assert_eq!(event.get("info.sequence_number").unwrap().as_i64(), Some(9));
    assert!(event.get("response[0]").is_err());
    let of_empty = interfaces.service("std_srvs/srv/Empty").unwrap();
    assert_eq!(
        level.encode_event(info, EventContent::Nothing).unwrap(),
        of_empty.encode_event(info, EventContent::Nothing).unwrap()
    );
    assert!(level.encode_event(info, EventContent::Response(&[0, 1])).is_err());
}

#[test]
fn an_action_has_its_parts_and_all_of_them_are_described() {
    let interfaces = known("action");
    let turn = interfaces.action("my_msgs/action/Turn").unwrap();
    assert_eq!(turn.send_goal().name(), "my_msgs/action/Turn_SendGoal");
    assert_eq!(turn.feedback().name(), "my_msgs/action/Turn_FeedbackMessage");
    assert_eq!(interfaces.find_message("my_msgs/action/Turn_FeedbackMessage").unwrap(), turn.feedback());
    assert_eq!(interfaces.service("my_msgs/action/Turn_GetResult").unwrap(), turn.get_result());
    let hashes = [turn.hash(), turn.send_goal().hash(), turn.feedback().hash()];
    for hash in hashes.into_iter().chain(turn.get_result().message_hashes()) {
        let described = interfaces.described(hash).unwrap();
        assert_eq!(described.message.type_description.type_name, described.type_name);
        assert!(described.type_name.starts_with("my_msgs/action/Turn"));
    }
}

#[test]
fn example_interfaces_are_known_though_no_rust_type_is_compiled_in() {
    let interfaces = Interfaces::carried();
    let add = interfaces.service("example_interfaces/srv/AddTwoInts").unwrap();
    // As rosidl of Jazzy computes it.
    assert_eq!(add.hash(), "RIHS01_e118de6bf5eeb66a2491b5bda11202e7b68f198d6f67922cf30364858239c81a");
    assert!(interfaces.action("example_interfaces/action/Fibonacci").is_ok());
}

#[test]
fn a_module_brings_the_definitions_that_the_robot_lacks() {
    let definition = known("brought").service(LEVEL).unwrap().definition();
    let robot = Interfaces::carried();
    assert!(robot.service(LEVEL).is_err());
    robot.learn(LEVEL, definition).unwrap();
    assert_eq!(robot.service(LEVEL).unwrap(), known("brought").service(LEVEL).unwrap());
    assert!(Interfaces::carried().service(LEVEL).is_err(), "another robot does not know it");
    // The same again, and another one.
    robot.learn(LEVEL, definition).unwrap();
    let other = definition.replace("string why", "string reason");
    let error = robot.learn(LEVEL, &other).unwrap_err().to_string();
    assert!(
        error
            .starts_with("it carries another definition of my_msgs/srv/Level than this robot knows: RIHS01_"),
        "{error}"
    );
    assert!(robot.learn(LEVEL, "nonsense").unwrap_err().to_string().contains(LEVEL));
    let built_in = robot.learn("std_msgs/msg/Bool", "uint8 data\n").unwrap_err().to_string();
    assert!(built_in.contains("but the program has RIHS01_"), "{built_in}");
}

#[test]
fn a_module_compiled_with_another_definition_is_refused_with_both_hashes() {
    struct Stale;
    impl Foreign for Stale {
        fn setup(&mut self, declarations: &mut Declarations) -> Result<(), String> {
            declarations.serve("level", LEVEL, Some("RIHS01_old"));
            Ok(())
        }

        fn handle(&mut self, _: Event, _: &mut ForeignContext<'_, '_>) -> Result<(), Failure> {
            Ok(())
        }
    }
    let interfaces = known("stale");
    let make = Arc::new(|| Ok(Box::new(Stale) as Box<dyn Foreign>));
    let module = ForeignModule::new(make, interfaces.clone(), ModuleOptions::default());
    let error = Core::new().add("stale", module).unwrap_err().to_string();
    let hash = interfaces.service(LEVEL).unwrap().hash();
    assert!(error.contains("RIHS01_old") && error.contains(hash) && error.contains(LEVEL), "{error}");
}

#[test]
fn a_topic_carries_messages_of_one_name() {
    let interfaces = known("topics");
    write(&package("topics_too"), "my_msgs/msg/Lean.msg", "float64 angle\n");
    let other = Interfaces::carried();
    other.learn_folder(&Path::new(env!("CARGO_TARGET_TMPDIR")).join("topics_too")).unwrap();
    let mut core = Core::new();
    interfaces.find_message("my_msgs/msg/Tilt").unwrap().inlet(&mut core, "tilt").unwrap();
    let topic = core.topics().next().unwrap();
    assert_eq!(topic.message_type, "my_msgs/msg/Tilt");
    assert_eq!(interfaces.message_in(topic), interfaces.find_message("my_msgs/msg/Tilt").ok());
    let error = other.find_message("my_msgs/msg/Lean").unwrap().inlet(&mut core, "tilt").err().unwrap();
    assert!(error.to_string().contains("my_msgs/msg/Lean") && !error.to_string().contains("::"), "{error}");
}

#[test]
fn folders_that_cannot_be_used_are_refused_with_their_path() {
    let folder = package("refused");
    let refused = |folder: &Path| Interfaces::carried().learn_folder(folder).unwrap_err().to_string();
    write(&folder, "again/my_msgs/msg/Tilt.msg", "float64 angle\n");
    let error = refused(&folder);
    assert!(
        error.starts_with("there are two packages named my_msgs: ") && error.contains("again/my_msgs"),
        "{error}"
    );
    std::fs::remove_dir_all(folder.join("again")).unwrap();
    write(&folder, "my_msgs/srv/Wrong.srv", "float64 a\nfloat64 b\n");
    assert!(refused(&folder).contains("Wrong.srv"), "{}", refused(&folder));
    assert!(refused(&folder.join("my_msgs/msg")).contains("has no interfaces"));
    assert!(refused(&folder.join("nowhere")).contains("nowhere"));
}

#[test]
fn a_message_that_is_none_does_not_reach_the_module() {
    struct Keeper(std::sync::mpsc::Sender<Bytes>);
    impl Foreign for Keeper {
        fn setup(&mut self, declarations: &mut Declarations) -> Result<(), String> {
            declarations.subscribe("tilt", "my_msgs/msg/Tilt", None);
            Ok(())
        }

        fn handle(&mut self, event: Event, _: &mut ForeignContext<'_, '_>) -> Result<(), Failure> {
            if let Event::Message { cdr, .. } = event {
                self.0.send(cdr).unwrap();
            }
            Ok(())
        }
    }
    let interfaces = known("keeper");
    let (sender, kept) = channel();
    let make = Arc::new(move || Ok(Box::new(Keeper(sender.clone())) as Box<dyn Foreign>));
    let mut core = Core::new().with_clock(ManualClock::new(Time::ZERO));
    core.add("keeper", ForeignModule::new(make, interfaces.clone(), ModuleOptions::default())).unwrap();
    let tilt = interfaces.find_message("my_msgs/msg/Tilt").unwrap();
    let inlet = tilt.inlet(&mut core, "tilt").unwrap();
    inlet.publish(&[0, 1, 0, 0, 1]).unwrap();
    inlet.publish(&tilt.default_cdr()).unwrap();
    (0..2).for_each(|_| core.cycle().unwrap());
    assert_eq!(kept.try_iter().collect::<Vec<_>>(), [tilt.default_cdr()]);
}

#[test]
fn a_raw_message_enters_and_leaves_the_core_without_being_copied() {
    let interfaces = known("shared");
    let mut core = Core::new().with_clock(ManualClock::new(Time::ZERO));
    let tilt = interfaces.find_message("my_msgs/msg/Tilt").unwrap();
    let inlet = tilt.inlet(&mut core, "tilt").unwrap();
    let (sender, left) = channel();
    let inbox = OutletInbox::from(Inbox::KeepAll);
    let sink = move |_: Time, cdr: Bytes| drop(sender.send(cdr));
    let _outlet = tilt.outlet(&mut CoreAccess::Idle(&mut core), "tilt", &inbox, sink).unwrap();
    let cdr = Bytes::from(tilt.default_cdr());
    inlet.publish_shared(&cdr).unwrap();
    (0..2).for_each(|_| core.cycle().unwrap());
    let left = left.try_recv().unwrap();
    assert_eq!((left.as_ptr(), left.len()), (cdr.as_ptr(), cdr.len()));
}
