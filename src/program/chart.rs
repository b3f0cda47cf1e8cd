//! `downbeat chart`

use std::collections::BTreeSet;

use downbeat_state_machine::Chart;

use super::cli::ChartArguments;

pub(crate) fn chart(arguments: &ChartArguments) -> anyhow::Result<()> {
    let chart = Chart::read(&arguments.file)?;
    for finding in &chart.findings {
        tracing::warn!("{}:{finding}", arguments.file.display());
    }
    let active = BTreeSet::new();
    let picture = if arguments.mermaid { chart.to_mermaid(&active) } else { chart.to_dot(&active) };
    print!("{picture}");
    Ok(())
}
