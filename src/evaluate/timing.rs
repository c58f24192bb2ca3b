//! How long the stages took.

use super::case::Case;
use std::fmt::Write;

/// Median, 95th percentile and maximum of the wall time of each stage, in milliseconds, as a Markdown table.
///
/// Kept apart from the scores, which are the same whenever they are measured.
pub fn timing_markdown(cases: &[Case]) -> String {
    let times: Vec<_> = cases.iter().filter_map(|case| case.times).collect();
    let stages: [(&str, Vec<f64>); 7] = [
        ("sketch", times.iter().map(|t| t.sketch).collect()),
        ("infer", times.iter().map(|t| t.infer).collect()),
        ("refine", times.iter().map(|t| t.refine).collect()),
        ("field", times.iter().map(|t| t.field).collect()),
        ("mesh", times.iter().map(|t| t.mesh).collect()),
        ("planarize", times.iter().map(|t| t.planarize).collect()),
        ("total", times.iter().map(|t| t.total()).collect()),
    ];
    let mut text = String::from("| stage, ms | median | 95th percentile | most |\n| --- | --- | --- | --- |\n");
    for (name, mut values) in stages {
        values.sort_by(f64::total_cmp);
        let at = |share: f64| values.get(((values.len() as f64 * share) as usize).min(values.len().saturating_sub(1)));
        let Some((median, (tail, most))) = at(0.5).zip(at(0.95).zip(at(1.0))) else { continue };
        writeln!(text, "| {name} | {median:.1} | {tail:.1} | {most:.1} |").expect("writing to a string");
    }
    text
}
