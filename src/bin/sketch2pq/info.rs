//! `sketch2pq info`: what is installed.

use crate::{Runtime, print};
use clap::Args;
use sketch2pq::infer::{Backend, BackendChoice, BackendOptions, Models, Network};
use std::fmt::Write as _;

#[derive(Args)]
pub struct Info {
    #[command(flatten)]
    runtime: Runtime,
}

impl Info {
    /// Prints versions, backends and models.
    pub fn execute(&self) -> Result<(), String> {
        let mut text = String::new();
        let mut line = |label: &str, value: String| {
            let _ = writeln!(text, "{label:11}{value}");
        };
        line("sketch2pq", env!("CARGO_PKG_VERSION").into());
        line("ABI", sketch2pq::ffi::s2pq_abi_version().to_string());
        let options = |choice| BackendOptions {
            choice,
            runtime_path: self.runtime.runtime.clone(),
            threads: self.runtime.threads,
        };
        let open = |choice| Backend::open(&options(choice));
        let chosen = open(self.runtime.backend).map_err(|e| e.to_string())?;
        line("backend", format!("{}, {} threads", chosen.info(), chosen.info().threads));
        line("why", chosen.info().why.clone());
        for choice in [BackendChoice::Ort, BackendChoice::Embedded] {
            let state = open(choice).map_or_else(|error| error.to_string(), |backend| backend.info().to_string());
            line(choice.name(), state);
        }
        let models = match &self.runtime.models {
            Some(folder) => Models::from_folder(folder),
            None => Models::embedded(),
        };
        let models = models.map_err(|e| e.to_string())?;
        line("models", models.origin().into());
        for network in Network::ALL {
            let entry = models.entry(network);
            let millions = entry.parameters as f64 / 1e6;
            let (seen, commit) = (entry.training.samples_seen, &entry.training.commit);
            let training = if seen == 0 { "untrained".into() } else { format!("{seen} samples seen, commit {commit}") };
            line(network.name(), format!("{millions:.1} M parameters, {training}"));
        }
        print(&text);
        Ok(())
    }
}
