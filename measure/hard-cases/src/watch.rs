//! Requirements of a trial on the path of the link angles, besides energy and constraints.

use std::sync::OnceLock;

use crate::ends::{End, Goal, apart};
use crate::vertex::{Vertex, cosine};

/// A sample of the path: time (s) and link angles (rad).
pub type Sample = (f64, [f64; 4]);

/// Requirement on the path.
#[derive(Clone, Debug)]
pub enum Watch {
    /// None.
    Nothing,
    /// These links must not move.
    Stays {
        /// Links that must stay.
        links: [bool; 4],
        /// Allowed distance, rad.
        within: f64,
    },
    /// Passes straight through the vertex.
    Crosses {
        /// The vertex.
        vertex: Vertex,
        /// Direction and sense of the motion.
        direction: [f64; 4],
        /// Judged interval, s.
        between: [f64; 2],
    },
    /// Turns back before the vertex: the offset of the link [`Vertex::odd`] keeps its sign in `between`. The whole path stays within
    /// `within` of the reference.
    Turns {
        /// The vertex.
        vertex: Vertex,
        /// Interval, s, while it is near enough to the vertex for sides to be meaningful.
        between: [f64; 2],
        /// Path of the reference at the same times; empty while the reference runs.
        reference: Vec<Sample>,
        /// Link angles at the end by an independent method, rad, if available.
        witness: Option<[f64; 4]>,
        /// Allowed distance from both, rad.
        within: f64,
    },
    /// Ends where an independent program ends, within the accuracy of its result.
    Follows {
        /// The scene.
        goal: Box<Goal>,
        /// The program's end, computed once.
        end: OnceLock<Option<End>>,
    },
    /// Leaves rest in the vertex with one of these accelerations; with the first one if they can be distinguished.
    Leaves {
        /// The vertex.
        vertex: Vertex,
        /// Accelerations of the possible branches, rad/s²; the first is the expected one.
        branches: Vec<[f64; 4]>,
    },
}

/// Time at which the branch is judged, s: the motion is still a t²/2, and well above round-off.
const LEAVING: f64 = 5e-3;
/// Cosine above which two directions count as equal.
const SAME: f64 = 0.999;

impl Watch {
    /// Objection to a path; `failed` if the run ended early.
    pub(crate) fn objection(&self, path: &[Sample], failed: bool) -> Option<String> {
        let (begin, last) = (path.first()?.1, path.last()?.1);
        match self {
            Self::Nothing => None,
            Self::Stays { links, within } => {
                let mut moved: f64 = 0.0;
                for (_, theta) in path {
                    for i in 0..4 {
                        if links[i] {
                            moved = moved.max((theta[i] - begin[i]).abs());
                        }
                    }
                }
                (moved > *within).then(|| format!("moves {moved:.1e} rad, allowed {within:e} rad"))
            }
            Self::Crosses { vertex, direction, between: [before, after] } => {
                let side = |time: f64| {
                    let (_, theta) = path.iter().find(|(t, _)| *t >= time - 1e-9)?;
                    Some(cosine(vertex.offset(*theta), *direction))
                };
                match (side(*before), side(*after)) {
                    (Some(before), Some(after)) if before < -0.9 && after > 0.9 => None,
                    (Some(before), Some(after)) => {
                        Some(format!("does not cross: cosine to the straight line {before:.3} before, {after:.3} after"))
                    }
                    _ => (!failed).then(|| "the path is too short".into()),
                }
            }
            Self::Turns { vertex, between: [before, after], reference, witness, within } => {
                let odd = vertex.odd();
                let near = path.iter().filter(|(t, _)| *t >= before - 1e-9 && *t <= after + 1e-9);
                let mut mode = near.map(|(_, theta)| vertex.offset(*theta)[odd].signum());
                let first = mode.next();
                if mode.any(|side| Some(side) != first) {
                    return Some("crosses to the other sheet".into());
                }
                let apart = |x: &[f64; 4], y: &[f64; 4]| (0..4).map(|i| (x[i] - y[i]).abs()).fold(0.0, f64::max);
                let from_reference = path.iter().zip(reference).map(|((_, x), (_, y))| apart(x, y)).fold(0.0, f64::max);
                if from_reference > *within {
                    return Some(format!("comes {from_reference:.1e} rad from the reference, allowed {within:e} rad"));
                }
                let from_witness = witness.map_or(0.0, |end| apart(&last, &end));
                (!failed && from_witness > *within)
                    .then(|| format!("ends {from_witness:.1e} rad from the witness, allowed {within:e} rad"))
            }
            Self::Follows { goal, end } => {
                if failed {
                    return None;
                }
                let Some(End { angles, allowed }) = end.get_or_init(|| goal.kept_or_new()) else {
                    return Some("the independent program gives up".into());
                };
                let off = apart(&last, angles);
                (off > *allowed).then(|| format!("ends {off:.1e} rad from an independent program, allowed {allowed:.1e} rad"))
            }
            Self::Leaves { vertex, branches } => {
                let Some((_, theta)) = path.iter().find(|(t, _)| *t >= LEAVING - 1e-9) else {
                    return (!failed).then(|| "the path is too short".into());
                };
                let offset = vertex.offset(*theta);
                match branches.iter().position(|branch| cosine(offset, *branch) > SAME) {
                    Some(0) => None,
                    Some(other) => Some(format!("leaves on branch {} of {}", other + 1, branches.len())),
                    None => {
                        Some(format!("leaves along {offset:.3?} rad, which is no branch; Gauss says {:.1?} rad/s^2", branches[0]))
                    }
                }
            }
        }
    }

    /// Whether a path is needed.
    pub(crate) fn needs_path(&self) -> bool {
        !matches!(self, Self::Nothing)
    }
}
