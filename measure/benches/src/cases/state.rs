//! Calls of a twin between steps: stored states, derivatives, restart from measured values.

use std::hint::black_box;

use anyhow::Result;
use fivebar::variables::Value;

use super::H;
use crate::case::{Case, Work};
use crate::host::{Host, Stored, reference};

/// Repeats of each call.
const CALLS: u64 = 1000;

pub(super) fn cases() -> Result<Vec<Case>> {
    let references = |names: &[&str]| names.iter().map(|name| reference(name)).collect::<Result<Vec<u32>>>();
    let accelerations = references(&["alpha[1]", "alpha[2]", "tip.ax", "tip.ay"])?;
    let tip = references(&["tip.x", "tip.y", "tip.vx", "tip.vy"])?;
    let motors = references(&["tau[1]", "tau[2]"])?;
    let torque = motors[..1].to_vec();
    let measured = references(&["init.theta[1]", "init.theta[2]", "init.omega[1]", "init.omega[2]"])?;
    let (mut changes, mut rates) = ([0.0; 4], [0.0; 4]);
    Ok(vec![
        calls("fmi2GetFMUstate, new, and fmi2FreeFMUstate", |host| {
            let mut stored = Stored::NONE;
            host.store(&mut stored);
            host.free(stored);
        }),
        with_stored("fmi2GetFMUstate over an old one", |host, stored, _| host.store(stored)),
        with_stored("fmi2SetFMUstate", |host, stored, _| host.restore(stored)),
        with_stored("fmi2SerializeFMUstate", |host, stored, bytes| host.serialise(stored, bytes)),
        with_stored("fmi2DeSerializeFMUstate", |host, stored, bytes| host.deserialise(bytes, stored)),
        calls("fmi2GetDirectionalDerivative, 4 accelerations by a torque", move |host| {
            host.directional_derivative(&accelerations, black_box(&torque), &[1.0], &mut changes);
        }),
        calls("fmi2GetRealOutputDerivatives of 4 outputs", move |host| {
            host.output_rates(black_box(&tip), &[1; 4], &mut rates);
        }),
        calls("fmi2SetRealInputDerivatives of 2 inputs", move |host| {
            host.input_rates(black_box(&motors), &[1; 2], &[0.0; 2]);
        }),
        calls("re-synchronise: reset, 4 measured values, to the first step", move |host| {
            host.again(black_box(&measured), black_box(&[1.2, 2.1, 0.3, -0.2]));
            host.step(H);
        }),
    ])
}

/// Repeats a call in the middle of the fall.
fn calls(name: &'static str, call: impl FnMut(&mut Host) + Clone + 'static) -> Case {
    Case::new("state", name, CALLS, move || {
        let (mut host, mut call) = (falling()?, call.clone());
        let work: Work = Box::new(move || (0..CALLS).for_each(|_| call(&mut host)));
        Ok(work)
    })
}

/// A case with a stored state, and its bytes.
fn with_stored(name: &'static str, call: fn(&Host, &mut Stored, &mut [u8])) -> Case {
    Case::new("state", name, CALLS, move || {
        let (host, mut stored) = (falling()?, Stored::NONE);
        host.store(&mut stored);
        let mut bytes = vec![0; host.size(&stored)];
        host.serialise(&stored, &mut bytes);
        let work: Work = Box::new(move || (0..CALLS).for_each(|_| call(&host, &mut stored, &mut bytes)));
        Ok(work)
    })
}

fn falling() -> Result<Host> {
    let mut host = Host::ready(&[(reference("init.theta[2]")?, Value::Real(120f64.to_radians()))])?;
    host.step(0.3);
    Ok(host)
}
