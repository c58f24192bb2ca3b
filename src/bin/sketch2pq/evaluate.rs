//! `sketch2pq evaluate`: the metrics on held-out sketches.

use crate::{Runtime, print};
use clap::Args;
use indicatif::{ProgressBar, ProgressStyle};
use sketch2pq::Error;
use sketch2pq::control::Control;
use sketch2pq::datagen::Options;
use sketch2pq::evaluate::{evaluate, markdown, scores_json};
use sketch2pq::infer::{BackendOptions, Models};
use sketch2pq::pipeline::Session;
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// Measures the whole pipeline on held-out sketches whose truth is known: scores.json, scores.md, cases.json.
#[derive(Args)]
pub struct Evaluate {
    /// The held-out set: surfaces that training never saw.
    #[arg(long, default_value = "surfaces", value_parser = ["surfaces"])]
    split: String,
    /// Folder for the scores; made if missing.
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
    /// Number of sketches.
    #[arg(long, default_value_t = 500, value_name = "N")]
    count: u64,
    #[command(flatten)]
    runtime: Runtime,
}

impl Evaluate {
    /// Runs the command.
    ///
    /// # Errors
    /// A message for the user.
    pub fn execute(self) -> Result<(), String> {
        self.measure().map_err(|error| error.to_string())
    }

    fn measure(&self) -> Result<(), Error> {
        let session_options = self.runtime.session_options();
        let models = match &session_options.models_folder {
            Some(folder) => Models::from_folder(folder)?,
            None => Models::embedded()?,
        };
        let backend = BackendOptions {
            choice: session_options.backend,
            runtime_path: session_options.runtime_path.clone(),
            threads: session_options.threads,
        };
        let mut session = Session::new(&session_options)?;
        let bar = ProgressBar::new(self.count);
        if let Ok(style) = ProgressStyle::with_template("{msg} {wide_bar} {pos}/{len} {elapsed} eta {eta}") {
            bar.set_style(style);
        }
        let (shown, count) = (bar.clone(), self.count as f64);
        let control = Control::with_progress(Arc::new(move |stage: &str, fraction: f64| {
            shown.set_message(stage.to_owned());
            shown.set_position((fraction * count).round() as u64);
        }));
        let cases = evaluate(&mut session, &models, &backend, self.count, &Options::default(), &control)?;
        bar.finish_and_clear();
        let detail: Vec<serde_json::Value> = cases
            .iter()
            .map(|case| {
                let mut value = serde_json::json!({
                    "seed": case.seed, "family": case.family, "occluded": case.occluded, "noisy": case.noisy,
                    "samples": case.samples, "failed": case.failed,
                });
                for (key, measure) in &case.values {
                    value[*key] = serde_json::json!(measure);
                }
                value
            })
            .collect();
        let table = markdown(&cases);
        let text = |value: &serde_json::Value| format!("{value:#}\n");
        std::fs::create_dir_all(&self.out).map_err(|error| file_error(&self.out, &error))?;
        self.write("scores.json", &text(&scores_json(&cases)))?;
        self.write("cases.json", &text(&serde_json::Value::Array(detail)))?;
        self.write("scores.md", &table)?;
        print(&table);
        Ok(())
    }

    fn write(&self, name: &str, text: &str) -> Result<(), Error> {
        let path = self.out.join(name);
        std::fs::write(&path, text).map_err(|error| file_error(&path, &error))
    }
}

fn file_error(path: &Path, error: &std::io::Error) -> Error {
    Error::File { path: path.display().to_string(), reason: error.to_string() }
}
