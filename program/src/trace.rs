//! `downbeat trace`

use downbeat_robot::inspect::Client;

use super::choose::choose;
use super::cli::TraceArguments;
use super::new_output::Output;
use super::unfinished::write_file;

pub(crate) fn trace(arguments: &TraceArguments) -> anyhow::Result<()> {
    let TraceArguments { robot, cycles, output, force } = arguments;
    force.make_way(Output::File, output, [])?;
    let mut client = Client::connect(&choose(robot.as_deref())?)?;
    let trace = client.trace(*cycles)?;
    write_file(output, trace)?;
    println!("{}: open it in https://ui.perfetto.dev or chrome://tracing", output.display());
    Ok(())
}
