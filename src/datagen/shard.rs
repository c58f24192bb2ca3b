//! Folders of samples: shards, their index, statistics.

use super::{Family, MAP, NET, Reason, Sample, preview, sample};
use crate::control::Control;
use crate::error::Error;
use half::f16;
use rayon::prelude::*;
use std::collections::BTreeMap;
use std::fs;
use std::ops::Range;
use std::path::{Path, PathBuf};

/// What to generate.
#[derive(Clone, Debug)]
pub struct Options {
    /// One sample for each seed.
    pub seeds: Range<u64>,
    /// Folder for the shards, created where missing.
    pub out: PathBuf,
    /// Share of each family in the mix, in the order of [`Family::ALL`]; need not sum to 1.
    pub shares: [f64; 8],
    /// Range of the view's elevation, degrees; equal ends fix it.
    pub elevation_deg: [f64; 2],
    /// Share of sketches drawn as by hand.
    pub noise_share: f64,
    /// Share of sketches that are to have occluded parts.
    pub occluded_share: f64,
    /// Seeds that share a surface id.
    pub rotations_per_surface: u64,
    /// Worker threads; 0 takes all cores.
    pub threads: usize,
    /// Samples in a shard.
    pub shard_size: u64,
    /// Where to write a contact sheet of the first samples, PNG.
    pub preview: Option<PathBuf>,
}

impl Default for Options {
    fn default() -> Self {
        Self {
            seeds: 0..1024,
            out: PathBuf::from("data"),
            shares: [0.4, 0.1, 0.08, 0.1, 0.08, 0.06, 0.1, 0.08],
            elevation_deg: [45.0, 45.0],
            noise_share: 0.3,
            occluded_share: 0.38,
            rotations_per_surface: 4,
            threads: 0,
            shard_size: 1024,
            preview: None,
        }
    }
}

/// What came out of one shard.
#[derive(Clone, Debug, Default, PartialEq)]
struct Statistics {
    seeds: [u64; 2],
    samples: u64,
    failed: u64,
    occluded: u64,
    noisy: u64,
    families: BTreeMap<&'static str, u64>,
    rejected: BTreeMap<&'static str, u64>,
    conjugacy: f64,
    depth_span: f64,
}

fn file_error(path: &Path, error: impl std::fmt::Display) -> Error {
    Error::File { path: path.display().to_string(), reason: error.to_string() }
}

/// Writes all samples of the seeds to `options.out`, shard by shard.
///
/// Shard k, folder `shard_0000k`, holds the seeds from k `shard_size` on; finished shards are kept as they are, so that a run
/// that was stopped goes on where it ended. `index.json` lists the finished ones, `stats.json` adds up what they are made
/// of and what was refused. A shard of N samples has these NumPy arrays (maps of 64 x 64, row 0 at the top, layers visible
/// and occluded):
///
/// | file | type, shape | content |
/// | --- | --- | --- |
/// | `strokes.npy` | u8, N 10 64 64 | the channels of [`crate::sketch::rasterize`]: 255 x; the last two 127 x + 128 |
/// | `valid.npy` | u8, N 2 64 64 | 0 none, 1 front, 2 back, see [`super::Maps`] |
/// | `depth.npy` | f16, N 2 64 64 | offset from the horizontal reference, mean 0 over the visible pixels |
/// | `normal.npy` | i8, N 2 3 64 64 | 127 times the outward normal in the canonical frame |
/// | `cdf.npy` | i8, N 2 4 64 64 | 127 times the conjugate directions ux, uy, vx, vy on the canvas, y up |
/// | `control.npy` | f32, N 30 30 3 | control points (x, y, h), u is the row; h as in `depth.npy` |
///
/// and one line of JSON for each sample in `meta.jsonl`: `seed`, `surface` (shared by seeds that may show the same surface:
/// split by it), `family`, `azimuth`, `elevation`, `occluded`, `noisy`, `scale`, `conjugacy`. About 130 kB a sample.
///
/// # Errors
/// [`Error::File`] if the folder cannot be written, [`Error::Argument`] for an empty range, [`Error::Cancelled`].
pub fn generate(options: &Options, control: &Control) -> Result<(), Error> {
    if options.seeds.is_empty() || options.shard_size == 0 {
        let value = format!("{:?} in shards of {}", options.seeds, options.shard_size);
        return Err(Error::Argument { name: "seeds", value, expected: "a range that is not empty" });
    }
    let pool = rayon::ThreadPoolBuilder::new().num_threads(options.threads).build().map_err(|e| Error::Argument {
        name: "threads",
        value: e.to_string(),
        expected: "a number of threads",
    })?;
    fs::create_dir_all(&options.out).map_err(|e| file_error(&options.out, e))?;
    if let Some(path) = &options.preview {
        let seeds: Vec<u64> = options.seeds.clone().take(20).collect();
        let samples: Vec<Sample> =
            pool.install(|| seeds.par_iter().filter_map(|&seed| sample(seed, options).ok()).collect());
        preview::write_sheet(path, &samples)?;
    }
    // Shards lie at multiples of their size, so that runs over other ranges of seeds fit together.
    let numbers = options.seeds.start / options.shard_size..options.seeds.end.div_ceil(options.shard_size);
    let count = (numbers.end - numbers.start) as f64;
    for number in numbers.clone() {
        let done = (number - numbers.start) as f64 / count;
        control.step("generate", done)?;
        let start = number * options.shard_size;
        let seeds = start.max(options.seeds.start)..(start + options.shard_size).min(options.seeds.end);
        let folder = options.out.join(format!("shard_{number:05}"));
        if !holds(&folder, &seeds) {
            write_shard(&pool, options, control, seeds, &folder, done, 1.0 / count)?;
        }
        write_index(&options.out)?;
    }
    control.step("generate", 1.0)
}

/// Whether the folder is a finished shard of these seeds.
fn holds(folder: &Path, seeds: &Range<u64>) -> bool {
    let Ok(text) = fs::read_to_string(folder.join("stats.json")) else { return false };
    let Ok(stats) = serde_json::from_str::<serde_json::Value>(&text) else { return false };
    stats["seeds"][0].as_u64() == Some(seeds.start) && stats["seeds"][1].as_u64() == Some(seeds.end)
}

/// Replaces `path` in one step, so that no reader sees half a file.
fn write_file(path: &Path, bytes: &[u8]) -> Result<(), Error> {
    let temporary = path.with_extension("part");
    fs::write(&temporary, bytes).and_then(|()| fs::rename(&temporary, path)).map_err(|e| file_error(path, e))
}

/// Lists the finished shards and adds up their statistics.
fn write_index(out: &Path) -> Result<(), Error> {
    let mut names: Vec<String> = fs::read_dir(out)
        .map_err(|e| file_error(out, e))?
        .filter_map(|entry| entry.ok()?.file_name().into_string().ok())
        .filter(|name| name.starts_with("shard_") && !name.ends_with(".part"))
        .collect();
    names.sort();
    let mut list = vec![];
    let mut total = serde_json::Map::new();
    for name in names {
        let path = out.join(&name).join("stats.json");
        let Ok(text) = fs::read_to_string(&path) else { continue };
        let stats: serde_json::Value = serde_json::from_str(&text).map_err(|e| file_error(&path, e))?;
        list.push(serde_json::json!({"name": name, "samples": stats["samples"]}));
        add_statistics(&mut total, &stats);
    }
    let pretty = |value: &serde_json::Value| serde_json::to_string_pretty(value).unwrap_or_default();
    write_file(&out.join("stats.json"), pretty(&serde_json::Value::Object(total)).as_bytes())?;
    write_file(&out.join("index.json"), pretty(&serde_json::json!({"shards": list})).as_bytes())
}

/// Adds the numbers of `stats` to `total`, key by key; numbers of nested objects too.
fn add_statistics(total: &mut serde_json::Map<String, serde_json::Value>, stats: &serde_json::Value) {
    for (key, value) in stats.as_object().into_iter().flatten() {
        match value {
            serde_json::Value::Object(_) => {
                let entry = total.entry(key.clone()).or_insert_with(|| serde_json::json!({}));
                if let Some(entry) = entry.as_object_mut() {
                    add_statistics(entry, value);
                }
            }
            number if number.is_number() => {
                let entry = total.entry(key.clone()).or_insert_with(|| serde_json::json!(0));
                *entry = match (entry.as_u64(), number.as_u64()) {
                    (Some(a), Some(b)) => serde_json::json!(a + b),
                    _ => serde_json::json!(entry.as_f64().unwrap_or(0.0) + number.as_f64().unwrap_or(0.0)),
                };
            }
            _ => {}
        }
    }
}

fn write_shard(
    pool: &rayon::ThreadPool,
    options: &Options,
    control: &Control,
    seeds: Range<u64>,
    folder: &Path,
    done: f64,
    share: f64,
) -> Result<(), Error> {
    let mut statistics = Statistics { seeds: [seeds.start, seeds.end], ..Statistics::default() };
    let all: Vec<u64> = seeds.collect();
    let mut samples = Vec::with_capacity(all.len());
    for (k, chunk) in all.chunks(64).enumerate() {
        control.step("generate", done + share * (k * 64) as f64 / all.len() as f64)?;
        let made: Vec<_> = pool.install(|| chunk.par_iter().map(|&seed| sample(seed, options)).collect());
        for result in made {
            match result {
                Ok(sample) => samples.push(sample),
                Err(_) => statistics.failed += 1,
            }
        }
    }
    let temporary = folder.with_extension("part");
    if temporary.exists() {
        fs::remove_dir_all(&temporary).map_err(|e| file_error(&temporary, e))?;
    }
    fs::create_dir_all(&temporary).map_err(|e| file_error(&temporary, e))?;
    let count = samples.len();
    let array = |name: &str, kind: &str, shape: &[usize], bytes: Vec<u8>| {
        let path = temporary.join(name);
        let mut shape_with_count = vec![count];
        shape_with_count.extend_from_slice(shape);
        fs::write(&path, npy(kind, &shape_with_count, &bytes)).map_err(|e| file_error(&path, e))
    };
    let gather = |f: &dyn Fn(&Sample, &mut Vec<u8>)| {
        let mut bytes = vec![];
        samples.iter().for_each(|s| f(s, &mut bytes));
        bytes
    };
    let signed = |x: f32| (127.0 * x).round().clamp(-127.0, 127.0) as i8;
    array(
        "strokes.npy",
        "|u1",
        &[10, MAP, MAP],
        gather(&|s, out| {
            let (plain, directed) = s.raster.data.split_at(8 * MAP * MAP);
            out.extend(plain.iter().map(|x| (255.0 * x).round().clamp(0.0, 255.0) as u8));
            out.extend(directed.iter().map(|&x| (i16::from(signed(x)) + 128) as u8));
        }),
    )?;
    array("valid.npy", "|u1", &[2, MAP, MAP], gather(&|s, out| out.extend(&s.maps.valid)))?;
    array(
        "depth.npy",
        "<f2",
        &[2, MAP, MAP],
        gather(&|s, out| {
            out.extend(s.maps.depth.iter().flat_map(|&h| f16::from_f32(h).to_le_bytes()));
        }),
    )?;
    array(
        "normal.npy",
        "|i1",
        &[2, 3, MAP, MAP],
        gather(&|s, out| {
            out.extend(s.maps.normal.iter().map(|&x| signed(x) as u8));
        }),
    )?;
    array(
        "cdf.npy",
        "|i1",
        &[2, 4, MAP, MAP],
        gather(&|s, out| {
            out.extend(s.maps.directions.iter().map(|&x| signed(x) as u8));
        }),
    )?;
    array(
        "control.npy",
        "<f4",
        &[NET, NET, 3],
        gather(&|s, out| {
            let cotangent = 1.0 / s.elevation_deg.to_radians().tan();
            for p in s.surface.control_points() {
                for x in [p.x, p.y, -p.z - p.y * cotangent] {
                    out.extend((x as f32).to_le_bytes());
                }
            }
        }),
    )?;
    let mut lines = String::new();
    for s in &samples {
        let line = serde_json::json!({
            "seed": s.seed, "surface": s.surface_id, "family": s.family.name(),
            "azimuth": s.azimuth_deg, "elevation": s.elevation_deg,
            "occluded": s.occluded, "noisy": s.noisy, "scale": s.scale, "conjugacy": s.maps.conjugacy,
        });
        lines.push_str(&line.to_string());
        lines.push('\n');
        statistics.add(s);
    }
    let path = temporary.join("meta.jsonl");
    fs::write(&path, lines).map_err(|e| file_error(&path, e))?;
    let path = temporary.join("stats.json");
    fs::write(&path, statistics.to_json().to_string()).map_err(|e| file_error(&path, e))?;
    if folder.exists() {
        fs::remove_dir_all(folder).map_err(|e| file_error(folder, e))?;
    }
    fs::rename(&temporary, folder).map_err(|e| file_error(folder, e))
}

impl Statistics {
    fn add(&mut self, sample: &Sample) {
        self.samples += 1;
        self.occluded += u64::from(sample.occluded);
        self.noisy += u64::from(sample.noisy);
        *self.families.entry(sample.family.name()).or_default() += 1;
        for (reason, &count) in Reason::ALL.iter().zip(&sample.rejected) {
            *self.rejected.entry(reason.name()).or_default() += u64::from(count);
        }
        self.conjugacy += sample.maps.conjugacy;
        let (low, high) = sample.maps.depth.iter().fold((f32::MAX, f32::MIN), |(l, h), &x| (l.min(x), h.max(x)));
        self.depth_span += f64::from(high - low);
    }

    fn to_json(&self) -> serde_json::Value {
        serde_json::json!({
            "seeds": self.seeds, "samples": self.samples, "failed": self.failed, "occluded": self.occluded, "noisy": self.noisy,
            "families": self.families, "rejected": self.rejected,
            "conjugacy_sum": self.conjugacy, "depth_span_sum": self.depth_span,
        })
    }
}

/// A NumPy file, version 1.0, C order.
fn npy(kind: &str, shape: &[usize], data: &[u8]) -> Vec<u8> {
    let shape = shape.iter().map(|n| format!("{n}, ")).collect::<String>();
    let mut header = format!("{{'descr': '{kind}', 'fortran_order': False, 'shape': ({}), }}", shape.trim_end());
    // Magic, version, length and header together fill a multiple of 64 bytes.
    while (10 + header.len() + 1) % 64 != 0 {
        header.push(' ');
    }
    header.push('\n');
    let mut bytes = b"\x93NUMPY\x01\x00".to_vec();
    bytes.extend((header.len() as u16).to_le_bytes());
    bytes.extend(header.as_bytes());
    bytes.extend(data);
    bytes
}

/// Parses shares such as `freeform=0.5,vault=0.2`; families that are not named get 0.
///
/// # Errors
/// [`Error::Argument`] for an unknown family or a share that is not a positive number.
pub fn parse_shares(text: &str) -> Result<[f64; 8], Error> {
    let mut shares = [0.0; 8];
    for item in text.split(',') {
        let fail = || Error::Argument {
            name: "shares",
            value: item.to_string(),
            expected: "family=share with a known family and a share >= 0",
        };
        let (name, share) = item.split_once('=').ok_or_else(fail)?;
        let index = Family::ALL.iter().position(|f| f.name() == name.trim()).ok_or_else(fail)?;
        let share: f64 = share.trim().parse().map_err(|_| fail())?;
        if !(share.is_finite() && share >= 0.0) {
            return Err(fail());
        }
        shares[index] = share;
    }
    if shares.iter().sum::<f64>() > 0.0 {
        Ok(shares)
    } else {
        Err(Error::Argument { name: "shares", value: text.to_string(), expected: "at least one share above 0" })
    }
}
