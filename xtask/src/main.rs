//! Developer commands. `cargo xtask test` runs all checks that a change must pass.

mod aarch64;
mod audit;
mod bags;
mod book;
mod budget;
mod crates;
mod dist;
mod files;
mod fleet;
mod football;
mod install;
mod markdown;
mod matrix;
mod neighbours;
mod node;
mod notices;
mod packaging;
mod paths;
mod physics;
mod portability;
mod python;
mod readers;
mod recorder;
mod security;
mod skips;
mod steps;
mod test;
mod tidy;
mod walk;
mod wheel;
mod wire;

use clap::{Parser, Subcommand};
use std::process::ExitCode;

#[derive(Parser)]
#[command(name = "xtask", about = "Developer commands")]
struct Cli {
    #[command(subcommand)]
    command: Command,
}

#[derive(Subcommand)]
enum Command {
    /// Formatting, clippy, documentation and all tests, including those against real ROS 2 and other bag
    /// readers. Installs what they need under target/.
    Test,
    /// The rules of the layout: what may use what, links, the code map. Part of the test run.
    Tidy,
    /// Licences, duplicate versions and origins of the crates of others, which is part of the test run; and
    /// known vulnerabilities and yanked versions.
    Audit {
        /// A clone of the RustSec advisory database. Without one, it is downloaded.
        #[arg(long, value_name = "FOLDER")]
        db: Option<std::path::PathBuf>,
    },
    /// README.md and docs/ as a site with search, and the documentation of the crates, under
    /// target/book/html; then the documentation of each crate as docs.rs writes it.
    /// Fails if a link leads nowhere.
    Book,
    /// What a default build costs: its crates, and the code of ours as the tests compile it. Part of the test
    /// run, which fails if it is more than 10 % above the recorded numbers.
    Budget {
        /// Record the numbers of now in place of comparing with those recorded.
        #[arg(long)]
        record: bool,
    },
    /// The tests that the latest run skipped, and what the machine lacks for them. Such a test passes, except
    /// with DOWNBEAT_STRICT=1.
    Skips,
    /// The long tests of the RTPS engine, about a quarter of an hour: rustdds and DDS Security in the
    /// conformance suite, rustdds with DDS Security, 10 000 simulated networks, 10 million hostile datagrams.
    Wire,
    /// Fifty robots in a fleet on Zenoh, about a quarter of an hour, as root: three hosts, two routers, 200
    /// joins, routers that restart, a cable that is pulled, slow and bad lines. Prints what it measures.
    Fleet,
    /// Random changes of all that DDS Security reads from files and peers, millions for each parser.
    Security {
        /// Changed inputs for each parser.
        #[arg(long, default_value_t = 10_000_000)]
        rounds: u64,
    },
    /// The tests of executor, messages, bags and the RTPS engine on aarch64 under qemu; and recorded runs, of
    /// each processor on the other, bit for bit. About an hour, most of which builds.
    Aarch64,
    /// The long tests of damaged bags, some minutes: every command on 500 mutations of each recorded bag, and
    /// a million mutations of small bag files.
    Bags,
    /// The recorder under load, some minutes: 10 MB/s beside busy cores, slow and full disks (as root),
    /// splits, kills, large messages, floods. Prints what is lost and which other readers open the bags, and
    /// fails if a message is neither written nor counted.
    Recorder {
        /// The duration of the recording beside busy cores.
        #[arg(long, default_value_t = 2.0, value_name = "N")]
        minutes: f64,
    },
    /// All tests, of which every bag is kept and opened with the readers of others, about an hour. Prints
    /// which they refuse and why, and fails if one has no reason that is known.
    Readers,
    /// The crates as they would be published: packaged, installed with `cargo install` from a registry in a
    /// folder, and a project of `downbeat new` built with them. Part of the test run.
    Crates {
        /// Only compile what is installed.
        #[arg(long)]
        compile: bool,
    },
    /// The Debian package of what `crates` installs, checked, installed into an empty root, run and removed.
    /// Part of the test run.
    Deb {
        /// Package this program, instead of installing one from the packages first.
        #[arg(long)]
        program: Option<std::path::PathBuf>,
    },
    /// A ROS workspace in a clean folder: colcon builds the checkout and a project of the template `ros`,
    /// which are run, by launch files too, and removed. Some minutes.
    Colcon,
    /// The wheel of the Python package, for release, under target/wheels; prints its path. Without features
    /// it shares what the first command of the README has compiled.
    Wheel {
        /// Features of downbeat that it has beside the default ones, such as `physics`, or `full`, which
        /// compiles for a quarter of an hour.
        #[arg(long, value_delimiter = ',', conflicts_with = "test")]
        features: Vec<String>,
        /// Build it for development instead, and run its tests in a fresh environment.
        #[arg(long)]
        test: bool,
    },
    /// The files of a release for one platform: tarball, Debian package and wheel, with hashes and SBOM,
    /// under target/dist. About half an hour.
    Dist(dist::DistArguments),
    /// The tasks of the simulated Darwin OP (walk, turn, kick, get up, ...) in 20 perturbed worlds each,
    /// minutes; prints how many succeed. See `--help` behind `--` for options: seeds, tasks, and the engine.
    Physics {
        /// Options of the run
        #[arg(trailing_var_arg = true, allow_hyphen_values = true)]
        arguments: Vec<String>,
    },
    /// The long proofs of the football player, about an hour: vision, localisation, an empty goal, matches,
    /// recorded matches. Prints each figure beside its goal, and fails if one misses it.
    Football(football::FootballArguments),
    /// LeRobot itself reads the data sets that `bag export` writes, and writes one that `bag import` reads;
    /// and how fast they are written. Downloads 4 GB.
    Neighbours,
    /// Records the simulated walk of tests/walk_replay.rs again, after a change of the gait, the motions, the
    /// falls or the physics; then runs the tests that replay it.
    RecordWalk,
    /// Checks the program for Windows and macOS, some minutes. Needs the sources of the standard library and
    /// a tool of Windows: Debian's packages rust-web-src and binutils-mingw-w64-x86-64.
    Portability,
    /// Only the Python environment under target/venv; prints the path of its interpreter.
    Python,
    /// Only the npm packages under target/node; prints their folder, or nothing if there is no Node.js.
    Node,
}

fn main() -> ExitCode {
    let result = match Cli::parse().command {
        Command::Test => test::test(),
        Command::Tidy => tidy::tidy(),
        Command::Audit { db } => audit::audit(db.as_deref()),
        Command::Book => book::book(),
        Command::Budget { record: false } => budget::check(test::ALL),
        Command::Budget { record: true } => budget::record(test::ALL),
        Command::Skips => skips::print_latest(),
        Command::Wire => wire::wire(),
        Command::Fleet => fleet::fleet(),
        Command::Security { rounds } => security::security(rounds),
        Command::Aarch64 => aarch64::aarch64(),
        Command::Bags => bags::bags(),
        Command::Recorder { minutes } => recorder::recorder(minutes),
        Command::Readers => readers::readers(),
        Command::Crates { compile: true } => install::compile_packages(),
        Command::Crates { compile: false } => install::cargo_install().map(drop),
        Command::Deb { program } => program
            .map_or_else(install::cargo_install, Ok)
            .and_then(|program| with_skips(|skips| install::debian_package(&program, skips))),
        Command::Colcon => with_skips(install::ros_workspace),
        Command::Neighbours => neighbours::neighbours(),
        Command::RecordWalk => walk::record(),
        Command::Wheel { test: true, .. } => with_skips(wheel::test),
        Command::Wheel { test: false, features } => {
            wheel::build(&features).map(|path| println!("{}", path.display()))
        }
        Command::Dist(arguments) => dist::dist(arguments),
        Command::Physics { arguments } => physics::physics(&arguments),
        Command::Football(arguments) => football::football(&arguments),
        Command::Portability => portability::portability(),
        Command::Python => python::interpreter().map(|path| println!("{}", path.display())),
        Command::Node => {
            node::modules().map(|path| path.iter().for_each(|path| println!("{}", path.display())))
        }
    };
    match result {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("xtask: {error:#}");
            ExitCode::FAILURE
        }
    }
}

/// Runs tests, and lists those that were skipped.
fn with_skips(tests: impl FnOnce(&skips::Run) -> anyhow::Result<()>) -> anyhow::Result<()> {
    let skips = skips::Run::new()?;
    let tested = tests(&skips);
    skips.print()?;
    tested
}
