use fivebar::observers;
use fivebar::simulation::Simulation;
use hard_cases::{Case, Extent, Setting};
fn main() {
    let a: Vec<String> = std::env::args().collect();
    let name = &a[1];
    let n: usize = a[2].parse().unwrap();
    let t0: f64 = a[3].parse().unwrap();
    let dt: f64 = a[4].parse().unwrap();
    let mut p_setting = match a[5].as_str() {
        "i3" => Setting::Default,
        "tight" => Setting::TIGHT,
        _ => Setting::EXPLICIT,
    };
    let cases = Case::of_item(Extent::Full, 9);
    let case = cases.iter().find(|c| c.name.contains(name.as_str())).unwrap();
    let trial = &case.trials[n];
    let mut p = trial.parameters.clone();
    p_setting.apply(&mut p);
    println!(
        "base {} gravity {} friction {:?} contact {:?} inputs {:?} dur {}",
        p.geometry.base_distance,
        p.effects.gravity.enabled,
        p.effects.friction,
        p.effects.contact,
        trial.schedule[0].inputs,
        trial.duration()
    );
    let inputs = trial.schedule[0].inputs;
    let mut s = Simulation::new(&p, &inputs).unwrap();
    s.advance(&inputs, 1e-3, (t0 / 1e-3) as u64).unwrap();
    for i in 0..200 {
        let r = s.advance(&inputs, dt, 1);
        let m = observers::motion(s.model(), &s.state());
        let n = [p.effects.contact.nx, p.effects.contact.ny];
        let l = n[0].hypot(n[1]);
        let depth = p.effects.contact.offset - (n[0] * m.tip.x + n[1] * m.tip.y) / l;
        println!(
            "{:.6} th {:?} om {:?} depth {:.3e} sub {}",
            t0 + dt * (i + 1) as f64,
            m.theta,
            m.omega,
            depth,
            s.state().core.counters.substeps
        );
        if let Err(e) = r {
            println!("{e}");
            println!("{:?}", s.state().core);
            break;
        }
    }
}
