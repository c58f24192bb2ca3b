//! Two evaluations beside each other, sketch by sketch.

use super::case::{Case, KEYS};
use super::table::number;
use serde_json::Value;
use std::collections::BTreeMap;
use std::fmt::Write;

/// A Markdown table of the measures of the sketches that both evaluations have, by seed: their mean in the other and in this one,
/// how many times the other's this one's is, and in how many sketches it is lower.
///
/// `others` is what `cases.json` holds. With other weights it says what they bring; with `--noise 0` and `--noise 1`, where a seed
/// differs in the hand that draws alone, what that hand costs.
pub fn comparison_markdown(cases: &[Case], others: &Value) -> String {
    let others: BTreeMap<u64, &Value> =
        others.as_array().into_iter().flatten().filter_map(|case| Some((case["seed"].as_u64()?, case))).collect();
    let mut text =
        String::from("| measure | sketches | other | this | ratio | lower |\n| --- | --- | --- | --- | --- | --- |\n");
    for key in KEYS {
        let pairs: Vec<[f64; 2]> = cases
            .iter()
            .filter_map(|case| Some([others.get(&case.seed)?[key].as_f64()?, *case.values.get(key)?]))
            .collect();
        if pairs.is_empty() {
            continue;
        }
        let mean = |which: usize| pairs.iter().map(|pair| pair[which]).sum::<f64>() / pairs.len() as f64;
        let (other, this) = (mean(0), mean(1));
        let lower = pairs.iter().filter(|pair| pair[1] < pair[0]).count();
        let ratio = if other == 0.0 { String::new() } else { number(this / other) };
        writeln!(text, "| {key} | {} | {} | {} | {ratio} | {lower} |", pairs.len(), number(other), number(this))
            .expect("writing to a string");
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    #[test]
    fn sketches_are_matched_by_seed() {
        let case = |seed, d_c| Case { seed, values: BTreeMap::from([("d_c", d_c)]), ..Case::default() };
        let others = json!([{"seed": 2, "d_c": 4.0, "d_v": 1.0}, {"seed": 1, "d_c": 2.0}, {"seed": 9, "d_c": 100.0}]);
        let table = comparison_markdown(&[case(1, 3.0), case(2, 2.0), case(3, 50.0)], &others);
        assert!(table.contains("| d_c | 2 | 3 | 2.500 | 0.833 | 1 |"), "{table}");
        assert!(!table.contains("d_v"), "{table}");
    }
}
