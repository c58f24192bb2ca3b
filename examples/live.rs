//! A pen that never rests: thousands of sketches on a live session, and the memory that is left of them.
//!
//! `cargo run --release --example live -- 10000` prints the share of warm starts, the median time of a call and, on Linux, the resident
//! memory along the way; it fails if that grows by more than 1 MiB between the first tenth and the end.

use sketch2pq::Error;
use sketch2pq::pipeline::{Session, SessionOptions, SurfaceOptions, sketch_to_surface};
use sketch2pq::sketch::read_sketch;
use std::path::Path;
use std::time::Instant;

/// Resident memory, bytes; `None` where the system does not say.
fn resident() -> Option<u64> {
    let status = std::fs::read_to_string("/proc/self/status").ok()?;
    let line = status.lines().find(|line| line.starts_with("VmRSS:"))?;
    Some(line.split_whitespace().nth(1)?.parse::<u64>().ok()? << 10)
}

fn main() -> Result<(), Error> {
    let calls = std::env::args().nth(1).and_then(|n| n.parse().ok()).unwrap_or(1000u32).max(20);
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("examples/sketches/rounded_corner.json");
    let sketch = read_sketch(&path)?;
    let mut session = Session::new(&SessionOptions { threads: 1, live: true, ..SessionOptions::default() })?;
    let (mut warm, mut times, mut early) = (0, vec![], None);
    for call in 0..calls {
        // One point of the first stroke goes round on a circle of two units.
        let mut drawn = sketch.clone();
        let points = &mut drawn.strokes[0].points;
        let middle = points.len() / 2;
        let angle = f64::from(call) * 0.3;
        points[middle] = [points[middle][0] + angle.cos(), points[middle][1] + angle.sin()];
        let start = Instant::now();
        let surface = sketch_to_surface(&mut session, &drawn, &SurfaceOptions::default())?;
        times.push(start.elapsed().as_secs_f64() * 1e3);
        warm += u32::from(surface.patches.iter().all(|patch| patch.diagnostics.warm_start));
        if call == calls / 10 {
            early = resident();
        }
        if (call + 1) % (calls / 10) == 0 {
            let mib = resident().map_or("unknown".into(), |bytes| format!("{:.1} MiB", bytes as f64 / 1048576.0));
            println!("{:6} calls, {warm} warm, resident {mib}", call + 1);
        }
    }
    times.sort_by(f64::total_cmp);
    println!("median {:.1} ms a call", times[times.len() / 2]);
    let grown = early.zip(resident()).map_or(0, |(early, late)| late.saturating_sub(early));
    assert!(grown < 1 << 20, "memory grew by {grown} bytes");
    Ok(())
}
