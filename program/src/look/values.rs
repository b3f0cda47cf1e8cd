//! Values of options.

use std::io::Read;
use std::time::Duration;

use anyhow::{Context, bail};
use clap::Args;
use downbeat_files::duration::parse_or_seconds;

/// Parses a time above 0: seconds, or with a unit.
pub(super) fn seconds(text: &str) -> Result<Duration, String> {
    match parse_or_seconds(text)? {
        Duration::ZERO => Err("Value must be positive".into()),
        time => Ok(time),
    }
}

/// A positive floating-point number.
pub(super) fn positive(text: &str) -> Result<f64, String> {
    let number: f64 = text.parse().map_err(|_| "Expects a floating point number".to_owned())?;
    if number.is_finite() && number > 0.0 { Ok(number) } else { Err("Value must be positive".into()) }
}

/// The period of a rate [Hz].
pub(super) fn period(rate: f64) -> anyhow::Result<Duration> {
    Duration::try_from_secs_f64(1.0 / rate).with_context(|| format!("a rate of {rate} Hz has no period"))
}

/// The fields of a message in YAML.
#[derive(Args)]
pub(crate) struct FieldArguments {
    /// Fields in YAML, such as "{data: true}"; missing fields keep their defaults.
    #[arg(value_name = "VALUES", default_value = "{}", allow_hyphen_values = true)]
    values: String,
    /// Read them from standard input.
    #[arg(long, conflicts_with = "values")]
    stdin: bool,
}

impl FieldArguments {
    pub(super) fn read(&self) -> anyhow::Result<String> {
        /// The maximum size of standard input.
        const MOST_BYTES: u64 = 64 << 20;
        if !self.stdin {
            return Ok(self.values.clone());
        }
        let mut text = String::new();
        std::io::stdin()
            .lock()
            .take(MOST_BYTES + 1)
            .read_to_string(&mut text)
            .context("cannot read standard input")?;
        if text.len() as u64 > MOST_BYTES {
            bail!("standard input has more than {MOST_BYTES} bytes");
        }
        Ok(text)
    }
}
