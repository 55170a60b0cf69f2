//! Tests of the published problems as one binary; this file is the index.

mod derivatives; // Φ_q, Φ̇_q q̇, stiffnesses and linear solves of every problem against finite differences along its motion
mod four_bars; // A02: energy, tip, the exact pendulum, singular passes at many step sizes
mod pendulum; // A01: order and accuracy of every method
mod squeezer; // Andrews' mechanism: start, seven angles at the end, order

/// Slope of log error against log h, least squares.
fn slope(points: &[(f64, f64)]) -> f64 {
    let n = points.len() as f64;
    let logs: Vec<(f64, f64)> = points.iter().map(|(h, error)| (h.ln(), error.ln())).collect();
    let (sx, sy) = logs.iter().fold((0.0, 0.0), |(sx, sy), (x, y)| (sx + x, sy + y));
    let (sxx, sxy) = logs.iter().fold((0.0, 0.0), |(sxx, sxy), (x, y)| (sxx + x * x, sxy + x * y));
    (n * sxy - sx * sy) / (n * sxx - sx * sx)
}
