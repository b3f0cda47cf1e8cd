//! A robot from its robot file: modules in a core, ready to run.
//!
//! A robot file names a robot's modules, their settings, what is exposed and what is recorded:
//!
//! ```toml
//! [robot]
//! name = "darwin_op"                  # also the name of the ROS 2 node, unless `node` is given
//! namespace = "/"                     # of the node; ROS_NAMESPACE or none unless given
//! remap = { joint_states = "states" } # ROS 2 remapping rules, see below
//! params = ["params.yaml"]            # ROS 2 parameter files, relative to this file
//!
//! [launcher]
//! kind = "pool"
//! threads = 2
//!
//! [[module]]
//! name = "hardware"
//! kind = "darwin_op"                  # `downbeat check --kinds` lists them
//! settings = { port = "/dev/ttyUSB0" }
//! remap = { joint_commands = "joint_goals" }
//! priority = 80
//! restart = { times = 3, backoff = "500ms" }
//! deadline = "20ms"
//!
//! [expose]
//! out = ["joint_states", { topic = "imu/*", as = "/sensors/*", qos = "sensor_data", rate_hz = 10.0 }]
//! in = [{ topic = "joint_commands", type = "sensor_msgs/msg/JointState" }]
//!
//! [record]
//! topics = "all"
//! compression = "zstd"
//! encoding = "cdr"
//! ```
//!
//! Times are texts with a unit: `"50us"`, `"20ms"`, `"1.5s"`, `"5m"`, `"1h"`.
//!
//! # `[launcher]`
//! In short `launcher = "linear"`, `"pool"` (with `threads = 2`) or `"threads"` in `[robot]`.
//!
//! | key | value | unless given |
//! | --- | --- | --- |
//! | `kind` | `"linear"`: one thread; `"pool"`: the modules of a cycle shared among `threads`; `"threads"`: each module on its own | `"linear"` if there is no `[launcher]` |
//! | `threads` | of a pool, the core's own included | as many as the machine runs at once |
//! | `cpus` | numbers of the CPUs, from 0, on which these threads may run | all |
//! | `priority` | 1 to 99: `SCHED_FIFO` at this priority | as the program |
//! | `spin` | of pool and threads, between cycles: `"never"`, `"always"`, `"auto"`, or for a time before they park | `"auto"` |
//! | `idle` | what the core's thread does while nothing is due: `"park"` or `"spin"` | `"park"` |
//! | `deadline` | how long a cycle may take before it is reported | none |
//!
//! Which launcher it is changes no result. Where the system does not allow `cpus` or `priority`, `downbeat run` says
//! what to do and does not start, `downbeat check` warns, and a replay does without.
//!
//! # `[[module]]`
//! Modules start in the order of the file.
//!
//! | key | value | unless given |
//! | --- | --- | --- |
//! | `kind` | what it is; `downbeat check --kinds` lists them | needed |
//! | `name` | unique in the robot | the kind |
//! | `settings` | `downbeat check --kinds` lists them, with defaults and units | the defaults |
//! | `remap` | from the module's own name of a topic or service to the one to use | |
//! | `synchrony` | `"when_due"`: in cycles in which it has something to do; `"every_cycle"`; `"detached"`: on a thread of its own | as suits the kind |
//! | `inbox` | of a detached module: how many batches of a topic wait for it at the most, or `"all"` | as suits the kind, or 250 |
//! | `cpus`, `priority` | of a detached module's thread, as above | all; as the program |
//! | `initial_state` | `"active"`, `"inactive"` or `"unconfigured"`: the lifecycle state to which it is brought | `"active"` |
//! | `restart` | after a panic: `"never"`, `"always"` or how many times; or a table of that as `times` and of `backoff`, the time before, doubled with each panic up to 30 s | `"never"`; a back-off of 1 s |
//! | `deadline` | how long a run may take before it is reported | none |
//!
//! # `[expose]` and `[record]`
//! - `[expose]`: topics that go `out` to ROS 2 or come `in`: each a name, a pattern, or a table, see below; `services` of
//!   modules that ROS 2 may call, and `calls`, services of ROS 2 that modules call: each a name, or a table of `service`,
//!   `as`, the name in ROS 2, `type`, needed where no module knows it, and `timeout`, how long its server may take (10 s);
//!   `actions` of modules that ROS 2 may use, and `action_calls`, actions of ROS 2 that modules use, in the same way, with `action`
//!   in place of `service`;
//!   `service_introspection` and `client_introspection`: what services and calls publish on `<service>/_service_event`, "disabled",
//!   "metadata" or "contents", which the settings `service_configure_introspection` and `client_configure_introspection` of the module
//!   `bridge_services` change while the robot runs;
//!   `parameters`: settings that are parameters of the node, by name (`module.setting`) or pattern (`"*"` for all); the node has
//!   `use_sim_time` and what else rclcpp declares in any case.
//! - `lifecycle` of `[expose]`: modules that are managed nodes of ROS 2, by name or pattern: each is a node of that name with the
//!   services that `ros2 lifecycle` calls, `~/transition_event`, and its settings that are parameters under their own names;
//!   `{ module = "camera", node = "front_camera" }` gives the node another name. With `initial_state = "unconfigured"` a module
//!   waits for who manages it.
//! - Also of `[expose]`: `rosout`, whether the log goes to `/rosout`, and `logger_service`, whether tools may read and set the
//!   levels of loggers (`~/get_logger_levels`, `~/set_logger_levels`), both true unless given; `expose_service`, whether others
//!   may change what is exposed while the robot runs (`~/expose`), false unless given; `network`, whether
//!   modules are told of nodes, topics and services of others on the topic `network`, false unless given; `clock`, `"publish"` (or
//!   `{ publish_hz = 100.0 }`, 40 unless given): the robot's time goes to `/clock`, or `"follow"`: the robot's time is that of
//!   `/clock`, as with the parameter `use_sim_time`; `diagnostics`, whether the process tells of its modules and endpoints on the
//!   topic `diagnostics`, true unless given (ROS 2 sees it where that topic is `out`); `robot_description`, a URDF file, relative
//!   to this one, for the topic of that name.
//! - `[record]`: what `--record` writes, and how, see below.
//!
//! - `[replay]`: how `downbeat bag replay` compares: `modules`, the modules to run, all that can be unless given; `tolerance`,
//!   a list such as `["joint_states:position=1e-6", "imu/*=0.1%"]`; `ignore`, a list such as `["diagnostics", "imu/data_raw:header"]`
//!   (see [`FieldRule`](downbeat_bags::FieldRule)). Bit for bit where nothing is said.
//!
//! ## Exposed topics
//! In a pattern `*` stands for any characters of one part of a name, `**` for any number of parts. It means the topics
//! that carry ROS messages and that modules publish (`out`), or that modules receive and none publishes (`in`); it never
//! means those of the executor or of actions, and leaves alone what another entry names.
//!
//! | key | value | unless given |
//! | --- | --- | --- |
//! | `topic` | a name or a pattern | needed |
//! | `except` | names and patterns that a pattern does not mean | none |
//! | `as` | the name in ROS 2; of a pattern with the same wildcards, which stand for what they matched | the same |
//! | `type` | is checked; of a pattern it says which topics are meant; one of a package that is not compiled in passes as bytes | any |
//! | `raw` | `true`: messages pass as bytes, also of a type that is compiled in; needs `type` | by the type |
//! | `qos` | a preset: `"default"`, `"sensor_data"`, `"services"`, `"parameters"`, `"parameter_events"`, `"rosout"`, `"clock"`, `"latched"`, `"system_default"`, `"best_available"`; or a table | `"default"` |
//! | `rate_hz` | at most so many messages per second, on average, by the time of the executor | all |
//! | `every` | of so many messages one, the first among them | all |
//! | `latest_only` | `true`: of the messages of one cycle only the last | all |
//! | `node` | the node that has the endpoint: `"camera"` in the robot's namespace, or `"/front/camera"` | the robot's |
//!
//! A topic whose messages pass as bytes needs no module: modules that want it receive
//! [`RawMessage`](downbeat_bridge::edge::RawMessage)s, a bag holds it with its definition (from `AMENT_PREFIX_PATH`, else its
//! publisher is asked by `get_type_description`), and what comes in may go out under another name:
//! `in = [{ topic = "legs", type = "legs/msg/Leg" }]`, `out = [{ topic = "legs", as = "/robot2/legs", type = "legs/msg/Leg" }]`.
//!
//! A table of QoS has `preset` and what differs from it: `reliability`, `durability`, `history`, `depth`, `deadline`,
//! `lifespan`, `liveliness`, `liveliness_lease_duration`; times such as `"100ms"` or `"infinite"`. `"best_available"` is
//! decided when the endpoint is created, by the endpoints of others that are found by then, as in rmw; when a robot starts
//! these are none, so it is for what is exposed later ([`downbeat_bridge::ros::QosRequest`] has the rules). Parameters
//! `qos_overrides` of rclcpp are not heeded. `downbeat check` prints what would be exposed; `downbeat expose` changes it
//! while the robot runs.
//!
//! ## Recorded topics
//!
//! | key | value | unless given |
//! | --- | --- | --- |
//! | `topics` | `"all"`, or a list of names and patterns as above | `"all"` |
//! | `except` | names and patterns that are not recorded | none |
//! | `types` | only topics of these types | all |
//! | `modules` | only what these modules publish | all |
//! | `exposed` | `true`: only what is exposed to ROS 2; `false`: only what is not | both |
//! | `encoding` | how messages are serialised: `"cdr"` as ROS 2 does, `"json"`, `"cbor"`, `"protobuf"`, `"foxglove-protobuf"`, `"flatbuffers"`, `"foxglove-flatbuffers"` (see [`downbeat_msgs::encoding`]) | `"cdr"` |
//! | `storage` | `"mcap"` or, where built with the feature `sqlite`, `"sqlite3"`, for messages in `"cdr"` | `"mcap"` |
//! | `preset` | of rosbag2: `"none"`, `"fastwrite"`, `"zstd_fast"`, `"zstd_small"`; of `"sqlite3"` `"none"`, `"resilient"` | `"none"`, with checksums; `"resilient"` |
//! | `compression` | of chunks of `"mcap"`: `"none"`, `"lz4"`, `"zstd"` | as the preset |
//! | `chunk_size` | bytes of a chunk | as the preset, 786432 |
//! | `max_bag_size`, `max_bag_duration` | bytes, or time, after which the bag goes on in a new file | one file |
//! | `max_bag_files` | the oldest file is deleted when there would be more | all are kept |
//! | `max_cache_size` | bytes of messages that may wait for the disk | 64 MiB |
//! | `snapshot` | nothing is written but, on request, the messages of that time | all is written |
//! | `slow_disk` | when messages come faster than they can be written: `"drop"` them and count, or `"stop"` recording | `"drop"` |
//! | `disk_full` | when there is no room: `"stop"` recording, or `"drop"` and count until there is | `"stop"` |
//! | `sync` | when to wait for the medium: `"never"`, at the end of `"files"`, after `"chunks"` | `"files"` |
//!
//! While `downbeat run --record` records, the node `rosbag2_recorder` beside the robot's offers the services of the recorder of
//! rosbag2: `pause`, `resume`, `is_paused`, `split_bagfile`, `stop`, and `snapshot` where there are any.
//!
//! # ROS 2 names
//! `remap` in `[robot]` has the rules that ROS 2 programs take after `-r`: `joint_states = "states"`, `"__ns" = "/robot1"`,
//! `"camera:__node" = "front"`, `"rosservice://reset" = "restart"`. Behind `--ros-args` on the command line stand more,
//! which win: see [`RosArgs`]. As in rcl the first rule that applies to a name does, once.
//!
//! # ROS 2 parameters
//! Settings also come from ROS 2 parameter files, in `params` or with `--params-file`, and from `-p
//! module.setting:=value`. A later one wins over an earlier one, `-p` over files, and all over `settings`.
//!
//! ```yaml
//! /darwin_op:                         # the robot's node; or /** and the other wildcards of rcl
//!   ros__parameters:
//!     hardware.port: /dev/ttyUSB1     # module.setting
//!     mux: {hold_s: 1.0}              # the same as mux.hold_s
//! ```
//!
//! Values have the type of YAML 1.2, so `yes` is text and not true. `downbeat check --dump-params` writes such a file
//! of all settings; see [`RobotFile::set_from_parameter_file`].
//!
//! What is wrong with a file is told with its path and line, and the nearest valid name.

mod actions;
mod build;
mod catalog;
mod expose;
mod exposed;
mod file;
mod kind;
mod kinds;
mod lifecycle;
mod parameters;
mod recorded;
mod registration;
mod ros_args;
mod services;

pub use actions::Exposed;
pub use build::Robot;
pub use catalog::{Catalog, CatalogError};
pub use exposed::{ExposedEndpoint, ExposedQos, ExposedTraffic};
pub(crate) use file::toml_string;
pub use file::{
    ActionEntry, ClockChoice, Direction, ExposeEntry, ExposeSection, LauncherChoice, LauncherEntry,
    LifecycleEntry, ModuleEntry, NodeFeatures, RecordEntry, ReplaySection, RobotFile, RobotFileError,
    TopicChoice,
};
pub use kind::Kind;
pub(crate) use registration::unregistered;
pub use ros_args::{LogArguments, LogLevel, ParameterArgument, RosArgs, RosArgsError};
