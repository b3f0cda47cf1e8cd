//! A robot with libraries that the compilers of the machine build.
#![allow(dead_code)]

use downbeat_edge::Interfaces;
use downbeat_edge::foreign::ForeignModule;
use downbeat_executor::{Core, Inbox, ManualClock, ModuleOptions, Time};
use downbeat_library_host::messages::{Language, generate};
use downbeat_library_host::{LibraryOptions, load};
use downbeat_msgs::std_msgs::msg::Float64;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::mpsc::{Receiver, channel};
use std::sync::{Arc, LazyLock, Mutex};
use std::time::Duration;

pub const SOURCES: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/libraries");

pub fn has_compiler() -> bool {
    test_machine::has_compilers(&["cc", "c++"])
}

/// A folder with the headers of all carried interfaces.
pub fn generated() -> PathBuf {
    static FOLDER: LazyLock<PathBuf> = LazyLock::new(|| {
        let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join(format!("headers-{}", std::process::id()));
        write_headers(&folder);
        folder
    });
    FOLDER.clone()
}

fn write_headers(folder: &Path) {
    let catalog = downbeat_msgs::carried();
    let names: Vec<_> = catalog.messages().map(|message| message.name.clone()).collect();
    for language in [Language::C, Language::Cpp] {
        for header in generate(catalog, &names, language).unwrap() {
            let path = folder.join(&header.path);
            std::fs::create_dir_all(path.parent().unwrap()).unwrap();
            std::fs::write(path, header.text).unwrap();
        }
    }
}

pub fn c() -> Command {
    let mut command = Command::new("cc");
    command.arg("-std=c11");
    command
}

pub fn cpp() -> Command {
    let mut command = Command::new("c++");
    command.arg("-std=c++17");
    command
}

pub fn build(compiler: &mut Command, source: &str, include: &Path, defines: &[&str], library: &Path) {
    compiler
        .args(["-Wall", "-Wextra", "-Werror", "-O1", "-shared", "-fPIC", "-I"])
        .arg(include)
        .args(defines);
    let output = compiler.arg(Path::new(SOURCES).join(source)).arg("-o").arg(library).output().unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
}

/// Builds a library; `None` without a compiler.
pub fn library(source: &str, defines: &[&str]) -> Option<PathBuf> {
    if !has_compiler() {
        return None;
    }
    let name = format!("{source}{}-{}.so", defines.concat(), std::process::id());
    let path = Path::new(env!("CARGO_TARGET_TMPDIR")).join(name);
    let mut compiler = if source.ends_with(".c") { c() } else { cpp() };
    build(&mut compiler, source, &generated(), defines, &path);
    Some(path)
}

pub struct Robot {
    pub core: Core,
    clock: ManualClock,
}

impl Robot {
    pub fn new() -> Self {
        let clock = ManualClock::new(Time::ZERO);
        Self { core: Core::new().with_clock(clock.clone()), clock }
    }

    pub fn add(&mut self, library: &LibraryOptions, options: ModuleOptions) -> Result<(), String> {
        let (name, library, of_module) = (library.module.clone(), library.clone(), options.clone());
        let make = Arc::new(move || load(&library));
        let make = move || ForeignModule::new(make.clone(), Interfaces::carried(), of_module.clone());
        self.core.add_restartable(&name, make, options).map_err(|error| error.to_string())
    }

    pub fn receive(&mut self, topic: &str) -> Receiver<f64> {
        let (sender, receiver) = channel();
        let take = move |message: downbeat_executor::Received<'_, Float64>| _ = sender.send(message.data);
        std::mem::forget(self.core.outlet(topic, Inbox::KeepAll, take).unwrap());
        receiver
    }

    pub fn cycles(&mut self, count: u32) {
        for _ in 0..count {
            self.core.cycle().unwrap();
            self.clock.advance(Duration::from_millis(10));
        }
    }
}

/// Keeps the lines that are logged on this thread.
#[derive(Clone, Default)]
pub struct Log(Arc<Mutex<String>>);

impl Log {
    pub fn text(&self) -> String {
        self.0.lock().unwrap().clone()
    }
}

impl tracing::Subscriber for Log {
    fn enabled(&self, _: &tracing::Metadata<'_>) -> bool {
        true
    }

    fn new_span(&self, _: &tracing::span::Attributes<'_>) -> tracing::span::Id {
        tracing::span::Id::from_u64(1)
    }

    fn record(&self, _: &tracing::span::Id, _: &tracing::span::Record<'_>) {}

    fn record_follows_from(&self, _: &tracing::span::Id, _: &tracing::span::Id) {}

    fn event(&self, event: &tracing::Event<'_>) {
        struct Fields<'a>(&'a mut String);
        impl tracing::field::Visit for Fields<'_> {
            fn record_debug(&mut self, field: &tracing::field::Field, value: &dyn std::fmt::Debug) {
                *self.0 += &format!("{field}={value:?} ");
            }
        }
        let mut text = self.0.lock().unwrap();
        event.record(&mut Fields(&mut text));
        text.push('\n');
    }

    fn enter(&self, _: &tracing::span::Id) {}

    fn exit(&self, _: &tracing::span::Id) {}
}
