//! The networks' files: a manifest, hashes, and what the code expects of each.

use super::backend::{Backend, Engine};
use crate::error::Error;
use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};
use std::borrow::Cow;
use std::collections::BTreeMap;
use std::fmt::Write;
use std::path::Path;

/// Version of the manifest's form.
pub const MANIFEST_FORMAT: u32 = 1;

/// Name of the manifest in a folder of models.
const MANIFEST_FILE: &str = "manifest.json";

/// Largest file that is read; ours together take a tenth of it.
const LARGEST_FILE: u64 = 256 << 20;

/// The four networks (paper, Sec. 3.2).
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub enum Network {
    /// Depth and normals of the visible layer.
    Vd,
    /// Depth and normals of the occluded layer.
    Od,
    /// Control net of the surface.
    Bsr,
    /// Conjugate directions of both layers.
    Cdf,
}

impl Network {
    /// All of them, in the order of the pipeline.
    pub const ALL: [Self; 4] = [Self::Vd, Self::Od, Self::Bsr, Self::Cdf];

    /// Key in the manifest, and the file's name without extension.
    pub fn name(self) -> &'static str {
        match self {
            Self::Vd => "vd_net",
            Self::Od => "od_net",
            Self::Bsr => "bsr_net",
            Self::Cdf => "cdf_net",
        }
    }

    /// Shape of the input, NCHW.
    pub fn input_shape(self) -> [usize; 4] {
        match self {
            Self::Vd => [1, 15, 64, 64],
            Self::Od => [1, 17, 64, 64],
            Self::Cdf => [1, 16, 64, 64],
            Self::Bsr => [1, 17, 30, 30],
        }
    }

    /// Shape of the output, NCHW.
    pub fn output_shape(self) -> [usize; 4] {
        match self {
            Self::Vd | Self::Od | Self::Cdf => [1, 8, 64, 64],
            Self::Bsr => [1, 3, 30, 30],
        }
    }
}

/// What `manifest.json` says.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Manifest {
    /// [`MANIFEST_FORMAT`].
    pub format: u32,
    /// By [`Network::name`].
    pub models: BTreeMap<String, ModelEntry>,
}

/// One network in the manifest.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ModelEntry {
    /// File in the manifest's folder.
    pub file: String,
    /// SHA-256 of the file, lower-case hexadecimal.
    pub sha256: String,
    /// Number of weights.
    pub parameters: u64,
    /// The only input.
    pub input: TensorEntry,
    /// The only output.
    pub output: TensorEntry,
    /// Where the weights come from.
    pub training: TrainingEntry,
}

/// A tensor in the manifest.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct TensorEntry {
    /// Name in the ONNX file.
    pub name: String,
    /// Shape, NCHW.
    pub shape: Vec<usize>,
    /// Channels with their units, in words.
    pub units: String,
}

/// The origin of a network's weights.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct TrainingEntry {
    /// Commit of the training program.
    pub commit: String,
    /// Sketches shown in training, with repetition; 0 for weights that were never trained.
    pub samples_seen: u64,
    /// Scores on held-out sketches, by name.
    pub scores: BTreeMap<String, f64>,
}

/// The files of the four networks, checked against their manifest.
#[derive(Clone)]
pub struct Models {
    manifest: Manifest,
    files: [Cow<'static, [u8]>; 4],
    origin: String,
}

macro_rules! embedded_file {
    ($name:literal) => {
        include_bytes!(concat!(env!("CARGO_MANIFEST_DIR"), "/models/", $name))
    };
}

impl Models {
    /// The networks inside the library.
    ///
    /// # Errors
    /// [`Error::Model`] if the build embedded files that their manifest does not describe.
    pub fn embedded() -> Result<Self, Error> {
        let files: [&'static [u8]; 4] = [
            embedded_file!("vd_net.onnx"),
            embedded_file!("od_net.onnx"),
            embedded_file!("bsr_net.onnx"),
            embedded_file!("cdf_net.onnx"),
        ];
        Self::checked("embedded".into(), embedded_file!("manifest.json"), |network, _| {
            Ok(Cow::Borrowed(files[network as usize]))
        })
    }

    /// The networks in `folder`, which holds a manifest and the files that it names.
    ///
    /// # Errors
    /// [`Error::File`] if the manifest cannot be read, [`Error::Format`] if it has another form,
    /// [`Error::Model`] if a network is missing, damaged or of another shape than this version of the library reads.
    pub fn from_folder(folder: &Path) -> Result<Self, Error> {
        let path = folder.join(MANIFEST_FILE);
        let manifest = read(&path).map_err(|reason| Error::File { path: path.display().to_string(), reason })?;
        Self::checked(folder.display().to_string(), &manifest, |network, file| {
            // A manifest from elsewhere must not reach out of its folder.
            if Path::new(file).file_name() != Some(file.as_ref()) {
                return Err(wrong(network, format!("its file {file:?} is not a plain name")));
            }
            read(&folder.join(file)).map(Cow::Owned).map_err(|reason| wrong(network, format!("{file}: {reason}")))
        })
    }

    fn checked(
        origin: String,
        manifest: &[u8],
        file: impl Fn(Network, &str) -> Result<Cow<'static, [u8]>, Error>,
    ) -> Result<Self, Error> {
        let format = |reason: String| Error::Format { what: "model manifest", reason };
        let manifest: Manifest = serde_json::from_slice(manifest).map_err(|error| format(error.to_string()))?;
        if manifest.format != MANIFEST_FORMAT {
            return Err(format(format!("it has format {}, expected {MANIFEST_FORMAT}", manifest.format)));
        }
        let mut files = [const { Cow::Borrowed(&[] as &[u8]) }; 4];
        for network in Network::ALL {
            let entry =
                manifest.models.get(network.name()).ok_or_else(|| wrong(network, "the manifest lacks it".into()))?;
            for (what, tensor, expected) in
                [("input", &entry.input, network.input_shape()), ("output", &entry.output, network.output_shape())]
            {
                if tensor.shape != expected {
                    return Err(wrong(
                        network,
                        format!("its {what} has shape {:?}, expected {expected:?}", tensor.shape),
                    ));
                }
            }
            let bytes = file(network, &entry.file)?;
            let sha256 = hexadecimal(&Sha256::digest(&bytes));
            if sha256 != entry.sha256 {
                let reason = format!("{} has SHA-256 {sha256}, the manifest says {}", entry.file, entry.sha256);
                return Err(wrong(network, reason));
            }
            files[network as usize] = bytes;
        }
        Ok(Self { manifest, files, origin })
    }

    /// What the manifest says.
    pub fn manifest(&self) -> &Manifest {
        &self.manifest
    }

    /// `embedded`, or the folder.
    pub fn origin(&self) -> &str {
        &self.origin
    }

    /// What the manifest says about one network.
    pub fn entry(&self, network: Network) -> &ModelEntry {
        &self.manifest.models[network.name()]
    }

    /// The ONNX file of one network.
    pub fn bytes(&self, network: Network) -> &[u8] {
        &self.files[network as usize]
    }

    /// Loads one network into `backend` and checks that its tensors are what the manifest says.
    ///
    /// # Errors
    /// [`Error::Model`] if the file is no ONNX network, uses an operator that the backend lacks, or has other shapes.
    pub fn load(&self, network: Network, backend: &Backend) -> Result<Box<dyn Engine>, Error> {
        let engine = backend.load(network.name(), self.bytes(network))?;
        for (what, shape, expected) in [
            ("input", engine.input_shape(), network.input_shape()),
            ("output", engine.output_shape(), network.output_shape()),
        ] {
            if shape != expected {
                return Err(wrong(
                    network,
                    format!("the {what} in its file has shape {shape:?}, expected {expected:?}"),
                ));
            }
        }
        Ok(engine)
    }
}

fn wrong(network: Network, reason: String) -> Error {
    Error::Model { name: network.name().into(), reason }
}

/// The bytes of a file of sane size.
fn read(path: &Path) -> Result<Vec<u8>, String> {
    let length = std::fs::metadata(path).map_err(|error| error.to_string())?.len();
    if length > LARGEST_FILE {
        return Err(format!("it has {length} bytes, the limit is {LARGEST_FILE}"));
    }
    std::fs::read(path).map_err(|error| error.to_string())
}

fn hexadecimal(bytes: &[u8]) -> String {
    bytes.iter().fold(String::new(), |mut text, byte| {
        write!(text, "{byte:02x}").expect("writing to a string does not fail");
        text
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A folder with the embedded networks, for tests to damage.
    fn folder() -> tempfile::TempDir {
        let folder = tempfile::tempdir().unwrap();
        let models = Models::embedded().unwrap();
        for network in Network::ALL {
            std::fs::write(folder.path().join(&models.entry(network).file), models.bytes(network)).unwrap();
        }
        write_manifest(folder.path(), models.manifest());
        folder
    }

    fn write_manifest(folder: &Path, manifest: &Manifest) {
        std::fs::write(folder.join(MANIFEST_FILE), serde_json::to_string(manifest).unwrap()).unwrap();
    }

    fn message(folder: &Path) -> String {
        Models::from_folder(folder).err().unwrap().to_string()
    }

    #[test]
    fn a_folder_replaces_the_embedded_networks() {
        let folder = folder();
        let models = Models::from_folder(folder.path()).unwrap();
        assert_eq!(models.manifest(), Models::embedded().unwrap().manifest());
        assert_eq!(models.origin(), folder.path().display().to_string());
    }

    #[test]
    fn a_missing_folder_or_file_is_named() {
        let folder = folder();
        assert!(matches!(Models::from_folder(&folder.path().join("absent")), Err(Error::File { .. })));
        std::fs::remove_file(folder.path().join("od_net.onnx")).unwrap();
        assert!(message(folder.path()).starts_with("model od_net: od_net.onnx: "));
    }

    #[test]
    fn a_damaged_file_is_caught_by_its_hash() {
        let folder = folder();
        let path = folder.path().join("vd_net.onnx");
        let mut bytes = std::fs::read(&path).unwrap();
        let middle = bytes.len() / 2;
        bytes[middle] ^= 1;
        std::fs::write(&path, bytes).unwrap();
        assert!(message(folder.path()).contains("SHA-256"));
    }

    #[test]
    fn a_manifest_of_another_form_is_refused() {
        let folder = folder();
        let manifest = Models::embedded().unwrap().manifest().clone();
        let mut other = manifest.clone();
        other.format += 1;
        write_manifest(folder.path(), &other);
        assert!(message(folder.path()).contains("format 2"));

        let mut other = manifest.clone();
        other.models.get_mut("cdf_net").unwrap().input.shape[1] = 3;
        write_manifest(folder.path(), &other);
        assert!(message(folder.path()).contains("expected [1, 16, 64, 64]"));

        let mut other = manifest.clone();
        other.models.get_mut("bsr_net").unwrap().file = "../bsr_net.onnx".into();
        write_manifest(folder.path(), &other);
        assert!(message(folder.path()).contains("not a plain name"));

        let mut other = manifest;
        other.models.remove("vd_net");
        write_manifest(folder.path(), &other);
        assert!(message(folder.path()).contains("the manifest lacks it"));

        std::fs::write(folder.path().join(MANIFEST_FILE), "{").unwrap();
        assert!(matches!(Models::from_folder(folder.path()), Err(Error::Format { .. })));
    }

    #[test]
    fn a_network_of_another_shape_is_refused_on_load() {
        let folder = folder();
        let mut manifest = Models::embedded().unwrap().manifest().clone();
        let cdf = manifest.models["cdf_net"].clone();
        let vd = manifest.models.get_mut("vd_net").unwrap();
        (vd.file, vd.sha256) = (cdf.file, cdf.sha256);
        write_manifest(folder.path(), &manifest);
        let models = Models::from_folder(folder.path()).unwrap();
        let error = models.load(Network::Vd, &Backend::embedded(1, String::new())).err().unwrap();
        assert_eq!(
            error.to_string(),
            "model vd_net: the input in its file has shape [1, 16, 64, 64], expected [1, 15, 64, 64]"
        );
    }

    #[test]
    fn damaged_networks_never_crash_the_embedded_engine() {
        let backend = Backend::embedded(1, String::new());
        let models = Models::embedded().unwrap();
        let bytes = models.bytes(Network::Vd);
        let run = |bytes: &[u8]| {
            // What still loads has to run or fail in order, too.
            backend
                .load("damaged", bytes)
                .and_then(|mut engine| engine.run(&vec![0.5; engine.input_shape().iter().product()]))
        };
        for length in (0..bytes.len()).step_by(bytes.len() / 40) {
            assert!(matches!(run(&bytes[..length]), Err(Error::Model { .. })), "{length} of {} bytes", bytes.len());
        }
        for k in 0..60 {
            let mut bytes = bytes.to_vec();
            let place = k * 7919 % bytes.len();
            bytes[place] ^= 0x55;
            let _ = run(&bytes);
        }
    }
}
