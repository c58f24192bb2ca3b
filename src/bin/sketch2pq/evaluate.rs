//! `sketch2pq evaluate`: the metrics on held-out sketches.

use crate::{Runtime, print};
use clap::{Args, ValueEnum};
use indicatif::{ProgressBar, ProgressStyle};
use sketch2pq::Error;
use sketch2pq::control::Control;
use sketch2pq::datagen::Options;
use sketch2pq::evaluate::{
    Rank, Split, bars, bars_markdown, comparison_markdown, evaluate, markdown, scores_json, sheet, timing_markdown,
};
use sketch2pq::infer::{BackendOptions, Models, Networks};
use sketch2pq::pipeline::Session;
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// Measures the whole pipeline on held-out sketches whose truth is known: scores.json, scores.md (with what is asked and whether it is
/// met), cases.json, and pictures of the ten best, median and worst cases.
#[derive(Args)]
pub struct Evaluate {
    /// What was kept from training.
    #[arg(long, value_enum, default_value_t = Which::Surfaces)]
    split: Which,
    /// Folder for the scores; made if missing.
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
    /// Number of sketches.
    #[arg(long, default_value_t = 1000, value_name = "N")]
    count: u64,
    /// Share of sketches drawn as by hand; with 0 and 1 the same sketches clean and noisy.
    #[arg(long, default_value_t = Options::default().noise_share, value_name = "SHARE")]
    noise: f64,
    /// Lowest and highest elevation of the view, degrees.
    #[arg(long, num_args = 2, default_values_t = Options::default().elevation_deg, value_names = ["LOW", "HIGH"])]
    elevation: Vec<f64>,
    /// Folder of an earlier evaluation: the sketches that both have, measure by measure, in comparison.md.
    #[arg(long, value_name = "DIR")]
    against: Option<PathBuf>,
    /// Also the time that each stage took: timing.md. Meaningful on a quiet machine only.
    #[arg(long)]
    timing: bool,
    /// No pictures.
    #[arg(long)]
    no_pictures: bool,
    #[command(flatten)]
    runtime: Runtime,
}

#[derive(Clone, Copy, ValueEnum)]
enum Which {
    /// Surfaces that training never saw, four sketches of each.
    Surfaces,
    /// New views of surfaces that training saw in four others.
    Rotations,
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
        let others = self.against.as_deref().map(cases_of).transpose()?;
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
        let mut networks = Networks::load(&models, &backend)?;
        let split = match self.split {
            Which::Surfaces => Split::Surfaces,
            Which::Rotations => Split::Rotations,
        };
        let options = Options {
            noise_share: self.noise,
            elevation_deg: [self.elevation[0], self.elevation[1]],
            ..Options::default()
        };
        std::fs::create_dir_all(&self.out).map_err(|error| file_error(&self.out, &error))?;
        let cases = evaluate(&mut session, &mut networks, split, self.count, &options, &control)?;
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
        let mut table = format!("{}\n{}", bars_markdown(&bars(split, &cases)), markdown(&cases));
        let text = |value: &serde_json::Value| format!("{value:#}\n");
        self.write("scores.json", text(&scores_json(&cases)))?;
        self.write("cases.json", text(&serde_json::Value::Array(detail)))?;
        self.write("scores.md", &table)?;
        if self.timing {
            let timing = timing_markdown(&cases);
            self.write("timing.md", &timing)?;
            table = format!("{table}\n{timing}");
        }
        if let Some(others) = others {
            let comparison = comparison_markdown(&cases, &others);
            self.write("comparison.md", &comparison)?;
            table = format!("{table}\n{comparison}");
        }
        if !self.no_pictures {
            for (name, rank) in [("best.png", Rank::Best), ("median.png", Rank::Median), ("worst.png", Rank::Worst)] {
                self.write(name, sheet(&mut session, split, &cases, rank, &options, &control)?.to_png()?)?;
            }
        }
        bar.finish_and_clear();
        print(&table);
        Ok(())
    }

    fn write(&self, name: &str, content: impl AsRef<[u8]>) -> Result<(), Error> {
        let path = self.out.join(name);
        std::fs::write(&path, content).map_err(|error| file_error(&path, &error))
    }
}

/// The cases of an earlier evaluation.
fn cases_of(folder: &Path) -> Result<serde_json::Value, Error> {
    let path = folder.join("cases.json");
    let text = std::fs::read_to_string(&path).map_err(|error| file_error(&path, &error))?;
    serde_json::from_str(&text)
        .map_err(|error| Error::File { path: path.display().to_string(), reason: error.to_string() })
}

fn file_error(path: &Path, error: &std::io::Error) -> Error {
    Error::File { path: path.display().to_string(), reason: error.to_string() }
}
