//! `sketch2pq info`: what is installed.

use crate::{Runtime, print};
use clap::Args;
use sketch2pq::pipeline::Session;
use std::fmt::Write as _;

#[derive(Args)]
pub struct Info {
    #[command(flatten)]
    runtime: Runtime,
}

impl Info {
    pub fn execute(&self) -> Result<(), String> {
        let mut text = String::new();
        let mut line = |label: &str, value: String| {
            let _ = writeln!(text, "{label:11}{value}");
        };
        line("sketch2pq", env!("CARGO_PKG_VERSION").into());
        line("ABI", sketch2pq::ffi::s2pq_abi_version().to_string());
        let session = Session::new(&self.runtime.session_options()).map_err(|e| e.to_string())?;
        let backend = session.backend();
        line("backend", backend.to_string());
        line("why", backend.why.clone());
        line("threads", session.threads().to_string());
        print(&text);
        Ok(())
    }
}
