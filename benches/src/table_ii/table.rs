//! Formats the results as a table.

use std::fmt::Write as _;
use std::time::Duration;

use super::{CellResult, Goal, Published, Row, published};
use crate::launchers::LINEAR;

/// All cells, with downbeat under each launcher next to the other contestants, then the goals.
#[must_use]
pub fn table(results: &[CellResult], goals: &[Goal]) -> String {
    let mut text = String::new();
    line(
        &mut text,
        ["modules", "messages", "what", "ms", "ns/delivery", "to limit", "to queues", "to published"],
    );
    for result in results {
        text.push('\n');
        for row in result.rows() {
            line(&mut text, ours(&row, result).each_ref().map(String::as_str));
        }
        for (name, time) in [
            ("limit", result.limit),
            ("limit, two threads", result.limit_on_two_threads),
            ("queues, SegQueue", result.lock_free_queues),
            ("queues, Mutex", result.locked_queues),
        ] {
            let columns = other(result, name, time);
            line(&mut text, columns.each_ref().map(String::as_str));
        }
        if let Some(figure) = published(result.load) {
            let columns = other(result, "published", figure.bound());
            let mut columns = columns.each_ref().map(String::as_str);
            if matches!(figure, Published::TookLessThan(_)) {
                columns[2] = "published, less than";
            }
            line(&mut text, columns);
        }
    }
    text.push('\n');
    for Goal { claim, measured, is_reached } in goals {
        let verdict = match (measured, is_reached) {
            (None, _) => "not measured",
            (Some(_), true) => "reached",
            (Some(_), false) => "NOT reached",
        };
        // Writing to a string does not fail.
        let _ = writeln!(text, "{verdict:>12}  {:>9}  {claim}", measured.as_deref().unwrap_or("-"));
    }
    for load in results.iter().filter(|result| is_too_noisy(result)).map(|result| result.load) {
        let _ = writeln!(
            text,
            "Ignore the ratios of {} x {}: one thread was faster than the limit, so the machine was too busy.",
            load.modules, load.messages
        );
    }
    text
}

/// One thread has at least the work of the limit, so a time well below the limit shows that the machine was
/// too busy.
fn is_too_noisy(result: &CellResult) -> bool {
    result.rows().any(|row| row.launcher == LINEAR && row.ratio_to_limit < 0.9)
}

fn line(text: &mut String, columns: [&str; 8]) {
    let [modules, messages, what, ms, ns, limit, queues, published] = columns;
    let _ = writeln!(
        text,
        "{modules:>7} {messages:>8}  {what:<20} {ms:>11} {ns:>11} {limit:>9} {queues:>10} {published:>13}"
    );
}

fn ours(row: &Row, result: &CellResult) -> [String; 8] {
    let is_bound = matches!(published(result.load), Some(Published::TookLessThan(_)));
    let bound = if is_bound { "< " } else { "" };
    [
        row.modules.to_string(),
        row.messages.to_string(),
        row.launcher.to_string(),
        format!("{:.4}", row.ms),
        format!("{:.2}", row.ns_per_delivery),
        format!("{:.2}", row.ratio_to_limit),
        format!("{:.1}", row.ratio_to_queue_design),
        row.ratio_to_published.map_or("-".into(), |ratio| format!("{bound}{ratio:.1}")),
    ]
}

fn other(result: &CellResult, name: &str, time: Duration) -> [String; 8] {
    let ns = time.as_secs_f64() * 1e9 / result.load.deliveries() as f64;
    let none = String::new;
    let ms = format!("{:.4}", time.as_secs_f64() * 1e3);
    [none(), none(), name.into(), ms, format!("{ns:.2}"), none(), none(), none()]
}
