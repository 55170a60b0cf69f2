//! Tables of figures, each with its target.

use std::fmt::Write;

/// A figure.
#[derive(Clone, Debug)]
pub struct Figure {
    name: String,
    value: f64,
    allowed: Option<[f64; 2]>,
    remark: String,
}

impl Figure {
    /// A figure with an upper bound.
    pub fn at_most(name: String, value: f64, most: f64, remark: String) -> Self {
        Self { name, value, allowed: Some([f64::NEG_INFINITY, most]), remark }
    }

    /// A figure with a lower bound.
    pub fn at_least(name: String, value: f64, least: f64, remark: String) -> Self {
        Self { name, value, allowed: Some([least, f64::INFINITY]), remark }
    }

    /// A figure that must lie between two values.
    pub fn between(name: String, value: f64, allowed: [f64; 2], remark: String) -> Self {
        Self { name, value, allowed: Some(allowed), remark }
    }

    /// A figure without a target.
    pub fn untargeted(name: String, value: f64, remark: String) -> Self {
        Self { name, value, allowed: None, remark }
    }

    /// Drops the target.
    pub fn demand_nothing(&mut self) {
        self.allowed = None;
    }

    /// Whether the figure meets its target.
    pub fn is_reached(&self) -> bool {
        self.allowed.is_none_or(|[least, most]| (least..=most).contains(&self.value))
    }
}

/// Related figures.
#[derive(Clone, Debug)]
pub struct Table {
    title: String,
    /// Rows of the table.
    pub figures: Vec<Figure>,
}

impl Table {
    /// A table without rows.
    pub fn new(title: &str) -> Self {
        Self { title: title.into(), figures: Vec::new() }
    }

    /// Adds a row.
    pub fn push(&mut self, figure: Figure) {
        self.figures.push(figure);
    }

    /// The table in Markdown.
    pub fn markdown(&self) -> String {
        let mut text =
            format!("\n{}\n\n| figure | measured | allowed | reached | |\n| --- | --- | --- | --- | --- |\n", self.title);
        for figure in &self.figures {
            let Figure { name, value, allowed, remark } = figure;
            let (allowed, reached) = match allowed {
                None => (String::new(), ""),
                Some([f64::NEG_INFINITY, most]) => (format!("≤ {most}"), if figure.is_reached() { "yes" } else { "NO" }),
                Some([least, f64::INFINITY]) => (format!("≥ {least}"), if figure.is_reached() { "yes" } else { "NO" }),
                Some([least, most]) => (format!("{least} to {most}"), if figure.is_reached() { "yes" } else { "NO" }),
            };
            writeln!(text, "| {name} | {} | {allowed} | {reached} | {remark} |", shown(*value)).expect("a String can be written");
        }
        text
    }
}

/// A value with three digits.
fn shown(value: f64) -> String {
    match value.abs() {
        0.0 => "0".into(),
        size if size >= 100.0 => format!("{value:.0}"),
        size if size >= 10.0 => format!("{value:.1}"),
        size if size >= 0.01 => format!("{value:.3}"),
        _ => format!("{value:.2e}"),
    }
}

/// Median.
pub fn median(values: impl Iterator<Item = f64>) -> f64 {
    quantile(values, 0.5)
}

/// Quantile at `part`.
pub fn quantile(values: impl Iterator<Item = f64>, part: f64) -> f64 {
    let mut sorted: Vec<f64> = values.collect();
    sorted.sort_by(f64::total_cmp);
    if sorted.is_empty() { f64::NAN } else { sorted[((sorted.len() - 1) as f64 * part).round() as usize] }
}

/// Largest acceptable number of events at a rate in `runs` runs: two standard deviations above the mean (Poisson).
pub fn most_of(rate: f64, runs: u64) -> f64 {
    let mean = rate * runs as f64;
    (mean + 2.0 * mean.sqrt()).floor()
}
