//! A client always receives a response, whatever the handler in a library in C, C++ or Rust does; the
//! response contains the handler's error text if the type has a field for it. Tested with rclpy and
//! `downbeat service call`. Skipped on machines without a compiler, and without rclpy.
#![allow(clippy::unwrap_used, missing_docs)]

mod common;

use std::io::{BufRead, BufReader};
use std::path::Path;
use std::process::{Command, Output};

use common::rclpy::Peer;
use common::{Running, downbeat};
use serde_json::{Value, json};
use test_machine::{free_domain, has_compilers};

const CPP: &str = r#"
#include "downbeat.hpp"
#include "std_srvs/srv/trigger.hpp"
#include "test_msgs/action/fibonacci.hpp"

using std_srvs::srv::Trigger;
using test_msgs::action::Fibonacci;

class Unreliable : public downbeat::Module {
    void setup() override {
        serve<Trigger>("refuse", [](const Trigger::Request &) -> Trigger::Response { throw downbeat::Error("the lamp is broken"); });
        serve<Trigger>("fail", [](const Trigger::Request &) -> Trigger::Response { throw std::runtime_error("the vial is empty"); });
        serve_later<Trigger>("hold", [this](const Trigger::Request &, const downbeat::Request<Trigger> &open) {
            held_.push_back(open);
            info("holds a request");
        });
        serve_later<Trigger>("leave", [this](const Trigger::Request &, const downbeat::Request<Trigger> &) { remove(name()); });
        act<Fibonacci>("count", [this](const downbeat::Goal<Fibonacci> &goal) {
            if (goal.request().order < 0) {
                throw downbeat::Error("it counts up");
            }
            if (goal.request().order > 100) {
                throw std::runtime_error("it cannot count that far");
            }
            goals_.push_back(goal);
        });
    }
    std::vector<downbeat::Request<Trigger>> held_;
    std::vector<downbeat::Goal<Fibonacci>> goals_;
};
DOWNBEAT_MODULE(Unreliable)
"#;

const C: &str = r#"
#include "std_srvs/srv/trigger.h"
#include "test_msgs/action/fibonacci.h"

enum { REFUSE, FAIL, HOLD, LEAVE };

typedef struct { downbeat_action_server count; } unreliable;

static void *create(const downbeat_host_v1 *host) {
    (void)host;
    return calloc(1, sizeof(unreliable));
}

static void destroy(void *self) {
    downbeat_action_server_fini(&((unreliable *)self)->count);
    free(self);
}

static int32_t setup(void *self, const downbeat_host_v1 *host) {
    const char *type = std_srvs__srv__Trigger__TYPE, *hash = std_srvs__srv__Trigger__HASH;
    return host->server(host, "refuse", type, hash, NULL) || host->server(host, "fail", type, hash, NULL) ||
           host->server(host, "hold", type, hash, NULL) || host->server(host, "leave", type, hash, NULL) ||
           test_msgs__action__Fibonacci__serve(host, "count", &((unreliable *)self)->count);
}

static int32_t take_goal(unreliable *self, const downbeat_host_v1 *host, downbeat_goal *goal) {
    test_msgs__action__Fibonacci_Goal wanted;
    test_msgs__action__Fibonacci_Goal__init(&wanted);
    int32_t code = test_msgs__action__Fibonacci__goal(host, goal, &wanted);
    int32_t order = wanted.order;
    test_msgs__action__Fibonacci_Goal__fini(&wanted);
    if (code) {
        return code;
    }
    if (order > 100) {
        return host->fail(host, "it cannot count that far");
    }
    return order < 0 ? downbeat_goal_reject(host, &self->count, goal) : downbeat_goal_accept(host, &self->count, goal);
}

static int32_t handle(void *self, const downbeat_host_v1 *host, const downbeat_event_v1 *event) {
    downbeat_goal *goal;
    int32_t code = downbeat_action_take(host, &((unreliable *)self)->count, event, &goal);
    if (code || goal || event->kind != DOWNBEAT_REQUEST) {
        return goal ? take_goal(self, host, goal) : code;
    }
    switch (event->port) {
    case REFUSE:
        return host->reply_error(host, event->id, "the lamp is broken");
    case FAIL:
        return host->fail(host, "the vial is empty");
    case HOLD:
        host->log(host, DOWNBEAT_INFO, "holds a request");
        return 0;
    case LEAVE:
        return host->remove(host, host->name(host));
    }
    return 0;
}

const downbeat_module_v1 *downbeat_module(void) {
    static const downbeat_module_v1 module = {
        .abi_version = DOWNBEAT_ABI_VERSION, .struct_size = sizeof module, .name = "unreliable",
        .create = create, .setup = setup, .handle = handle, .destroy = destroy};
    return &module;
}
"#;

/// The robot under test: the service or action of its library, and the settings of its process.
struct Case {
    domain: u16,
    /// The keys of `[[module]]`.
    keys: String,
    /// An action of the type Fibonacci.
    action: Option<&'static str>,
}

fn shell(folder: &Path, command: &str) {
    let program = Path::new(env!("CARGO_BIN_EXE_downbeat")).parent().unwrap();
    let path = format!("{}:{}", program.display(), std::env::var("PATH").unwrap());
    let output =
        Command::new("sh").args(["-c", command]).current_dir(folder).env("PATH", path).output().unwrap();
    assert!(output.status.success(), "{command}: {}", String::from_utf8_lossy(&output.stderr));
}

fn text(output: &Output) -> String {
    [&output.stdout, &output.stderr].map(|bytes| String::from_utf8_lossy(bytes)).concat()
}

/// Compiles a library in a language.
fn compiled(folder: &Path, language: &str, source: &str) -> bool {
    let (compiler, standard) = if language == "c" { ("cc", "c11") } else { ("c++", "c++17") };
    if !has_compilers(&[compiler]) {
        return false;
    }
    std::fs::write(folder.join(format!("unreliable.{language}")), source).unwrap();
    for interface in ["std_srvs/srv/Trigger", "test_msgs/action/Fibonacci"] {
        shell(folder, &format!("downbeat interface generate --lang {language} {interface}"));
    }
    let flags = "-Wall -Wextra -Wpedantic -Werror -O1 -shared -fPIC -Iinclude";
    shell(folder, &format!("{compiler} -std={standard} {flags} unreliable.{language} -o libunreliable.so"));
    true
}

fn robot_of(folder: &Path, case: &Case) -> Running {
    let actions = case.action.map(|action| format!("actions = [\"{action}\"]\n")).unwrap_or_default();
    let robot = format!(
        r#"
[robot]
name = "unreliable"

[[module]]
kind = "library"
name = "server"
restart = {{ times = 100, backoff = "10ms" }}
{}

[expose]
services = ["refuse", "fail", "hold", "leave", {{ service = "hold", as = "/late", timeout = "300ms" }}]
{actions}"#,
        case.keys
    );
    std::fs::write(folder.join("robot.toml"), robot).unwrap();
    let run = ["run", "robot.toml"];
    let robot = Running::start_by(&mut in_domain(folder, case.domain, &run));
    robot.wait_for_output("exposed service: /late");
    robot
}

fn in_domain(folder: &Path, domain: u16, arguments: &[&str]) -> Command {
    let mut command = downbeat(arguments);
    command.current_dir(folder).env("ROS_DOMAIN_ID", domain.to_string()).env("XDG_RUNTIME_DIR", folder);
    command.env_remove("AMENT_PREFIX_PATH");
    command
}

/// Checks the responses to clients in rclpy, if installed, and in the program.
fn assert_always_answered(folder: &Path, case: &Case) {
    let robot = robot_of(folder, case);
    let call_by =
        |service: &str| in_domain(folder, case.domain, &["service", "call", service, "std_srvs/srv/Trigger"]);
    let call = |service: &str| text(&call_by(service).output().unwrap());
    let starts = || robot.output().matches("restarted after its panic").count();
    let fails = |fail: &mut dyn FnMut()| {
        let before = starts();
        fail();
        common::wait_until("the module has started again", || starts() > before);
    };
    let refused = call("/refuse");
    assert!(refused.contains("success=False, message='the lamp is broken'"), "{refused}\n{}", robot.output());
    fails(&mut || {
        let failed = call("/fail");
        let expected = "service \"fail\": module \"server\" has failed: ";
        assert!(failed.contains(expected) && failed.contains("the vial is empty"), "{failed}");
    });
    let late = call("/late");
    assert!(late.contains("no answer in 300ms"), "{late}");

    // The first request is open when the module fails, the second when the module leaves.
    fails(&mut || {
        let seen = || robot.output().matches("holds a request").count();
        let before = seen();
        let holding = call_by("/hold").stdout(std::process::Stdio::piped()).spawn().unwrap();
        common::wait_until("it holds the request", || seen() > before);
        assert!(call("/fail").contains("the vial is empty"));
        let held = text(&holding.wait_with_output().unwrap());
        assert!(held.contains("the vial is empty") && held.contains("service \"hold\""), "{held}");
    });

    if let Some(mut rclpy) = Peer::start(case.domain, "LOCALHOST") {
        assert_rclpy_is_answered(&mut rclpy, case, &fails);
    }
    let left = call("/leave");
    assert!(left.contains("module \"server\" does not run and cannot answer"), "{left}");
    let gone = call("/refuse");
    assert!(gone.contains("success=False") && gone.contains("no module serves it"), "{gone}");
}

fn assert_rclpy_is_answered(rclpy: &mut Peer, case: &Case, fails: &dyn Fn(&mut dyn FnMut())) {
    for service in ["/refuse", "/fail", "/late"] {
        rclpy.ask(json!({"do": "client", "service": service, "type": "std_srvs/srv/Trigger"}));
        assert_eq!(rclpy.ask(json!({"do": "wait_for_service", "service": service})), true);
    }
    let message = |rclpy: &mut Peer, service: &str| {
        let answers = rclpy.ask(json!({"do": "call", "service": service, "requests": [{}]}));
        assert_eq!(answers[0]["success"], false, "{answers}");
        answers[0]["message"].as_str().unwrap().to_owned()
    };
    assert_eq!(message(rclpy, "/refuse"), "the lamp is broken");
    fails(&mut || {
        let failed = message(rclpy, "/fail");
        assert!(failed.contains("the vial is empty"), "{failed}");
    });
    assert!(message(rclpy, "/late").contains("no answer in 300ms"));

    let Some(action) = case.action else { return };
    let action = format!("/{action}");
    rclpy.ask(json!({"do": "action_client", "action": action, "type": "test_msgs/action/Fibonacci"}));
    assert_eq!(rclpy.ask(json!({"do": "wait_for_action", "action": action})), true);
    let send = |order: i32| json!({"do": "send_goal", "action": action, "goal": {"order": order}});
    assert_eq!(rclpy.ask(send(-1)), Value::Null, "it is refused");
    fails(&mut || assert_eq!(rclpy.ask(send(200)), Value::Null, "its handler fails"));
    let goal = rclpy.ask(send(3));
    assert_ne!(goal, Value::Null);
    assert_eq!(rclpy.ask(json!({"do": "cancel_goal", "goal": goal})), json!([0, [goal]]));
    fails(&mut || drop(message(rclpy, "/fail")));
    let end = rclpy.ask(json!({"do": "result_of", "goal": goal}));
    assert_eq!(end, json!([6, []]), "it was aborted");
    // The restarted module does not know the goal.
    assert_eq!(rclpy.ask(json!({"do": "cancel_goal", "goal": goal})), json!([2, []]));
    assert_eq!(rclpy.ask(json!({"do": "result_of", "goal": goal, "anew": true})), json!([0, []]));
}

fn answered(language: &str, source: &str, domain: u16, keys: &str) {
    let folder = tempfile::tempdir().unwrap();
    if compiled(folder.path(), language, source) {
        let keys = format!("path = \"libunreliable.so\"\n{keys}");
        assert_always_answered(folder.path(), &Case { domain, keys, action: Some("count") });
    }
}

#[test]
fn a_client_of_a_library_in_cpp_always_has_an_answer() {
    answered("cpp", CPP, free_domain(), "");
}

#[test]
fn a_client_of_a_library_in_cpp_in_a_process_of_its_own_always_has_an_answer() {
    answered("cpp", CPP, free_domain(), "isolate = true");
}

#[test]
fn a_client_of_a_library_in_c_always_has_an_answer() {
    answered("c", C, free_domain(), "");
}

#[test]
fn a_client_of_a_library_in_rust_always_has_an_answer() {
    // Cargo builds the library, because these tests depend on its crate.
    let library = std::env::current_exe().unwrap().with_file_name("libdownbeat_library_example.so");
    let folder = tempfile::tempdir().unwrap();
    let keys = format!("path = {library:?}");
    assert_always_answered(folder.path(), &Case { domain: free_domain(), keys, action: None });
}

/// The goals of a library in Rust, whose action has a type of its own, and requests to cancel them: those of
/// the program.
#[test]
fn a_goal_of_a_library_in_rust_always_ends() {
    let library = std::env::current_exe().unwrap().with_file_name("libdownbeat_library_example.so");
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    let case = Case { domain: free_domain(), keys: format!("path = {library:?}"), action: Some("lean") };
    let robot = robot_of(folder, &case);
    let send = |angle: f64| {
        let goal = format!("goal: {{angle: {angle:?}}}");
        in_domain(folder, case.domain, &["action", "send_goal", "/lean", "my_msgs/action/Lean", &goal])
    };
    let sent = |angle: f64| text(&send(angle).output().unwrap());
    let call = |service: &str, kind: &str| {
        text(&in_domain(folder, case.domain, &["service", "call", service, kind]).output().unwrap())
    };
    let cancel = || call("/lean/_action/cancel_goal", "action_msgs/srv/CancelGoal");
    let starts = || robot.output().matches("restarted after its panic").count();
    let fails = |fail: &mut dyn FnMut()| {
        let before = starts();
        fail();
        common::wait_until("the module has started again", || starts() > before);
    };
    assert!(sent(0.5).contains("SUCCEEDED"), "{}", sent(0.5));
    assert!(sent(50.0).to_lowercase().contains("rejected"), "{}", sent(50.0));
    fails(&mut || {
        let failed = sent(200.0);
        assert!(failed.to_lowercase().contains("rejected"), "{failed}");
    });
    // While a goal is open.
    let during = |angle: f64, act: &mut dyn FnMut()| {
        let mut command = send(angle);
        let goal =
            command.stdout(std::process::Stdio::piped()).stderr(std::process::Stdio::inherit()).spawn();
        let mut goal = goal.unwrap();
        let mut lines = BufReader::new(goal.stdout.take().unwrap()).lines().map(Result::unwrap);
        let accepted = lines.by_ref().find(|line| line.contains("Goal accepted"));
        assert!(accepted.is_some(), "{}", robot.output());
        act();
        let rest: Vec<_> = lines.collect();
        goal.wait().unwrap();
        rest.join("\n")
    };
    let canceled = during(-1.0, &mut || assert!(cancel().contains("return_code=0"), "{}", robot.output()));
    assert!(canceled.contains("CANCELED"), "{canceled}");
    let aborted = during(-15.0, &mut || {
        let refused = cancel();
        assert!(refused.contains("return_code=1"), "{refused}");
        fails(&mut || drop(call("/fail", "std_srvs/srv/Trigger")));
    });
    assert!(aborted.contains("ABORTED"), "{aborted}");
    let aborted = during(-25.0, &mut || {
        fails(&mut || {
            let refused = cancel();
            assert!(refused.contains("return_code=1"), "{refused}");
        });
    });
    assert!(aborted.contains("ABORTED"), "{aborted}");
    let aborted = during(-1.0, &mut || drop(call("/leave", "std_srvs/srv/Trigger")));
    assert!(aborted.contains("ABORTED"), "{aborted}");
    assert!(sent(0.5).to_lowercase().contains("rejected"), "no module takes goals any more");
}

const CRASH: &str = r#"
#include "downbeat.hpp"
#include "std_srvs/srv/trigger.hpp"

using std_srvs::srv::Trigger;

class Crash : public downbeat::Module {
    void setup() override {
        serve<Trigger>("crash", [](const Trigger::Request &) -> Trigger::Response { std::abort(); });
        serve<Trigger>("hang", [](const Trigger::Request &) -> Trigger::Response { for (volatile int at = 0;; at = at + 1) {} });
    }
};
DOWNBEAT_MODULE(Crash)
"#;

#[test]
fn a_client_has_an_answer_from_a_process_that_crashes_or_takes_too_long() {
    let domain = free_domain();
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    if !compiled(folder, "cpp", CRASH) {
        return;
    }
    let robot = r#"
[robot]
name = "crash"

[[module]]
kind = "library"
name = "server"
path = "libunreliable.so"
isolate = true
time_limit = "300ms"
restart = { times = 100, backoff = "10ms" }

[expose]
services = ["crash", "hang"]
"#;
    std::fs::write(folder.join("robot.toml"), robot).unwrap();
    let robot = Running::start_by(&mut in_domain(folder, domain, &["run", "robot.toml"]));
    robot.wait_for_output("exposed service: /hang");
    for (service, words) in [("/crash", "signal"), ("/hang", "300ms")] {
        let before = robot.output().matches("restarted after its panic").count();
        let call = in_domain(folder, domain, &["service", "call", service, "std_srvs/srv/Trigger"])
            .output()
            .unwrap();
        let called = text(&call);
        assert!(called.contains("success=False") && called.contains(words), "{called}\n{}", robot.output());
        common::wait_until("it has started again", || {
            robot.output().matches("restarted after its panic").count() > before
        });
    }
}
