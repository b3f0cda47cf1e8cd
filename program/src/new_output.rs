//! The rule for output of all commands.
//!
//! Existing output is kept, unless `--force` is given. A directory is replaced only if it contains nothing
//! but output of such a command, so that a wrong path does not delete a home directory. Recordings of runs
//! are numbered.

use std::ffi::OsStr;
use std::fs;
use std::path::{Path, PathBuf};

use anyhow::{Context, bail};
use clap::Args;

use downbeat_robot::SOURCES_FOLDER;

#[derive(Args, Clone, Copy, Debug, Default)]
pub(crate) struct Force {
    /// Replace the output if it exists already.
    #[arg(long)]
    pub(crate) force: bool,
}

/// The kind of output.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Output {
    /// A rosbag2 directory.
    Bag,
    /// A directory of tables.
    Tables,
    /// A directory of a data set.
    #[cfg_attr(not(feature = "tables"), expect(dead_code, reason = "only `bag export -f lerobot` makes one"))]
    Dataset,
    File,
}

impl Output {
    fn name(self) -> &'static str {
        match self {
            Self::Bag => "bag",
            Self::Tables => "directory of tables",
            Self::Dataset => "data set",
            Self::File => "file",
        }
    }

    /// Returns whether it may contain a file of that name.
    fn holds(self, name: &str) -> bool {
        const BAG: [&str; 6] = [".mcap", ".mcap.zstd", ".db3", ".db3.zstd", ".db3-wal", ".db3-shm"];
        const TABLES: [&str; 3] = [".csv", ".jsonl", ".parquet"];
        let ends_with = |endings: &[&str]| endings.iter().any(|ending| name.ends_with(ending));
        match self {
            Self::Bag => ["metadata.yaml", ".metadata.yaml.new"].contains(&name) || ends_with(&BAG),
            Self::Tables => ends_with(&TABLES),
            Self::Dataset => false,
            Self::File => false,
        }
    }
}

fn has_only_files(folder: &Path) -> bool {
    let is_file = |entry: std::io::Result<fs::DirEntry>| entry.is_ok_and(|entry| entry.path().is_file());
    fs::read_dir(folder).is_ok_and(|mut entries| entries.all(is_file))
}

/// Whether a folder is `data` or `meta` of a data set of LeRobot, with nothing else in it.
fn is_of_dataset(folder: &Path) -> bool {
    let name = |path: &Path| path.file_name().unwrap_or_default().to_string_lossy().into_owned();
    let all = |folder: &Path, holds: &dyn Fn(&Path) -> bool| {
        fs::read_dir(folder).is_ok_and(|entries| {
            entries.into_iter().all(|entry| entry.is_ok_and(|entry| holds(&entry.path())))
        })
    };
    let is_file =
        |path: &Path| path.is_file() && name(path).starts_with("file-") && name(path).ends_with(".parquet");
    let is_chunk = |path: &Path| name(path).starts_with("chunk-") && all(path, &is_file);
    let is_of_meta = |path: &Path| match &*name(path) {
        "info.json" | "stats.json" | "tasks.parquet" => path.is_file(),
        "episodes" => all(path, &is_chunk),
        _ => false,
    };
    match &*name(folder) {
        "data" => all(folder, &is_chunk),
        "meta" => all(folder, &is_of_meta),
        _ => false,
    }
}

impl Force {
    /// Checks that `path` can be written, before a long operation starts.
    pub(crate) fn check(self, output: Output, path: &Path) -> anyhow::Result<()> {
        if path.file_name().is_some_and(|name| name.to_str().is_none()) {
            bail!("the name {} is not UTF-8; choose another for the {}", path.display(), output.name());
        }
        let Ok(metadata) = fs::metadata(path) else { return Ok(()) };
        let shown = path.display();
        let is_directory = metadata.is_dir();
        // A pipe or a terminal has no contents to lose.
        if output == Output::File && !is_directory && !metadata.is_file() {
            return Ok(());
        }
        if is_directory == (output == Output::File) {
            let (is, wanted) = if is_directory { ("a directory", "file") } else { ("a file", output.name()) };
            bail!("{shown} exists already and is {is}; choose another path for the {wanted}");
        }
        if !self.force {
            bail!("{shown} exists already; choose another path, or replace it with --force");
        }
        if is_directory {
            for entry in fs::read_dir(path).with_context(|| format!("cannot read {shown}"))? {
                let entry = entry.with_context(|| format!("cannot read {shown}"))?;
                let name = entry.file_name();
                let is_of_it = match entry.path().is_dir() {
                    true => match output {
                        Output::Bag => name == SOURCES_FOLDER && has_only_files(&entry.path()),
                        Output::Dataset => is_of_dataset(&entry.path()),
                        Output::Tables | Output::File => false,
                    },
                    false => output.holds(&name.to_string_lossy()),
                };
                if !is_of_it {
                    bail!(
                        "{shown} is not replaced: it contains {}, which is not part of a {}",
                        name.display(),
                        output.name()
                    );
                }
            }
        }
        Ok(())
    }

    /// Like [`Force::check`]. `inputs` are never replaced.
    pub(crate) fn check_with<'a>(
        self,
        output: Output,
        path: &Path,
        inputs: impl IntoIterator<Item = &'a Path>,
    ) -> anyhow::Result<()> {
        self.check(output, path)?;
        let Ok(place) = fs::canonicalize(path) else { return Ok(()) };
        for input in inputs {
            if fs::canonicalize(input).is_ok_and(|input| input.starts_with(&place)) {
                bail!("{} is the input; choose another path for the {}", path.display(), output.name());
            }
        }
        Ok(())
    }

    /// Like [`Force::check_with`], and removes existing output.
    pub(crate) fn make_way<'a>(
        self,
        output: Output,
        path: &Path,
        inputs: impl IntoIterator<Item = &'a Path>,
    ) -> anyhow::Result<()> {
        self.check_with(output, path, inputs)?;
        let Ok(place) = fs::canonicalize(path) else { return Ok(()) };
        // Files are overwritten.
        if output != Output::File {
            fs::remove_dir_all(&place).with_context(|| format!("cannot replace {}", path.display()))?;
        }
        Ok(())
    }

    /// The directory of the next run: `path` for the first and, with `--force`, for every run, otherwise
    /// `path` with the first number above those of earlier runs, `run_2`, `run_3`. A robot that a supervisor
    /// restarts records again, and no run is taken for a part of another.
    pub(crate) fn next_run(self, path: &Path) -> anyhow::Result<PathBuf> {
        let name = path.file_name().and_then(OsStr::to_str);
        let (false, true, Some(name)) = (self.force, path.is_dir(), name) else {
            return Ok(path.to_owned());
        };
        let folder = match path.parent() {
            Some(folder) if !folder.as_os_str().is_empty() => folder,
            _ => Path::new("."),
        };
        let read = || -> std::io::Result<u64> {
            let mut latest = 1;
            for entry in fs::read_dir(folder)? {
                let entry = entry?.file_name();
                let number = entry.to_str().and_then(|other| other.strip_prefix(name)?.strip_prefix('_'));
                latest = latest.max(number.and_then(|number| number.parse().ok()).unwrap_or(0));
            }
            Ok(latest)
        };
        let latest = read().with_context(|| format!("cannot read {}", folder.display()))?;
        let Some(next) = latest.checked_add(1) else {
            bail!("no number above {name}_{latest} is left; choose another path for the bag");
        };
        Ok(path.with_file_name(format!("{name}_{next}")))
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]

    use super::*;

    #[test]
    fn each_run_has_the_next_number() {
        let folder = tempfile::tempdir().unwrap();
        let bag = folder.path().join("run");
        let next = || Force::default().next_run(&bag).unwrap();
        for name in ["run", "run_2", "run_3"] {
            assert_eq!(next(), folder.path().join(name));
            fs::create_dir(next()).unwrap();
        }
        // A removed run leaves a gap, so that the numbers keep their order; other names are not runs.
        fs::remove_dir(folder.path().join("run_2")).unwrap();
        fs::create_dir(folder.path().join("run_9_repaired")).unwrap();
        assert_eq!(next(), folder.path().join("run_4"));
        assert_eq!(Force { force: true }.next_run(&bag).unwrap(), bag);
    }

    fn refused(force: bool, output: Output, path: &Path) -> String {
        Force { force }.make_way(output, path, []).unwrap_err().to_string()
    }

    #[test]
    fn existing_output_is_replaced_only_on_request() {
        let folder = tempfile::tempdir().unwrap();
        let (bag, file) = (folder.path().join("bag"), folder.path().join("trace.json"));
        for output in [Output::Bag, Output::Tables] {
            Force::default().make_way(output, &bag, []).unwrap();
        }
        fs::create_dir(&bag).unwrap();
        fs::write(bag.join("metadata.yaml"), "").unwrap();
        fs::write(bag.join("bag_0.mcap"), "").unwrap();
        fs::write(&file, "").unwrap();
        for (output, path) in [(Output::Bag, &bag), (Output::File, &file)] {
            let error = refused(false, output, path);
            assert!(error.contains("--force") && error.contains(&path.display().to_string()), "{error}");
            assert!(path.exists());
            Force { force: true }.make_way(output, path, []).unwrap();
        }
        assert!(!bag.exists());
    }

    #[test]
    fn a_directory_with_other_contents_is_kept() {
        let folder = tempfile::tempdir().unwrap();
        fs::write(folder.path().join("bag_0.mcap"), "").unwrap();
        fs::write(folder.path().join("thesis.tex"), "").unwrap();
        let error = refused(true, Output::Bag, folder.path());
        assert!(error.contains("thesis.tex"), "{error}");
        assert!(refused(true, Output::Tables, folder.path()).contains("not part of a directory of tables"));
        assert!(refused(true, Output::File, folder.path()).contains("is a directory"));
        assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 2);
    }

    #[test]
    fn the_input_is_not_replaced() {
        let folder = tempfile::tempdir().unwrap();
        let bag = folder.path().join("bag");
        fs::create_dir(&bag).unwrap();
        fs::write(bag.join("bag_0.mcap"), "").unwrap();
        for input in [bag.clone(), bag.join("bag_0.mcap"), bag.join("../bag")] {
            let error =
                Force { force: true }.make_way(Output::Bag, &bag, [input.as_path()]).unwrap_err().to_string();
            assert!(error.contains("is the input"), "{error}");
        }
        assert!(bag.join("bag_0.mcap").exists());
    }
}
