//! Dependencies of each unknown at the start: InitialUnknowns against changes caused by other values of parameters and inputs (rule 20 of
//! this project).

use std::collections::{BTreeMap, BTreeSet};
use std::f64::consts::{FRAC_PI_2, PI};

use fivebar::ffi::*;
use model_description::{Causality, Kind, ModelDescription, Unknown, Variable};
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::SeedableRng;

use super::fmi_derivatives::{Scene, everything};
use super::fmi_host::{Host, methods, reference};

/// A scene, its proximal angles and rates, and the number of its method.
struct Start {
    scene: Scene,
    state: [f64; 4],
    method: i32,
}

impl Start {
    fn host(&self) -> Host {
        let host = self.scene.initializing(self.state);
        assert_eq!(host.set_integer(&[reference("solver.method")], &[self.method]), fmi2OK);
        host
    }
}

/// Without effects: the paper's start (distal links in line), a bent posture in motion, all links in one line, at rest and in motion. By
/// every method with all effects: both assemblies, either stop of each motor, the tip in contact.
fn starts() -> Vec<Start> {
    let bare = |state| Start { scene: Scene { reals: Vec::new(), enabled: Vec::new(), assembly: 1 }, state, method: 1 };
    let mut starts = vec![
        bare([FRAC_PI_2, FRAC_PI_2, 0.0, 0.0]),
        bare([1.1, 1.9, 0.5, -1.0]),
        bare([PI, PI, 0.0, 0.0]),
        bare([PI, PI, 2.0, 2.0]),
    ];
    let mut random = ChaCha8Rng::seed_from_u64(43);
    for method in methods() {
        for (assembly, lower) in [(1, false), (2, true)] {
            let (mut scene, state) = everything(&mut random, assembly);
            // Wide enough for breakaway and ramps to matter at these rates and depths.
            scene.reals.extend([("friction.breakawayVelocity".into(), 1.0), ("stop.width".into(), 0.1)]);
            if lower {
                for (leg, angle) in (1..=2).zip(state) {
                    scene.reals.push((format!("stop.upper[{leg}]"), angle + 2.0));
                    scene.reals.push((format!("stop.lower[{leg}]"), angle + 0.02));
                }
            }
            starts.push(Start { scene, state, method });
        }
    }
    starts
}

/// The unknowns; `None` if the start is refused.
fn read(host: &Host, unknowns: &[Unknown]) -> Option<Vec<f64>> {
    let references: Vec<u32> = unknowns.iter().map(|unknown| reference_of(&unknown.name)).collect();
    let mut values = vec![f64::NAN; references.len()];
    let status = host.get_real(&references, &mut values);
    host.take();
    (status == fmi2OK).then_some(values)
}

/// A derivative shares the value reference of another variable.
fn reference_of(name: &str) -> u32 {
    match name.strip_prefix("der(theta") {
        Some(rest) => reference(&format!("omega{}", rest.trim_end_matches(')'))),
        None => match name.strip_prefix("der(omega") {
            Some(rest) => reference(&format!("alpha{}", rest.trim_end_matches(')'))),
            None => reference(name),
        },
    }
}

/// Sets a known to several other values in turn, and back; calls `look` after each allowed value.
fn vary(host: &Host, known: &Variable, mut look: impl FnMut(&Host)) {
    let reference = [known.reference];
    match known.kind {
        Kind::Real { bounds, .. } => {
            let mut value = [f64::NAN];
            assert_eq!(host.get_real(&reference, &mut value), fmi2OK);
            let [value] = value;
            let shift = 1e-3 * (1.0 + value.abs());
            let ways = [value + shift, value - shift, 1.25 * value, 0.5 * value, 3.0 * value];
            for other in ways.into_iter().chain(bounds.min.filter(|min| *min >= 0.0)) {
                if host.set_real(&reference, &[other]) == fmi2OK {
                    look(host);
                }
            }
            assert_eq!(host.set_real(&reference, &[value]), fmi2OK);
        }
        Kind::Integer { .. } | Kind::Enumeration { .. } => {
            let mut value = [0];
            assert_eq!(host.get_integer(&reference, &mut value), fmi2OK);
            for other in 1..=20 {
                if host.set_integer(&reference, &[other]) == fmi2OK {
                    look(host);
                }
            }
            assert_eq!(host.set_integer(&reference, &value), fmi2OK);
        }
        Kind::Boolean { .. } => {
            let mut value = [0];
            assert_eq!(host.get_boolean(&reference, &mut value), fmi2OK);
            assert_eq!(host.set_boolean(&reference, &[1 - value[0]]), fmi2OK);
            look(host);
            assert_eq!(host.set_boolean(&reference, &value), fmi2OK);
        }
    }
    host.take();
}

/// Every change is declared, in every scene; every declared dependency changes its unknown in at least one scene.
#[test]
fn initial_unknowns_depend_exactly_on_declared_variables() {
    let description = ModelDescription::read().expect("the shipped description");
    let unknowns = &description.structure.initial_unknowns;
    let is_known = |variable: &&Variable| matches!(variable.causality, Causality::Parameter | Causality::Input);
    // The tip's position is computed from the centre of mass of a link, and by each method in its own coordinates. Dependent quantities
    // have a round-off of 1e-16 m, and forces also have round-off from the contact's stiffness of 2e3 N/m and its damping. Round-off is
    // relative to the largest of a kind, because one component may be small by chance. The smallest real change is some 1e-6.
    let kind = |unknown: &Unknown| unknown.name.split(['[', '.']).next().unwrap_or_default().to_owned();
    let scales = |values: &[f64]| {
        let mut largest = BTreeMap::new();
        for (unknown, value) in unknowns.iter().zip(values) {
            let scale = largest.entry(kind(unknown)).or_insert(1.0_f64);
            *scale = scale.max(value.abs());
        }
        unknowns.iter().map(|unknown| largest[&kind(unknown)]).collect::<Vec<_>>()
    };
    let mut seen = BTreeSet::new();
    for start in starts() {
        let host = start.host();
        let before = read(&host, unknowns).expect("a start");
        let scales = scales(&before);
        for known in description.variables.iter().filter(is_known) {
            vary(&host, known, |host| {
                let Some(after) = read(host, unknowns) else { return };
                for (i, unknown) in unknowns.iter().enumerate() {
                    if (after[i] - before[i]).abs() > 1e-10 * scales[i] {
                        seen.insert((unknown.name.clone(), known.name.full.clone()));
                    }
                }
            });
            assert_eq!(read(&host, unknowns).as_ref(), Some(&before), "{} has been set back", known.name.full);
        }
    }
    let pairs =
        |unknown: &Unknown| unknown.dependencies.iter().map(|known| (unknown.name.clone(), known.clone())).collect::<Vec<_>>();
    let declared: BTreeSet<_> = unknowns.iter().flat_map(pairs).collect();
    let missing: Vec<_> = seen.difference(&declared).collect();
    let idle: Vec<_> = declared.difference(&seen).collect();
    assert!(missing.is_empty() && idle.is_empty(), "not declared: {missing:?}; declared, and nothing changes: {idle:?}");
}
