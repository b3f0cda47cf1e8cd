//! The options of how a bag is written, as options of commands: `downbeat_robot` declares them.

use std::marker::PhantomData;

use clap::builder::{PossibleValue, PossibleValuesParser};
use clap::{Arg, ArgAction, ArgMatches, Args, Command, FromArgMatches};
use downbeat_bags::Storage;
use downbeat_robot::RecordOptions;
use downbeat_robot::record_options::{RECORD_OPTIONS, RecordOption, Scope, Takes};

/// The options that a command line contains, of those in a scope.
pub(crate) struct GivenOptions<S> {
    given: Vec<(&'static RecordOption, String)>,
    scope: PhantomData<S>,
}

/// Which options a command has.
pub(crate) trait Scoped {
    fn has(scope: Scope) -> bool;
}

/// All options, for commands that record.
pub(crate) enum Recording {}

/// The options of files, for commands that write bags out of others.
pub(crate) enum Copying {}

impl Scoped for Recording {
    fn has(_: Scope) -> bool {
        true
    }
}

impl Scoped for Copying {
    fn has(scope: Scope) -> bool {
        scope == Scope::Files
    }
}

impl<S: Scoped> GivenOptions<S> {
    /// Applies the given values, in the order in which options are declared.
    pub(crate) fn apply(&self, options: &mut RecordOptions) -> anyhow::Result<()> {
        for (option, text) in &self.given {
            option.set_text(options, text).map_err(anyhow::Error::msg)?;
        }
        Ok(())
    }

    fn options() -> impl Iterator<Item = &'static RecordOption> {
        RECORD_OPTIONS.iter().filter(|option| S::has(option.scope))
    }
}

impl<S: Scoped> FromArgMatches for GivenOptions<S> {
    fn from_arg_matches(matches: &ArgMatches) -> Result<Self, clap::Error> {
        let mut given = Vec::new();
        for option in Self::options() {
            if let Takes::Switch(_) = option.takes {
                if matches.get_flag(option.key) {
                    given.push((option, "true".to_owned()));
                }
            } else {
                let texts = matches.get_many::<String>(option.key).into_iter().flatten();
                given.extend(texts.map(|text| (option, text.clone())));
            }
        }
        Ok(Self { given, scope: PhantomData })
    }

    fn update_from_arg_matches(&mut self, matches: &ArgMatches) -> Result<(), clap::Error> {
        *self = Self::from_arg_matches(matches)?;
        Ok(())
    }
}

impl<S: Scoped> Args for GivenOptions<S> {
    fn augment_args(command: Command) -> Command {
        command.args(Self::options().map(argument))
    }

    fn augment_args_for_update(command: Command) -> Command {
        Self::augment_args(command)
    }
}

fn argument(option: &'static RecordOption) -> Arg {
    let mut argument = Arg::new(option.key).long(option.flag).help(help(option));
    if let Some(letter) = option.letter {
        argument = argument.short(letter);
    }
    if let Some(alias) = option.alias {
        argument = argument.visible_alias(alias);
    }
    if let Takes::Switch(_) = option.takes {
        return argument.action(ArgAction::SetTrue);
    }
    argument = argument.value_name(option.value_name());
    match &option.takes {
        Takes::Choice(choices) => {
            let choices =
                choices.iter().map(|choice| PossibleValue::new(choice.name).help(plain(choice.help)));
            argument.value_parser(PossibleValuesParser::new(choices))
        }
        // Which presets there are depends on the storage.
        Takes::Preset => argument,
        Takes::Entries(_) => argument.value_parser(checked(option)).num_args(1..).action(ArgAction::Append),
        _ => argument.value_parser(checked(option)),
    }
}

/// Reports a value that the option does not take while the command line is parsed.
fn checked(option: &'static RecordOption) -> impl Fn(&str) -> Result<String, String> + Clone {
    |text| option.set_text(&mut RecordOptions::default(), text).map(|()| text.to_owned())
}

fn help(option: &RecordOption) -> String {
    let of = |storage: Storage| storage.presets().join(", ");
    let presets = match option.takes {
        Takes::Preset => format!(" {}; for sqlite3 {}", of(Storage::Mcap), of(Storage::Sqlite3)),
        _ => String::new(),
    };
    format!("{}{presets} [default: {}]", option.help, plain(option.default))
}

/// A text of the declaration, which is Markdown, for a terminal.
fn plain(text: &str) -> String {
    text.replace('`', "")
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]

    use std::path::Path;

    use clap::Parser;
    use downbeat_bags::StorageOptions;
    use downbeat_robot::{Catalog, RobotFile, Source};

    use super::*;

    #[derive(Parser)]
    struct Line {
        #[command(flatten)]
        options: GivenOptions<Recording>,
    }

    fn from_file(record: &str) -> Option<String> {
        let text = format!("[robot]\nname = \"r\"\n[[module]]\nkind = \"darwin_op\"\n[record]\n{record}\n");
        let file = RobotFile::read_alone(Source::new(Path::new("test.toml"), text), &Catalog::built_in());
        Some(format!("{:?}", file.ok()?.record.options))
    }

    fn from_line(words: &[&str]) -> Option<String> {
        let line = Line::try_parse_from([&["test"], words].concat()).ok()?;
        let mut options = RecordOptions::default();
        line.options.apply(&mut options).ok()?;
        Some(format!("{options:?}"))
    }

    /// Values of an option: as in a robot file, and on the command line.
    fn values(option: &RecordOption) -> Vec<(String, &'static str)> {
        let same = |text: &'static str| vec![(text.to_owned(), text)];
        let quoted = |text: &'static str| (format!("\"{text}\""), text);
        match &option.takes {
            Takes::Choice(choices) => choices.iter().map(|choice| quoted(choice.name)).collect(),
            Takes::Preset => ["fastwrite", "zstd_fast", "zstd_small"].map(quoted).into(),
            Takes::Bytes { .. } => same("123456"),
            Takes::Count(_) => same("7"),
            Takes::Time(_) => vec![quoted("7s"), ("\"9s\"".into(), "9")],
            Takes::Switch(_) => vec![("true".into(), "")],
            Takes::Text(_) => vec![quoted("a.b < 1")],
            Takes::Entries(_) => vec![("{ place = \"lawn\" }".into(), "place=lawn")],
        }
    }

    #[test]
    fn every_option_has_the_same_effect_in_a_robot_file_and_on_the_command_line() {
        let default = format!("{:?}", RecordOptions::default());
        for option in RECORD_OPTIONS {
            let mut effects = 0;
            for (in_file, on_line) in values(option) {
                let file = from_file(&format!("{} = {in_file}", option.key));
                for name in [Some(option.flag), option.alias].into_iter().flatten() {
                    let flag = format!("--{name}");
                    let words = if on_line.is_empty() { vec![&*flag] } else { vec![&*flag, on_line] };
                    assert_eq!(file, from_line(&words), "{} = {in_file}", option.key);
                }
                if let Some(letter) = option.letter {
                    assert_eq!(file, from_line(&[&format!("-{letter}"), on_line]), "-{letter} {on_line}");
                }
                effects += usize::from(file.is_some_and(|options| options != default));
            }
            // Without the feature `sqlite` only the default storage can be chosen.
            let has_one_value = option.key == "storage" && StorageOptions::of(Storage::Sqlite3).is_err();
            assert!(effects > 0 || has_one_value, "{} has no effect", option.key);
        }
    }

    #[test]
    fn values_that_an_option_does_not_take_are_refused_with_its_name() {
        for (words, problem) in [
            (&["--chunk-size", "10"][..], "--chunk-size <BYTES>': \"10\" is not a number of bytes from 1024"),
            (&["--max-bag-files", "0"], "\"0\" is not a whole number above 0"),
            (&["--custom-data", "lawn"], "\"lawn\" is not KEY=VALUE"),
            (&["--flush-interval", "soon"], "--flush-interval <TIME>"),
            (&["--sync", "file"], "a similar value exists: 'files'"),
        ] {
            let error = Line::try_parse_from([&["test"], words].concat()).err().unwrap().to_string();
            assert!(error.contains(problem), "{error}");
        }
    }

    #[test]
    fn compression_overrides_a_preset_regardless_of_the_order() {
        let compressed = from_line(&["--compression", "lz4", "--storage-preset-profile", "zstd_small"]);
        assert_eq!(compressed, from_file("preset = \"zstd_small\"\ncompression = \"lz4\""));
        assert!(compressed.is_some_and(|options| options.contains("Lz4")));
    }
}
