//! `downbeat chart`

use std::collections::{BTreeMap, BTreeSet};

use downbeat_state_machine::Chart;

use super::cli::ChartArguments;
use downbeat_edge::foreign::Declarations;
use downbeat_robot::Catalog;

pub(crate) fn chart(arguments: &ChartArguments, catalog: &Catalog) -> anyhow::Result<()> {
    let chart = Chart::read(&arguments.file)?;
    let file = arguments.file.display();
    for finding in &chart.findings {
        tracing::warn!("{file}:{finding}");
    }
    let types = Declarations::new(chart.name(), BTreeMap::new()).with_interfaces(catalog.interfaces.clone());
    match chart.unknown_names(&|name| types.definition(name)) {
        Ok(unknown) if unknown.is_empty() => {}
        Ok(unknown) => {
            let lines: Vec<String> = unknown.iter().map(|problem| format!("{file}:{problem}")).collect();
            anyhow::bail!("{}", lines.join("\n"));
        }
        // The picture needs no types.
        Err(problem) => tracing::warn!("{file}:{problem}; names in expressions are not checked"),
    }
    let active = BTreeSet::new();
    let picture = if arguments.mermaid { chart.to_mermaid(&active) } else { chart.to_dot(&active) };
    print!("{picture}");
    Ok(())
}
