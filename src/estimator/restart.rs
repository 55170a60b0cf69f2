//! Reinitialisation of a diverged estimate from the last samples. They do not determine the assembly: that of the estimate is kept, and
//! both hypotheses are followed, as after a vertex.

use super::assembly::{AssemblyHypotheses, DISTINGUISHABLE};
use super::branches::posture;
use super::linkage::{MEASURED, Pair};
use super::track::wrapped;
use super::{Alarm, Branches, Constants, Encoder, Estimator, Innovation, Track, bank};
use crate::mechanism::{Assembly, Start};

/// Innovation that means divergence, rad.
const DIVERGED_INNOVATION: f64 = 0.1;
/// Accumulated time of diverged samples that reinitialises the estimate, s.
const DIVERGENCE_TIME: f64 = 0.1;
/// Largest duration that a single sample counts for, s.
const LONGEST_SAMPLE_TIME: f64 = 0.02;

impl Estimator {
    /// Reinitialises the estimate where samples (innovation, angle) of these ages, s, have diverged from it; returns whether it has. Both
    /// encoders must agree, for one alone may be faulty; next to a vertex, where samples are not used, one suffices.
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

    /// Motion from the last two samples of each encoder; `None` where the loop cannot be closed or the assemblies coincide.
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

    /// Whether the last samples have reinitialised the estimate.
    pub fn has_restarted(&self) -> bool {
        self.restarted
    }
}
