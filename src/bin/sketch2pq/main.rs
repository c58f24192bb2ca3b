//! The `sketch2pq` command: `run` a sketch, `generate` training data, `evaluate` the whole pipeline, `info` on what is installed.

mod evaluate;
mod generate;
mod info;
mod run;

use clap::{Args, Parser, Subcommand};
use sketch2pq::infer::BackendChoice;
use sketch2pq::pipeline::SessionOptions;
use std::io::Write;
use std::path::PathBuf;
use std::process::ExitCode;

/// Turns an architect's sketch into a NURBS surface and a mesh of planar quads.
#[derive(Parser)]
#[command(version, about, arg_required_else_help = true)]
struct Cli {
    #[command(subcommand)]
    command: Command,
}

#[derive(Subcommand)]
enum Command {
    /// Sketch (JSON or SVG) to surface.json, mesh.obj, report.json and picture.png.
    Run(run::Run),
    Generate(generate::Arguments),
    Evaluate(evaluate::Evaluate),
    /// Versions, the backends that were found and why, the models.
    Info(info::Info),
}

/// Options of every command that loads the networks.
#[derive(Args)]
struct Runtime {
    /// What runs the networks: auto, ort (ONNX Runtime) or embedded.
    #[arg(long, default_value = "auto", value_parser = backend)]
    backend: BackendChoice,
    /// File or folder of the ONNX Runtime to use.
    #[arg(long, value_name = "PATH")]
    runtime: Option<PathBuf>,
    /// Folder of models to use instead of the built-in ones.
    #[arg(long, value_name = "DIR")]
    models: Option<PathBuf>,
    /// Threads; 0: as many as the machine has cores.
    #[arg(long, default_value_t = 0, value_name = "N")]
    threads: usize,
}

fn backend(text: &str) -> Result<BackendChoice, String> {
    text.parse().map_err(|error: sketch2pq::Error| error.to_string())
}

impl Runtime {
    fn session_options(&self) -> SessionOptions {
        SessionOptions {
            backend: self.backend,
            runtime_path: self.runtime.clone(),
            models_folder: self.models.clone(),
            threads: self.threads,
            live: false,
        }
    }
}

/// Writes to standard output; a reader that went away is no error.
fn print(text: &str) {
    let mut out = std::io::stdout().lock();
    let _ = out.write_all(text.as_bytes()).and_then(|()| out.flush());
}

fn main() -> ExitCode {
    let outcome = match Cli::parse().command {
        Command::Run(command) => command.execute(),
        Command::Generate(arguments) => generate::run(arguments).map_err(|error| error.to_string()),
        Command::Evaluate(command) => command.execute(),
        Command::Info(command) => command.execute(),
    };
    match outcome {
        Ok(()) => ExitCode::SUCCESS,
        Err(message) => {
            let _ = writeln!(std::io::stderr(), "error: {message}");
            ExitCode::from(1)
        }
    }
}
