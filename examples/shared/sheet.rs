//! What the sheets of held-out sketches are asked for.

/// Sketches of one surface follow each other: one of each is enough.
pub const STRIDE: u64 = 4;

/// The command line `FILE [COUNT] [FIRST] [--truth]`.
pub struct Sheet {
    /// Where the picture goes.
    pub file: String,
    /// Number of sketches; 30 unless told.
    pub count: u64,
    /// The first of them within the split; 0 unless told.
    pub first: u64,
    /// Whether the exact surfaces are used instead of the predicted ones.
    pub on_truth: bool,
}

impl Sheet {
    /// Reads the command line.
    ///
    /// # Errors
    /// A missing file, or what is not a number.
    pub fn from_arguments() -> Result<Self, Box<dyn std::error::Error>> {
        let mut arguments: Vec<String> = std::env::args().skip(1).collect();
        let on_truth = arguments.iter().any(|a| a == "--truth");
        arguments.retain(|a| a != "--truth");
        let file = arguments.first().ok_or("a file for the sheet, please")?.clone();
        let number = |k: usize, or: u64| arguments.get(k).map_or(Ok(or), |a| a.parse::<u64>());
        Ok(Self { file, count: number(1, 30)?, first: number(2, 0)?, on_truth })
    }
}
