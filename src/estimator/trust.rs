//! Trust in an encoder: whether its samples are used, and which events change this.

use borsh::{BorshDeserialize, BorshSerialize};

/// Trust in an encoder. It does not change while the encoder is silent.
#[derive(Clone, Copy, Debug, PartialEq, BorshSerialize, BorshDeserialize)]
pub(super) enum Trust {
    /// The last sample was used.
    Good,
    /// This many samples in a row were rejected, each as an outlier.
    Rejected(u32),
    /// The reading jumped away from the estimate: innovation at the jump, rad, and number of samples rejected in a row.
    Away { jump: f64, rejected: u32 },
    /// The reading repeats although the axis turns; number of samples rejected in a row.
    Stuck { rejected: u32 },
}

/// Events that may change the trust in an encoder.
#[derive(Clone, Copy, Debug)]
pub(super) enum Event {
    /// A sample is used.
    Accepted,
    /// The gate rejects a sample.
    Rejected,
    /// The gate rejects a sample because its reading jumped; innovation, rad.
    Jumped(f64),
    /// A sample repeats a reading although the axis has left it.
    Froze,
    /// The reading has changed.
    Changed,
    /// The reading moved again after a jump.
    Returned,
    /// The encoder is back after such a long silence that it counts as new.
    Renewed,
    /// The first samples reveal that the encoders are swapped; innovation, rad.
    Exchanged(f64),
}

impl Trust {
    /// Trust after an event.
    pub(super) fn after(self, event: Event) -> Self {
        let (rejected, more) = (self.rejected(), self.rejected().saturating_add(1));
        match (event, self) {
            (Event::Accepted, _) => Self::Good,
            (Event::Rejected, Self::Away { jump, .. }) => Self::Away { jump, rejected: more },
            (Event::Rejected, Self::Good | Self::Rejected(_) | Self::Stuck { .. }) => Self::Rejected(more),
            (Event::Jumped(jump), _) => Self::Away { jump, rejected: more },
            (Event::Froze, _) => Self::Stuck { rejected: more },
            (Event::Changed, Self::Stuck { .. }) | (Event::Renewed, Self::Away { .. }) => Self::Rejected(rejected),
            // If only one sample was rejected, it may have been an outlier and no jump.
            (Event::Returned, Self::Away { .. }) => {
                if self.is_lasting() {
                    Self::Good
                } else {
                    Self::Rejected(rejected)
                }
            }
            (Event::Changed | Event::Renewed | Event::Returned, same) => same,
            (Event::Exchanged(jump), _) => Self::Away { jump, rejected: rejected.max(2) },
        }
    }

    /// Number of samples rejected in a row.
    pub(super) fn rejected(self) -> u32 {
        match self {
            Self::Good => 0,
            Self::Rejected(rejected) | Self::Away { rejected, .. } | Self::Stuck { rejected } => rejected,
        }
    }

    /// Whether more than a single sample was rejected.
    pub(super) fn is_lasting(self) -> bool {
        self.rejected() > 1
    }

    /// Whether stored values are possible.
    pub(super) fn is_sound(self) -> bool {
        match self {
            Self::Away { jump, .. } => jump.is_finite(),
            Self::Good | Self::Rejected(_) | Self::Stuck { .. } => true,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A single outlier is no failure. After a jump a reading stays away until it moves again; a stuck reading stays stuck until it changes.
    #[test]
    fn each_state_has_its_way_out() {
        let good = Trust::Good;
        let outlier = good.after(Event::Rejected);
        assert!(outlier == Trust::Rejected(1) && !outlier.is_lasting());
        assert_eq!(outlier.after(Event::Accepted), good);
        let away = good.after(Event::Jumped(0.1));
        assert_eq!(away.after(Event::Changed), away);
        assert_eq!(away.after(Event::Returned), outlier);
        let lasting = away.after(Event::Rejected);
        assert_eq!(lasting, Trust::Away { jump: 0.1, rejected: 2 });
        assert_eq!(lasting.after(Event::Returned), good);
        assert_eq!(lasting.after(Event::Renewed), Trust::Rejected(2));
        let stuck = good.after(Event::Froze);
        assert_eq!(stuck.after(Event::Returned), stuck);
        assert_eq!(stuck.after(Event::Changed), outlier);
        assert_eq!(good.after(Event::Exchanged(1.0)), Trust::Away { jump: 1.0, rejected: 2 });
    }
}
