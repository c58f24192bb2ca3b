//! `sketch2pq generate`: training data from seeds.

use clap::Args;
use indicatif::{ProgressBar, ProgressStyle};
use sketch2pq::Error;
use sketch2pq::control::Control;
use sketch2pq::datagen::{Options, generate, parse_shares};
use std::path::PathBuf;
use std::sync::Arc;

/// Makes random surfaces, their sketches and ground truth maps, in shards of NumPy arrays.
#[derive(Args)]
pub struct Arguments {
    /// Seeds, first..end; one sample each.
    #[arg(long, default_value = "0..1024")]
    seeds: String,
    /// Folder for the shards; finished ones are kept.
    #[arg(long)]
    out: PathBuf,
    /// Contact sheet of the first 20 samples, PNG.
    #[arg(long)]
    preview: Option<PathBuf>,
    /// Share of each family, as freeform=0.5,vault=0.5.
    #[arg(long)]
    shares: Option<String>,
    /// Lowest and highest elevation of the view, degrees.
    #[arg(long, num_args = 2, default_values_t = [45.0, 45.0])]
    elevation: Vec<f64>,
    /// Share of sketches drawn as by hand.
    #[arg(long, default_value_t = Options::default().noise_share)]
    noise: f64,
    /// Share of sketches with occluded parts.
    #[arg(long, default_value_t = Options::default().occluded_share)]
    occluded: f64,
    /// Sketches of each surface.
    #[arg(long, default_value_t = Options::default().rotations_per_surface)]
    rotations: u64,
    /// Samples in each shard.
    #[arg(long, default_value_t = Options::default().shard_size)]
    shard_size: u64,
    /// Threads; 0 takes all cores.
    #[arg(long, default_value_t = 0)]
    threads: usize,
}

/// Runs the command.
///
/// # Errors
/// Those of [`generate`], and [`Error::Argument`] for what cannot be parsed.
pub fn run(arguments: Arguments) -> Result<(), Error> {
    let bad = || Error::Argument { name: "seeds", value: arguments.seeds.clone(), expected: "first..end" };
    let (first, end) = arguments.seeds.split_once("..").ok_or_else(bad)?;
    let seeds = first.parse().map_err(|_| bad())?..end.parse().map_err(|_| bad())?;
    let mut options = Options {
        seeds,
        out: arguments.out,
        preview: arguments.preview,
        elevation_deg: [arguments.elevation[0], arguments.elevation[1]],
        noise_share: arguments.noise,
        occluded_share: arguments.occluded,
        rotations_per_surface: arguments.rotations,
        shard_size: arguments.shard_size,
        threads: arguments.threads,
        ..Options::default()
    };
    if let Some(text) = &arguments.shares {
        options.shares = parse_shares(text)?;
    }
    let bar = ProgressBar::new(1000);
    if let Ok(style) = ProgressStyle::with_template("{msg} {wide_bar} {percent}% {elapsed} eta {eta}") {
        bar.set_style(style);
    }
    let shown = bar.clone();
    let control = Control::with_progress(Arc::new(move |stage: &str, fraction: f64| {
        shown.set_message(stage.to_string());
        shown.set_position((fraction * 1000.0) as u64);
    }));
    generate(&options, &control)?;
    bar.finish();
    Ok(())
}
