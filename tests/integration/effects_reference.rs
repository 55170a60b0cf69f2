//! Every scene with a reference made by tests/data/reference/make: stiff, driven, with contacts; through the C functions.

use fivebar::ffi::fmi2OK;
use fivebar::variables::{Access, Method, Variable};

use crate::fmi_host::{Host, reference};
use crate::support::Reference;

/// What one method is asked to reach on one scene.
struct Goal {
    scene: &'static str,
    /// Largest error of tip (m) and angles (rad), and of rates (rad/s), over all rows.
    bounds: [f64; 2],
}

/// Largest errors of tip and angles, and of rates, over all rows of the reference.
fn errors(scene: &str, method: Method, settings: &[(&str, f64)]) -> [f64; 2] {
    let host = Host::initializing(0.0, None);
    for (name, value) in Reference::values(scene) {
        let variable = Variable::named(&name).unwrap_or_else(|| panic!("{scene}: there is no variable {name}"));
        let status = match variable.access() {
            Access::Real => host.set_real(&[variable.reference], &[value.parse().expect("a number")]),
            Access::Boolean => host.set_boolean(&[variable.reference], &[(value == "true").into()]),
            Access::Integer => panic!("{scene}: {name} is a whole number, which no reference sets"),
        };
        assert_eq!(status, fmi2OK, "{scene}: {name}");
    }
    for (name, value) in settings {
        assert_eq!(host.set_real(&[reference(name)], &[*value]), fmi2OK, "{name}");
    }
    assert_eq!(host.set_integer(&[reference("solver.method")], &[method as i32]), fmi2OK);
    assert_eq!(host.call(fivebar::ffi::fmi2ExitInitializationMode), fmi2OK, "{:?}", host.take());

    let mut names = vec!["tip.x", "tip.y"];
    names.extend(["theta[1]", "passive.theta[1]", "passive.theta[2]", "theta[2]"]);
    names.extend(["omega[1]", "passive.omega[1]", "passive.omega[2]", "omega[2]"]);
    let references: Vec<u32> = names.iter().map(|name| reference(name)).collect();
    let (mut worst, mut now) = ([0.0; 2], 0.0);
    for row in Reference::read(scene) {
        if row.t > now {
            assert_eq!(host.do_step(now, row.t - now), fmi2OK, "{scene}: {:?}", host.take());
            now = row.t;
        }
        let mut values = vec![0.0; references.len()];
        assert_eq!(host.get_real(&references, &mut values), fmi2OK);
        for (i, (value, wanted)) in values.iter().zip(row.tip.iter().chain(&row.theta).chain(&row.omega)).enumerate() {
            let error = &mut worst[usize::from(i >= 6)];
            *error = f64::max(*error, (value - wanted).abs());
        }
    }
    worst
}

#[test]
fn print_errors() {
    for scene in ["fall_90_120", "friction_fall", "run_down", "servo_step", "spring_payload", "end_stops", "bounce"] {
        for tol in [3e-9, 1e-11, 1e-13] {
            println!("{scene} i3alp {tol}: {:?}", errors(scene, Method::I3alp, &[("solver.errorTolerance", tol)]));
        }
        for h in [1e-4, 2e-5, 1e-5] {
            println!("{scene} rk4 {h}: {:?}", errors(scene, Method::Rk4, &[("solver.stepSize", h)]));
        }
    }
}
