//! Robot files to begin with.

use serde::Serialize;

use downbeat_robot::Catalog;

/// A robot file to begin with.
#[derive(Serialize)]
pub(crate) struct Template {
    pub(crate) name: &'static str,
    pub(crate) title: &'static str,
    pub(crate) about: &'static str,
    #[serde(skip)]
    pub(crate) text: &'static str,
    /// The kinds that it needs.
    pub(crate) kinds: &'static [&'static str],
    /// Names and contents of files that it needs beside the robot file.
    #[serde(skip)]
    pub(crate) files: &'static [(&'static str, &'static str)],
}

/// A file of a project that `downbeat new` creates.
macro_rules! of_project {
    ($path:literal) => {
        include_str!(concat!("../../new/templates/", $path))
    };
}

pub(crate) static ALL: [Template; 8] = [
    Template {
        name: "empty",
        title: "Empty robot",
        about: "A name and no modules: add them from the list of kinds.",
        text: include_str!("empty.toml"),
        kinds: &[],
        files: &[],
    },
    Template {
        name: "darwin_op",
        title: "Darwin OP emulated",
        about: "A humanoid with 20 emulated servos that stands up, nods and waves. Runs on every machine.",
        text: include_str!("darwin_op.toml"),
        kinds: &["darwin_op_emulator", "darwin_op", "stand_nod_wave", "joint_command_mux"],
        files: &[],
    },
    Template {
        name: "darwin_op_walks",
        title: "Darwin OP walks",
        about: "The humanoid in a simulated world: it walks by the topic cmd_vel, and gets up when it falls.",
        text: include_str!("darwin_op_walks.toml"),
        kinds: &[
            "darwin_op_simulator",
            "darwin_op",
            "imu_filter",
            "gait",
            "falls",
            "motions",
            "joint_command_mux",
        ],
        files: &[],
    },
    Template {
        name: "rover",
        title: "Rover",
        about: "Two driven wheels, emulated: cmd_vel, odometry, tf. Writes rover_servos.toml and rover.urdf beside the robot file.",
        text: concat!(of_project!("rover/robot.toml"), of_project!("rover/by_hand.toml")),
        kinds: &["servo_emulator", "servo_bus", "diff_drive", "robot_state_publisher"],
        files: &[
            ("rover_servos.toml", of_project!("rover/rover_servos.toml")),
            ("rover.urdf", of_project!("rover/rover.urdf")),
        ],
    },
    Template {
        name: "arm",
        title: "Arm",
        about: "Four servos, emulated, and a trajectory controller. Writes arm_servos.toml and arm.urdf beside the robot file.",
        text: of_project!("arm/robot.toml"),
        kinds: &["servo_emulator", "servo_bus", "joint_trajectory", "robot_state_publisher"],
        files: &[
            ("arm_servos.toml", of_project!("arm/arm_servos.toml")),
            ("arm.urdf", of_project!("arm/arm.urdf")),
        ],
    },
    Template {
        name: "camera",
        title: "Camera",
        about: "A simulated camera, and a module that looks at its pictures with NumPy. Writes camera.py and spot.py beside the robot file.",
        text: of_project!("camera/robot.toml"),
        kinds: &["python"],
        files: &[("camera.py", of_project!("camera/camera.py")), ("spot.py", of_project!("camera/spot.py"))],
    },
    Template {
        name: "python",
        title: "Modules in Python",
        about: "Two modules in Python that change while the robot runs. Writes level_head.py and simulated_imu.py beside the robot file.",
        text: of_project!("python/robot.toml"),
        kinds: &["python"],
        files: &[
            ("level_head.py", of_project!("python/level_head.py")),
            ("simulated_imu.py", of_project!("python/simulated_imu.py")),
        ],
    },
    Template {
        name: "cpp",
        title: "Modules in C++",
        about: "Two modules in C++, to build with CMake first. Writes level_head.cpp, simulated_imu.cpp and CMakeLists.txt beside the robot file.",
        text: of_project!("cpp/robot.toml"),
        kinds: &["library"],
        files: &[
            ("level_head.cpp", of_project!("cpp/level_head.cpp")),
            ("simulated_imu.cpp", of_project!("cpp/simulated_imu.cpp")),
            ("CMakeLists.txt", of_project!("cpp/CMakeLists.txt")),
        ],
    },
];

/// The template of that name.
///
/// # Errors
/// In words for the user, if there is none.
pub(crate) fn find(name: &str) -> Result<&'static Template, String> {
    ALL.iter()
        .find(|template| template.name == name)
        .ok_or_else(|| format!("there is no template \"{name}\""))
}

/// The templates whose kinds there are.
pub(crate) fn usable(catalog: &Catalog) -> impl Iterator<Item = &'static Template> {
    ALL.iter().filter(|template| template.kinds.iter().all(|kind| catalog.kind(kind).is_some()))
}
