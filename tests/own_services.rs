//! User-defined services in libraries, defined only by files in a folder: served in C, C++ and Rust, called
//! from each other and with `downbeat service call`, recorded and replayed. Skipped on machines without a
//! compiler.
#![allow(clippy::unwrap_used, missing_docs)]

mod common;

use std::path::Path;
use std::process::{Command, Output};

use common::{Running, downbeat, open_with_stock_readers};
use test_machine::{free_domain, has_compilers};

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

fn write(folder: &Path, name: &str, text: &str) {
    let path = folder.join(name);
    std::fs::create_dir_all(path.parent().unwrap()).unwrap();
    std::fs::write(path, text).unwrap();
}

const TILT: &str = "std_msgs/Header header\nfloat64 angle\n";
const LEVEL: &str = "# Whether a tilt is level.\nTilt tilt\n---\nbool is_level\nstring why\n";

/// Serves `level` and the action `turn`; publishes its latest request.
const SPIRIT: &str = r#"
#include "downbeat.hpp"
#include "lab_msgs/msg/tilt.hpp"
#include "lab_msgs/action/turn.hpp"
#include "lab_msgs/srv/level.hpp"
using lab_msgs::action::Turn;
using lab_msgs::msg::Tilt;
using lab_msgs::srv::Level;
class Spirit : public downbeat::Module {
    void setup() override {
        auto asked = publish<Tilt>("asked");
        serve<Level>("level", [asked](const Level::Request &request) {
            asked(request.tilt);
            if (request.tilt.angle > 8.0) {
                throw downbeat::Error("it has fallen over");
            }
            Level::Response response;
            response.is_level = request.tilt.angle < 0.1;
            response.why = "it leans " + std::to_string(request.tilt.angle);
            return response;
        });
        act<Turn>("turn", [](const downbeat::Goal<Turn> &goal) {
            Turn::Result result;
            result.turned = goal.request().angle;
            goal.succeed(result);
        });
    }
};
DOWNBEAT_MODULE(Spirit)
"#;

/// Calls `level` with growing tilts, and publishes whether the answer was good.
const MASON: &str = r#"
#include "downbeat.h"
#include "lab_msgs/srv/level.h"
#include "std_msgs/msg/float64.h"

typedef struct { double angle; } mason;

static void *create(const downbeat_host_v1 *host) {
    (void)host;
    return calloc(1, sizeof(mason));
}
static void destroy(void *self) { free(self); }

static int32_t setup(void *self, const downbeat_host_v1 *host) {
    (void)self;
    return lab_msgs__srv__Level__define(host) ||
           host->client(host, "level", lab_msgs__srv__Level__TYPE, lab_msgs__srv__Level__HASH, 1000000000, NULL) ||
           host->publisher(host, "leaning", std_msgs__msg__Float64__TYPE, std_msgs__msg__Float64__HASH, NULL) ||
           host->timer(host, 20000000, NULL);
}

static int32_t handle(void *self, const downbeat_host_v1 *host, const downbeat_event_v1 *event) {
    mason *of = self;
    downbeat_writer writer = {0};
    int32_t code = 0;
    if (event->kind == DOWNBEAT_TIMER) {
        lab_msgs__srv__Level_Request request;
        lab_msgs__srv__Level_Request__init(&request);
        request.tilt.angle = of->angle;
        of->angle += 0.0125;
        lab_msgs__srv__Level_Request__encode(&request, &writer);
        code = host->call(host, 0, writer.data, writer.size, NULL);
        lab_msgs__srv__Level_Request__fini(&request);
    } else if (event->kind == DOWNBEAT_REPLY && !event->is_error) {
        lab_msgs__srv__Level_Response response;
        lab_msgs__srv__Level_Response__init(&response);
        code = lab_msgs__srv__Level_Response__take(host, event, &response);
        std_msgs__msg__Float64 leaning = {response.is_level ? 0.0 : 1.0 + (double)response.why.size};
        if (code == 0) {
            code = std_msgs__msg__Float64__publish(host, 0, &leaning, &writer);
        }
        lab_msgs__srv__Level_Response__fini(&response);
    }
    downbeat_writer_fini(&writer);
    return code;
}

const downbeat_module_v1 *downbeat_module(void) {
    static const downbeat_module_v1 module = {
        .abi_version = DOWNBEAT_ABI_VERSION, .struct_size = sizeof module, .name = "mason",
        .create = create, .setup = setup, .handle = handle, .destroy = destroy};
    return &module;
}
"#;

const ROBOT: &str = r#"
[robot]
name = "site"

[[module]]
name = "spirit"
kind = "library"
path = "libspirit.so"

[[module]]
name = "mason"
kind = "library"
path = "libmason.so"
isolate = true

[expose]
services = ["level"]
out = ["asked", "leaning"]

[record]
topics = "all"
"#;

/// A folder with the package `lab_msgs`, and the libraries in C++ and C that use it.
fn site() -> Option<tempfile::TempDir> {
    if !has_compilers(&["cc", "c++"]) {
        return None;
    }
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path();
    write(path, "lab_msgs/msg/Tilt.msg", TILT);
    write(path, "lab_msgs/srv/Level.srv", LEVEL);
    write(path, "lab_msgs/action/Turn.action", TURN);
    write(path, "spirit.cpp", SPIRIT);
    write(path, "mason.c", MASON);
    write(path, "robot.toml", ROBOT);
    shell(path, "downbeat interface generate --lang cpp --from . lab_msgs --out cpp_include");
    shell(path, "downbeat interface generate --lang c --from . lab_msgs --out c_include");
    shell(path, "downbeat interface generate --lang c std_msgs/msg/Float64 --out c_include");
    shell(
        path,
        "c++ -std=c++17 -Wall -Wextra -Wpedantic -Werror -O1 -shared -fPIC -Icpp_include spirit.cpp -o libspirit.so",
    );
    shell(
        path,
        "cc -std=c11 -Wall -Wextra -Wpedantic -Werror -O1 -shared -fPIC -Ic_include mason.c -o libmason.so",
    );
    // From now on, only the libraries contain the definitions.
    std::fs::rename(path.join("lab_msgs"), path.join("lab_msgs_of_the_author")).unwrap();
    Some(folder)
}

fn command(folder: &Path, domain: &str, arguments: &[&str]) -> Command {
    let mut command = downbeat(arguments);
    command.current_dir(folder).env("ROS_DOMAIN_ID", domain).env("XDG_RUNTIME_DIR", folder);
    command.env_remove("AMENT_PREFIX_PATH");
    command
}

#[test]
fn libraries_serve_and_call_a_service_that_only_they_know() {
    let domain = free_domain().to_string();
    let Some(folder) = site() else { return };
    let folder = folder.path();
    let checked = text(&command(folder, &domain, &["check", "robot.toml"]).output().unwrap());
    for shown in ["lab_msgs/srv/Level", "lab_msgs/msg/Tilt", "/level", "/asked"] {
        assert!(checked.contains(shown), "{shown}\n{checked}");
    }
    assert!(!checked.contains("downbeat_edge"), "{checked}");

    let mut robot =
        Running::start_by(&mut command(folder, &domain, &["run", "robot.toml", "--record", "morning"]));
    robot.wait_for_output("exposed to ROS 2: /asked");
    // The call takes the definition from the node.
    let call = [
        "service",
        "call",
        "/level",
        "lab_msgs/srv/Level",
        "{tilt: {header: {frame_id: wall}, angle: 0.75}}",
    ];
    let called = text(&command(folder, &domain, &call).output().unwrap());
    assert!(
        called.contains("is_level=False") && called.contains("it leans 0.750000"),
        "{called}\n{}",
        robot.output()
    );
    // Also where another one of the same name is at hand.
    write(folder, "older/lab_msgs/msg/Tilt.msg", TILT);
    write(folder, "older/lab_msgs/srv/Level.srv", "float64 angle\n---\nbool is_level\n");
    let of_older = [&call[..], &["--from", "older"]].concat();
    let called = text(&command(folder, &domain, &of_older).output().unwrap());
    assert!(called.contains("it leans 0.750000"), "{called}");
    let listed = text(&command(folder, &domain, &["service", "list", "-t"]).output().unwrap());
    assert!(listed.contains("/level [lab_msgs/srv/Level]"), "{listed}");
    let echo = ["topic", "echo", "--once", "/asked"];
    let echoed = text(&command(folder, &domain, &echo).output().unwrap());
    assert!(echoed.contains("frame_id") && echoed.contains("angle: "), "{echoed}");
    robot.interrupt();

    open_with_stock_readers(&folder.join("morning"));
    let info = text(&command(folder, &domain, &["bag", "info", "morning"]).output().unwrap());
    assert!(info.contains("lab_msgs/msg/Tilt"), "{info}");
    let replay = || {
        let output = command(folder, &domain, &["bag", "replay", "robot.toml", "morning"]).output().unwrap();
        (output.status.success(), text(&output))
    };
    let (is_same, said) = replay();
    assert!(is_same && said.contains("/asked ") && !said.contains("unknown message type"), "{said}");
    // A changed answer changes the run.
    write(folder, "spirit.cpp", &SPIRIT.replace("< 0.1", "< 0.2"));
    shell(folder, "c++ -std=c++17 -shared -fPIC -Icpp_include spirit.cpp -o libspirit.so");
    assert!(!replay().0);
}

#[test]
fn foxglove_and_the_page_call_what_only_a_library_knows() {
    let domain = free_domain().to_string();
    let Some(modules) = test_machine::node_modules() else { return };
    let Some(folder) = site() else { return };
    let folder = folder.path();
    let mut robot =
        Running::start_by(&mut command(folder, &domain, &["run", "robot.toml", "--view=0", "--foxglove=0"]));
    let url = |before: &str| {
        robot.wait_for_output(before);
        let output = robot.output();
        output.lines().find_map(|line| line.strip_prefix(before)).unwrap().to_owned()
    };
    let address = url("open in Foxglove, Lichtblick or PlotJuggler, as Foxglove WebSocket: ");
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("bridge/view/tests/node/own_service.mjs");
    let mut node = Command::new("node");
    node.arg(script).arg(address).env("DOWNBEAT_NODE_MODULES", modules);
    let said = text(&node.output().unwrap());
    let found: serde_json::Value = serde_json::from_str(said.trim()).unwrap_or_else(|_| panic!("{said}"));
    assert_eq!(found["type"], "lab_msgs/srv/Level");
    assert_eq!(found["response"], serde_json::json!({"is_level": false, "why": "it leans 0.750000"}));
    assert!(found["message"].as_str().unwrap().contains("it has fallen over"), "{said}");
    assert_eq!(
        (&found["accepted"], &found["status"], &found["turned"]),
        (&true.into(), &4.into(), &1.5.into())
    );

    if let Some(mut script) = common::browser::script("own_service.mjs") {
        let output = script.env("DOWNBEAT_PAGE", url("open in a browser: ")).output().unwrap();
        assert!(output.status.success(), "{}\n{}", text(&output), robot.output());
    }
    robot.interrupt();
}

#[test]
fn another_definition_of_the_same_name_is_refused_with_both_sides() {
    let domain = free_domain().to_string();
    let Some(folder) = site() else { return };
    let folder = folder.path();
    write(folder, "ours/lab_msgs/msg/Tilt.msg", TILT);
    write(folder, "ours/lab_msgs/srv/Level.srv", &LEVEL.replace("string why", "string reason"));
    write(
        folder,
        "robot.toml",
        &ROBOT.replace("name = \"site\"", "name = \"site\"\ninterfaces = [\"ours\"]"),
    );
    let refused = command(folder, &domain, &["check", "robot.toml"]).output().unwrap();
    let said = text(&refused);
    assert!(!refused.status.success(), "{said}");
    for words in ["spirit", "lab_msgs/srv/Level", "RIHS01_", "ours", "build it again"] {
        assert!(said.contains(words), "{words}\n{said}");
    }
    // Errors of the folder itself name the line of the robot file.
    for (interfaces, words) in [
        ("[\"nowhere\"]", "nowhere"),
        ("[\"ours\", \"theirs\"]", "is already defined, differently"),
        ("[\"twice\"]", "two packages named lab_msgs"),
        ("[\"empty\"]", "has no interfaces"),
    ] {
        write(folder, "theirs/lab_msgs/srv/Level.srv", LEVEL);
        write(folder, "twice/one/lab_msgs/srv/Level.srv", LEVEL);
        write(folder, "twice/two/lab_msgs/srv/Level.srv", LEVEL);
        std::fs::create_dir_all(folder.join("empty")).unwrap();
        write(
            folder,
            "robot.toml",
            &ROBOT.replace("name = \"site\"", &format!("name = \"site\"\ninterfaces = {interfaces}")),
        );
        let said = text(&command(folder, &domain, &["check", "robot.toml"]).output().unwrap());
        assert!(said.contains("robot.toml:4: ") && said.contains(words), "{said}");
    }
}

#[test]
fn a_call_to_ros_has_the_type_of_the_module_or_of_the_file() {
    let domain = free_domain().to_string();
    let Some(folder) = site() else { return };
    let folder = folder.path();
    let caller = ROBOT.replace("services = [\"level\"]", "calls = [\"level\"]").replacen(
        "path = \"libspirit.so\"",
        "path = \"libmason.so\"",
        1,
    );
    let caller = caller.replace("out = [\"asked\", \"leaning\"]", "out = [\"leaning\"]");
    let caller = caller.replacen("name = \"spirit\"", "name = \"first\"\nremap = { leaning = \"other\" }", 1);
    let caller = caller.replacen("name = \"site\"", "name = \"yard\"", 1);
    write(folder, "caller.toml", &caller);
    let mut server = Running::start_by(&mut command(folder, &domain, &["run", "robot.toml"]));
    server.wait_for_output("exposed to ROS 2: /asked");
    let mut robot =
        Running::start_by(&mut command(folder, &domain, &["run", "caller.toml", "--record", "called"]));
    robot.wait_for_output("exposed to ROS 2: /leaning");
    let echoed = ["topic", "echo", "--once", "/leaning"];
    let echoed = text(&command(folder, &domain, &echoed).output().unwrap());
    assert!(echoed.contains("data: "), "{echoed}\n{}", robot.output());
    robot.interrupt();
    server.interrupt();
    open_with_stock_readers(&folder.join("called"));
    // The bag contains the answers of the server, so it replays without it.
    let replayed = command(folder, &domain, &["bag", "replay", "caller.toml", "called"]).output().unwrap();
    assert!(replayed.status.success(), "{}", text(&replayed));

    write(
        folder,
        "caller.toml",
        &caller
            .replace("calls = [\"level\"]", "calls = [{ service = \"far\", type = \"lab_msgs/srv/Levl\" }]"),
    );
    let said = text(&command(folder, &domain, &["check", "caller.toml"]).output().unwrap());
    assert!(said.contains("unknown service type \"lab_msgs/srv/Levl\""), "{said}");
}

const TURN: &str = "float64 angle\n---\nfloat64 turned\n---\nfloat64 left\n";

const TURNER: &str = r#"
#include "downbeat.hpp"
#include "lab_msgs/action/turn.hpp"

using lab_msgs::action::Turn;

// Turns by a step in each period.
class Turner : public downbeat::Module {
    void setup() override {
        act<Turn>("turn", [this](const downbeat::Goal<Turn> &goal) {
            if (goal.request().angle > 3.0) {
                throw downbeat::Error("too far");
            }
            goals_.push_back({goal, 0.0});
        });
        every(std::chrono::milliseconds(20), [this] { work(); });
    }

    void work() {
        std::vector<Running> left;
        for (Running &running : goals_) {
            running.turned += 0.25;
            Turn::Result result;
            result.turned = running.turned;
            Turn::Feedback feedback;
            feedback.left = running.goal.request().angle - running.turned;
            running.goal.feedback(feedback);
            if (running.goal.is_canceling()) {
                running.goal.canceled(result);
            } else if (feedback.left <= 0.0) {
                running.goal.succeed(result);
            } else {
                left.push_back(running);
            }
        }
        goals_ = left;
    }

    struct Running {
        downbeat::Goal<Turn> goal;
        double turned;
    };
    std::vector<Running> goals_;
};

DOWNBEAT_MODULE(Turner)
"#;

const ASKER: &str = r#"
#include "downbeat.hpp"
#include "lab_msgs/action/turn.hpp"
#include "std_msgs/msg/float64.hpp"

using lab_msgs::action::Turn;
using std_msgs::msg::Float64;

// Turns a little further each time; publishes how far, or the status.
class Asker : public downbeat::Module {
    void setup() override {
        auto out = publish<Float64>("turned");
        auto turn = action_client<Turn>("turn", std::chrono::seconds(1));
        every(std::chrono::milliseconds(100), [this, out, turn] {
            Turn::Goal goal;
            goal.angle = number_++ % 4;
            turn.send(
                goal, [out](const downbeat::GoalEnd<Turn> &end) { out({end.result ? end.result->turned : -1.0}); },
                [out](const Turn::Feedback &feedback) { out({100.0 + feedback.left}); });
        });
    }
    int number_ = 1;
};

DOWNBEAT_MODULE(Asker)
"#;

/// The turner in C.
const TURNER_C: &str = r#"
#include "lab_msgs/action/turn.h"

typedef struct {
    downbeat_action_server turn;
} turner;

static void *create(const downbeat_host_v1 *host) {
    (void)host;
    return calloc(1, sizeof(turner));
}

static void destroy(void *self) {
    turner *of = self;
    for (downbeat_goal *goal = of->turn.goals; goal; goal = goal->next) {
        free(goal->user);
    }
    downbeat_action_server_fini(&of->turn);
    free(self);
}

static int32_t setup(void *self, const downbeat_host_v1 *host) {
    turner *of = self;
    return lab_msgs__action__Turn__serve(host, "turn", &of->turn) || host->timer(host, 20000000, NULL);
}

static int32_t take(turner *of, const downbeat_host_v1 *host, downbeat_goal *goal) {
    lab_msgs__action__Turn_Goal wanted = {0};
    int32_t code = lab_msgs__action__Turn__goal(host, goal, &wanted);
    if (code || wanted.angle > 3.0) {
        return code ? code : downbeat_goal_reject(host, &of->turn, goal);
    }
    double *left = malloc(sizeof *left);
    *left = wanted.angle;
    goal->user = left;
    return downbeat_goal_accept(host, &of->turn, goal);
}

static int32_t turn(turner *of, const downbeat_host_v1 *host, downbeat_goal *goal) {
    double *left = goal->user;
    *left -= 0.25;
    lab_msgs__action__Turn_Feedback feedback = {*left};
    int32_t code = lab_msgs__action__Turn__publish_feedback(host, &of->turn, goal, &feedback);
    if (code || (*left > 0.0 && !downbeat_goal_is_canceling(goal))) {
        return code;
    }
    lab_msgs__action__Turn_Goal wanted = {0};
    code = lab_msgs__action__Turn__goal(host, goal, &wanted);
    lab_msgs__action__Turn_Result result = {wanted.angle - *left};
    int8_t how = downbeat_goal_is_canceling(goal) ? DOWNBEAT_GOAL_CANCELED : DOWNBEAT_GOAL_SUCCEEDED;
    return code ? code : lab_msgs__action__Turn__end(host, &of->turn, goal, how, &result);
}

static int32_t handle(void *self, const downbeat_host_v1 *host, const downbeat_event_v1 *event) {
    turner *of = self;
    downbeat_goal *goal;
    int32_t code = downbeat_action_take(host, &of->turn, event, &goal);
    if (code == 0 && goal) {
        return take(of, host, goal);
    }
    for (goal = of->turn.goals; code == 0 && event->kind == DOWNBEAT_TIMER && goal; goal = goal->next) {
        if (downbeat_goal_is_active(goal)) {
            code = turn(of, host, goal);
        }
    }
    return code;
}

const downbeat_module_v1 *downbeat_module(void) {
    static const downbeat_module_v1 module = {
        .abi_version = DOWNBEAT_ABI_VERSION, .struct_size = sizeof module, .name = "turner",
        .create = create, .setup = setup, .handle = handle, .destroy = destroy};
    return &module;
}
"#;

/// The asker in C, which cancels each goal with the angle 3 after its first feedback.
const ASKER_C: &str = r#"
#include "lab_msgs/action/turn.h"
#include "std_msgs/msg/float64.h"

typedef struct {
    downbeat_action_client turn;
    downbeat_writer writer;
    int number;
    uint8_t far[16];
} asker;

static void *create(const downbeat_host_v1 *host) {
    (void)host;
    return calloc(1, sizeof(asker));
}

static void destroy(void *self) {
    asker *of = self;
    downbeat_action_client_fini(&of->turn);
    downbeat_writer_fini(&of->writer);
    free(self);
}

static int32_t setup(void *self, const downbeat_host_v1 *host) {
    asker *of = self;
    return lab_msgs__action__Turn__use(host, "turn", 1000000000, &of->turn) ||
           host->publisher(host, "turned", std_msgs__msg__Float64__TYPE, std_msgs__msg__Float64__HASH, NULL) ||
           host->timer(host, 100000000, NULL);
}

static int32_t handle(void *self, const downbeat_host_v1 *host, const downbeat_event_v1 *event) {
    asker *of = self;
    if (event->kind == DOWNBEAT_TIMER) {
        lab_msgs__action__Turn_Goal goal = {++of->number % 5};
        uint8_t id[16];
        int32_t code = lab_msgs__action__Turn__send(host, &of->turn, &goal, id);
        if (goal.angle == 3.0) {
            memcpy(of->far, id, 16);
        }
        return code;
    }
    downbeat_goal_news news;
    int32_t code = downbeat_action_hear(host, &of->turn, event, &news);
    std_msgs__msg__Float64 turned = {-1.0};
    if (code == 0 && news.kind == DOWNBEAT_GOAL_FEEDBACK) {
        lab_msgs__action__Turn_Feedback feedback = {0};
        code = lab_msgs__action__Turn__take_feedback(host, event, &feedback);
        turned.data = 100.0 + feedback.left;
        if (code == 0 && memcmp(of->far, news.id, 16) == 0) {
            code = downbeat_action_cancel(host, &of->turn, news.id);
        }
    }
    if (code == 0 && news.kind == DOWNBEAT_GOAL_END && !news.error) {
        lab_msgs__action__Turn_Result result = {0};
        code = lab_msgs__action__Turn__take_result(host, event, &result);
        turned.data = (news.status == DOWNBEAT_GOAL_CANCELED ? 200.0 : 0.0) + result.turned;
    }
    return code || news.kind == DOWNBEAT_GOAL_NOTHING ? code : std_msgs__msg__Float64__publish(host, 0, &turned, &of->writer);
}

const downbeat_module_v1 *downbeat_module(void) {
    static const downbeat_module_v1 module = {
        .abi_version = DOWNBEAT_ABI_VERSION, .struct_size = sizeof module, .name = "asker",
        .create = create, .setup = setup, .handle = handle, .destroy = destroy};
    return &module;
}
"#;

const TURNING: &str = r#"
[robot]
name = "turning"

[[module]]
kind = "library"
name = "turner"
path = "libturner.so"

[[module]]
kind = "library"
name = "asker"
path = "libasker.so"
isolate = true

[expose]
actions = ["turn"]
out = ["turned"]

[record]
topics = "all"
"#;

#[test]
fn libraries_in_cpp_serve_and_use_an_action_that_only_they_know() {
    serve_and_use_an_action("132", "cpp", "c++ -std=c++17", [TURNER, ASKER]);
}

#[test]
fn libraries_in_c_serve_and_use_an_action_that_only_they_know() {
    let Some(turned) = serve_and_use_an_action("176", "c", "cc -std=c11", [TURNER_C, ASKER_C]) else {
        return;
    };
    // Refused, reached, and canceled after the first feedback.
    for wanted in [-1.0, 1.0, 102.75] {
        assert!(turned.contains(&wanted), "{wanted} {turned:?}");
    }
    assert!(turned.iter().any(|turned| (200.25..202.0).contains(turned)), "{turned:?}");
}

/// Returns the messages published by the asker.
fn serve_and_use_an_action(
    domain: &str,
    language: &str,
    compiler: &str,
    sources: [&str; 2],
) -> Option<Vec<f64>> {
    if !has_compilers(&["cc", "c++"]) {
        return None;
    }
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    write(folder, "lab_msgs/action/Turn.action", TURN);
    write(folder, "robot.toml", TURNING);
    shell(folder, &format!("downbeat interface generate --lang {language} --from . lab_msgs"));
    shell(folder, &format!("downbeat interface generate --lang {language} std_msgs/msg/Float64"));
    for (name, source) in ["turner", "asker"].into_iter().zip(sources) {
        let flags = "-Wall -Wextra -Wpedantic -Werror -O1 -shared -fPIC -Iinclude";
        write(folder, &format!("{name}.{language}"), source);
        shell(folder, &format!("{compiler} {flags} {name}.{language} -o lib{name}.so"));
    }
    std::fs::remove_dir_all(folder.join("lab_msgs")).unwrap();
    let mut robot =
        Running::start_by(&mut command(folder, domain, &["run", "robot.toml", "--record", "turned"]));
    robot.wait_for_output("exposed service: /turn/_action/get_result");
    let send = |angle: &str, more: &[&str]| {
        let goal = ["action", "send_goal", "/turn", "lab_msgs/action/Turn", angle];
        text(&command(folder, domain, &[&goal, more].concat()).output().unwrap())
    };
    let sent = send("{angle: 1.0}", &["--feedback"]);
    assert!(sent.contains("turned: 1.0") && sent.contains("SUCCEEDED"), "{sent}\n{}", robot.output());
    assert!(sent.contains("left: 0.25"), "{sent}");
    let refused = send("{angle: 4.0}", &[]);
    assert!(refused.contains("Goal was rejected"), "{refused}");
    robot.interrupt();
    open_with_stock_readers(&folder.join("turned"));
    let replayed = command(folder, domain, &["bag", "replay", "robot.toml", "turned"]).output().unwrap();
    let said = text(&replayed);
    assert!(replayed.status.success() && said.contains("get_result answers"), "{said}");
    let bag = downbeat::bags::Reader::open(folder.join("turned")).unwrap();
    let topic = bag.topic("/turned").unwrap();
    let messages = bag.messages(downbeat::bags::Selection::all()).unwrap().map(Result::unwrap);
    let messages = messages.filter(|message| message.topic == topic);
    Some(messages.map(|message| f64::from_le_bytes(message.data[4..12].try_into().unwrap())).collect())
}
