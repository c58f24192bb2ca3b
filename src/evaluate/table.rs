//! Tables of measures: JSON for machines, Markdown for people.

use super::case::{Case, KEYS};
use serde_json::{Map, Value, json};
use std::collections::BTreeMap;
use std::fmt::Write;

/// The paper's values, where it prints them (Tables 1 to 4, Sec. 5.1), in our units.
const PAPER: [(&str, f64); 7] = [
    ("d_c", 0.98e-2),
    ("d_n_deg", 7.23),
    ("d_v", 0.6e-2),
    ("d_o", 0.12e-2),
    ("p_max", 0.0169),
    ("p_mean", 0.0042),
    ("d_f_deg", 7.8),
];

/// The groups that scores are reported for: all, each family, occlusion, noise, number of depth samples.
pub fn groups(cases: &[Case]) -> BTreeMap<String, Vec<&Case>> {
    let mut groups: BTreeMap<String, Vec<&Case>> = BTreeMap::new();
    for case in cases {
        let samples = match case.samples {
            0 => "samples_0",
            1 | 2 => "samples_1_to_2",
            _ => "samples_3_and_more",
        };
        let names = [
            "all".to_owned(),
            format!("family_{}", case.family),
            if case.occluded { "occluded" } else { "not_occluded" }.to_owned(),
            if case.noisy { "noisy" } else { "clean" }.to_owned(),
            samples.to_owned(),
        ];
        for name in names {
            groups.entry(name).or_default().push(case);
        }
    }
    groups
}

/// Mean of a measure over the cases that have it; `None` if none has.
pub(super) fn average(cases: &[&Case], key: &str) -> Option<f64> {
    let values: Vec<f64> = cases.iter().filter_map(|c| c.values.get(key).copied()).collect();
    (!values.is_empty()).then(|| values.iter().sum::<f64>() / values.len() as f64)
}

fn scores(cases: &[&Case]) -> Map<String, Value> {
    let mut row = Map::new();
    row.insert("cases".into(), json!(cases.len()));
    for key in KEYS {
        row.insert(key.into(), json!(average(cases, key)));
    }
    let worst = cases.iter().filter_map(|c| c.values.get("p_max").copied()).fold(0.0, f64::max);
    row.insert("p_max_worst".into(), json!(worst));
    row.insert("failed".into(), json!(cases.iter().filter(|c| c.failed.is_some()).count()));
    row
}

/// `scores.json`: one flat object for each group, means over its cases; a measure that applies to none is null.
pub fn scores_json(cases: &[Case]) -> Value {
    Value::Object(groups(cases).into_iter().map(|(name, group)| (name, Value::Object(scores(&group)))).collect())
}

/// The same as two Markdown tables, measures down, groups across, the paper's numbers beside: all cases by occlusion, noise and
/// depth samples; then by family.
pub fn markdown(cases: &[Case]) -> String {
    let groups = groups(cases);
    let (families, others): (Vec<&String>, Vec<&String>) = groups.keys().partition(|name| name.starts_with("family_"));
    format!("{}\n{}", table(&groups, &others), table(&groups, &families))
}

fn table(groups: &BTreeMap<String, Vec<&Case>>, shown: &[&String]) -> String {
    let mut text = String::from("| measure | the paper |");
    shown.iter().for_each(|name| write!(text, " {name} |").expect("writing to a string"));
    text.push_str("\n| --- | --- |");
    text.push_str(&" --- |".repeat(shown.len()));
    let rows: Vec<Map<String, Value>> = shown.iter().map(|name| scores(&groups[*name])).collect();
    let keys = ["cases"].into_iter().chain(KEYS).chain(["p_max_worst", "failed"]);
    for key in keys {
        let paper = PAPER.iter().find(|(name, _)| *name == key).map_or("".into(), |(_, value)| number(*value));
        write!(text, "\n| {key} | {paper} |").expect("writing to a string");
        for row in &rows {
            let value = row[key].as_f64().map_or("".into(), number);
            write!(text, " {value} |").expect("writing to a string");
        }
    }
    text.push('\n');
    text
}

/// Digits that mean something.
pub(super) fn number(value: f64) -> String {
    if value == 0.0 || value.fract() == 0.0 && value.abs() < 1e6 {
        format!("{value}")
    } else if value.abs() >= 0.01 {
        format!("{value:.3}")
    } else {
        format!("{value:.1e}")
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn groups_average_what_applies() {
        let case = |d_v: f64, occluded: bool| Case {
            family: "vault",
            occluded,
            samples: 3,
            values: BTreeMap::from([("d_v", d_v)]),
            ..Case::default()
        };
        let scores = scores_json(&[case(1.0, false), case(3.0, true)]);
        assert_eq!(scores["all"]["d_v"], json!(2.0));
        assert_eq!(scores["occluded"]["d_v"], json!(3.0));
        assert_eq!(scores["all"]["d_o"], Value::Null);
        assert_eq!(scores["family_vault"]["cases"], json!(2));
    }
}
