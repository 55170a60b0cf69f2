//! A machine that the estimate has lost: the samples say where it is and how fast, and the estimate begins there anew. In which assembly
//! they do not say: it keeps that of the estimate, and both are followed, as behind a vertex.

use super::assembly::{AssemblyHypotheses, DISTINGUISHABLE};
use super::branches::posture;
use super::linkage::{MEASURED, Pair};
use super::track::wrapped;
use super::{Alarm, Branches, Constants, Encoder, Estimator, Innovation, Track, bank};
use crate::mechanism::{Assembly, Start};

/// Samples further off the estimate than this, rad, are those of another motion,
const DIVERGED_INNOVATION: f64 = 0.1;
/// where they last for so much longer than others, s;
const DIVERGENCE_TIME: f64 = 0.1;
/// each lasts until the next, but no longer than this, s.
const LONGEST_SAMPLE_TIME: f64 = 0.02;

impl Estimator {
    /// Samples (innovation, angle) with their ages, s: whether the machine was lost, and the estimate has begun anew where they are. Both
    /// encoders have to say so, for one alone may be wrong; next to a vertex, where samples are not used, one is enough.
    pub(super) fn reinitialize(&mut self, constants: &Constants, received: &[Option<(Innovation, f64)>; 2], ages: &Pair) -> bool {
        self.restarted = false;
        let [Some(left), Some(right)] = received else { return false };
        let off = [left, right].map(|(innovation, _)| innovation.residual.abs() > DIVERGED_INNOVATION);
        let diverged = if self.held { off[0] || off[1] } else { off[0] && off[1] };
        let passed = self.encoders.iter().fold(LONGEST_SAMPLE_TIME, |least, encoder| least.min(encoder.interval()));
        self.diverged = (self.diverged + if diverged { passed } else { -passed }).max(0.0);
        if self.diverged < DIVERGENCE_TIME {
            return false;
        }
        let Some(track) = self.motion_from_samples(constants, [left.1, right.1], ages) else { return false };
        self.innovation = [left, right].map(|(innovation, _)| innovation.residual);
        (self.track, self.branches, self.assembly) = (track, Branches::default(), AssemblyHypotheses::of_unknown_side());
        self.history.clear();
        self.alarm = Alarm::default();
        (self.held, self.diverged, self.restarted) = (false, 0.0, true);
        true
    }

    /// The motion of the last two samples of each encoder; `None` where the loop cannot be closed, or the assemblies are one.
    #[cold]
    #[inline(never)]
    fn motion_from_samples(&self, constants: &Constants, angles: Pair, ages: &Pair) -> Option<Track> {
        let parameters = &constants.parameters;
        let at = constants.linkage.posture(&self.track.theta);
        let omega = self.encoders.each_ref().map(Encoder::rate);
        let theta = [0, 1].map(|i| {
            let expected = self.track.theta[MEASURED[i]];
            expected + wrapped(angles[i] - expected) + ages[i] * omega[i]
        });
        let assemblies = if at.side() > 0.0 { [Assembly::Plus, Assembly::Minus] } else { [Assembly::Minus, Assembly::Plus] };
        let (theta, omega) =
            assemblies.into_iter().find_map(|assembly| posture(&constants.geometry, &Start { theta, omega, assembly }))?;
        if constants.linkage.posture(&theta).side().abs() < DISTINGUISHABLE || !constants.linkage.is_closed(&theta, &omega) {
            return None;
        }
        let mut variances = constants.start_variances();
        for (i, encoder) in self.encoders.iter().enumerate() {
            let noise = parameters.sigma[i] * parameters.sigma[i] + parameters.quantum[i] * parameters.quantum[i] / 12.0;
            variances[0] = variances[0].max(noise);
            variances[1] = variances[1].max(2.0 * noise / (encoder.interval() * encoder.interval()));
        }
        Some(Track { theta, omega, force: [0.0; 4], bank: bank::Bank::new(variances) })
    }

    /// Whether it has begun anew with the last samples.
    pub fn has_restarted(&self) -> bool {
        self.restarted
    }
}
