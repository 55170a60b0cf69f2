//! One run: a scene, a start, a schedule, and its outcome.

use std::time::Instant;

use fivebar::fmi::clock::Clock;
use fivebar::mechanism::SceneError;
use fivebar::observers;
use fivebar::simulation::{Inputs, Parameters, Simulation, State};

use crate::machine::{NO_LOAD, closed, mgl, relative_size};
use crate::setting::Setting;
use crate::watch::{Sample, Watch};

/// Start of a run.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Beginning {
    /// From the proximal angles and rates of the scene.
    Proximal,
    /// From angles (rad) and rates (rad/s) of all links.
    Links([f64; 4], [f64; 4]),
}

/// A number of equal communication steps with constant loads.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Span {
    /// Loads during the span.
    pub inputs: Inputs,
    /// Communication step, s.
    pub size: f64,
    /// Number of steps.
    pub count: u64,
}

impl Span {
    /// The same span in communication steps not shorter than the macro step.
    pub(crate) fn in_steps_of(self, step: f64) -> Self {
        if step <= self.size { self } else { Self { size: step, count: (self.duration() / step).round() as u64, ..self } }
    }

    /// Duration, s.
    pub fn duration(&self) -> f64 {
        self.size * self.count as f64
    }
}

/// Definition of a run.
#[derive(Clone, Debug)]
pub struct Trial {
    /// Exact values that identify the trial within its case.
    pub label: String,
    /// Scene of the run.
    pub parameters: Parameters,
    /// Start of the run.
    pub beginning: Beginning,
    /// Schedule of communication steps and loads.
    pub schedule: Vec<Span>,
    /// Requirement on the path, besides energy and constraints.
    pub watch: Watch,
    /// The unit of energy errors is the larger of mgL and this fraction of the largest kinetic energy.
    pub kinetic_part: f64,
    /// If set, outputs in a vertex (smallest singular value of Φ_q below 1e-3) are shown but not judged by Φ and Φ̇, because a projection
    /// there divides by this singular value.
    pub vertex_outputs: bool,
    /// Indices of the configuration signs (0 assembly, 1 left, 2 right leg); at least one of them must change, so that a singularity is
    /// passed.
    pub passes: &'static [usize],
    /// If positive, the motion first runs for this time, s, and is reversed before the schedule begins.
    pub turned_after: f64,
    /// Whether the trial keeps its own macro step or tolerance.
    pub keeps_settings: bool,
}

/// End of a run.
#[derive(Clone, Debug, PartialEq)]
pub enum Ending {
    /// Reached the end of its schedule.
    Complete,
    /// Ended with a status: the message, and the time, s.
    Status(String, f64),
    /// The start was refused.
    Refused(String),
    /// Reached a value that is not finite, at this time, s. Must not happen.
    NotFinite(f64),
}

/// Outcome of a run.
#[derive(Clone, Debug)]
pub struct Outcome {
    /// Whether and why the run ended early.
    pub ending: Ending,
    /// Largest |balance residual of the energy|, in the trial's unit.
    pub energy: f64,
    /// Largest |balance residual of the energy|, J.
    pub joules: f64,
    /// Largest decrease of dissipated energy, relative to the largest energy until then.
    pub taken_back: f64,
    /// Largest constraint violation at the outputs, m, scaled to the paper's machine.
    pub position: f64,
    /// Largest constraint violation at velocity level, m/s, scaled likewise.
    pub velocity: f64,
    /// Largest violations at position and at velocity level among the judged outputs, in the units above.
    pub judged: [f64; 2],
    /// Largest number of sub-steps in a macro step (the mean over a communication step with several macro steps).
    pub most: u64,
    /// Number of sub-steps.
    pub substeps: u64,
    /// Number of macro steps.
    pub steps: u64,
    /// Objection of the watch.
    pub objection: Option<String>,
    /// Path of the link angles, if the watch needs it.
    pub path: Vec<Sample>,
    /// The last state.
    pub state: Option<State>,
    /// Wall time, s.
    pub seconds: f64,
}

impl Trial {
    /// A free motion of `duration` seconds from the scene's own start, with outputs every millisecond.
    pub fn free(label: impl Into<String>, parameters: Parameters, duration: f64) -> Self {
        Self::driven(label, parameters, NO_LOAD, duration)
    }

    /// A motion of `duration` seconds under constant loads, with outputs every millisecond.
    pub fn driven(label: impl Into<String>, parameters: Parameters, inputs: Inputs, duration: f64) -> Self {
        Self {
            label: label.into(),
            parameters,
            beginning: Beginning::Proximal,
            schedule: vec![Span { inputs, size: 1e-3, count: (duration / 1e-3).round() as u64 }],
            watch: Watch::Nothing,
            kinetic_part: 0.0,
            vertex_outputs: false,
            passes: &[],
            turned_after: 0.0,
            keeps_settings: false,
        }
    }

    /// The trial with this start: angles and rates of all links.
    pub fn from_links(self, theta: [f64; 4], omega: [f64; 4]) -> Self {
        Self { beginning: Beginning::Links(theta, omega), ..self }
    }

    /// Duration, s.
    pub fn duration(&self) -> f64 {
        self.schedule.iter().map(Span::duration).sum()
    }

    /// The scene with the setting applied.
    fn scene(&self, setting: Setting) -> Parameters {
        let mut parameters = self.parameters.clone();
        setting.apply(&mut parameters);
        if self.keeps_settings {
            parameters.settings.step_size = self.parameters.settings.step_size;
            parameters.settings.error_tolerance = self.parameters.settings.error_tolerance;
        }
        parameters
    }

    /// The initialised simulation.
    pub fn start(&self, setting: Setting) -> Result<Simulation, SceneError> {
        self.initialised(&self.scene(setting))
    }

    fn initialised(&self, parameters: &Parameters) -> Result<Simulation, SceneError> {
        let inputs = self.schedule.first().map_or(NO_LOAD, |span| span.inputs);
        let simulation = match self.beginning {
            Beginning::Proximal => Simulation::new(parameters, &inputs)?,
            Beginning::Links(theta, omega) => Simulation::at(parameters, &inputs, theta, omega)?,
        };
        if self.turned_after == 0.0 { Ok(simulation) } else { self.turned(parameters, simulation) }
    }

    /// Runs the motion for a while and reverses it.
    fn turned(&self, parameters: &Parameters, mut simulation: Simulation) -> Result<Simulation, SceneError> {
        let step = parameters.settings.step_size;
        let away = simulation.advance(&NO_LOAD, step, (self.turned_after / step).round() as u64);
        away.map_err(|failure| SceneError(format!("on the way out: {failure}.")))?;
        let motion = observers::motion(simulation.model(), &simulation.state());
        let (theta, omega) = closed(&parameters.geometry, motion.theta, motion.omega);
        Simulation::at(parameters, &NO_LOAD, theta, omega.map(|rate| -rate))
    }

    /// Runs the trial with a setting.
    pub fn run(&self, setting: Setting) -> Outcome {
        let begin = Instant::now();
        let mut outcome = Outcome {
            ending: Ending::Complete,
            energy: 0.0,
            joules: 0.0,
            taken_back: 0.0,
            position: 0.0,
            velocity: 0.0,
            judged: [0.0; 2],
            most: 0,
            substeps: 0,
            steps: 0,
            objection: None,
            path: Vec::new(),
            state: None,
            seconds: 0.0,
        };
        let scene = self.scene(setting);
        match self.initialised(&scene) {
            Err(refusal) => outcome.ending = Ending::Refused(refusal.to_string()),
            Ok(mut simulation) => {
                let mut path = Vec::new();
                outcome.ending = self.follow(&mut simulation, scene.settings.step_size, &mut outcome, &mut path);
                let failed = outcome.ending != Ending::Complete;
                outcome.objection = self.watch.objection(&path, failed);
                outcome.path = path;
                let counters = simulation.state().core.counters;
                if !failed && !self.passes.is_empty() && self.passes.iter().all(|&bit| counters.sign_changes[bit] == 0) {
                    outcome.objection = Some("passes through no such singularity".into());
                }
                (outcome.steps, outcome.substeps) = (counters.steps, counters.substeps);
                outcome.state = Some(simulation.state());
            }
        }
        outcome.seconds = begin.elapsed().as_secs_f64();
        outcome
    }

    /// Wall time of the communication steps, s, without observations; the failure if the run does not complete.
    pub fn time(&self, setting: Setting) -> Result<f64, String> {
        let scene = self.scene(setting);
        let mut simulation = self.initialised(&scene).map_err(|refusal| refusal.to_string())?;
        let begin = Instant::now();
        match self.drive(&mut simulation, scene.settings.step_size, |_, _, _| true) {
            Ending::Complete => Ok(begin.elapsed().as_secs_f64()),
            other => Err(format!("{}: {other:?}", self.label)),
        }
    }

    /// Makes the communication steps. After each, `look` gets the simulation, its number of macro steps and the time, s, and returns
    /// whether all values are finite.
    fn drive(&self, simulation: &mut Simulation, step: f64, mut look: impl FnMut(&Simulation, u64, f64) -> bool) -> Ending {
        let mut clock = Clock::new(0.0, None).expect("a start at 0");
        for span in &self.schedule {
            let span = &span.in_steps_of(step);
            let origin = clock.point();
            for i in 0..span.count {
                let point = if i == 0 { origin } else { origin + i as f64 * span.size };
                let plan = match clock.plan(point, span.size, step) {
                    Ok(plan) => plan,
                    Err(rejection) => return Ending::Refused(rejection.message),
                };
                if let Err(failure) = simulation.advance(&span.inputs, plan.h, plan.steps) {
                    return Ending::Status(failure.cause.to_string(), point + failure.elapsed);
                }
                clock.advance(plan);
                if !look(simulation, plan.steps, clock.point()) {
                    return Ending::NotFinite(clock.point());
                }
            }
        }
        Ending::Complete
    }

    fn follow(&self, simulation: &mut Simulation, step: f64, outcome: &mut Outcome, path: &mut Vec<Sample>) -> Ending {
        let unit = mgl(&self.parameters.geometry);
        let size = relative_size(&self.parameters.geometry);
        let mut sample = |simulation: &Simulation, time: f64| {
            if self.watch.needs_path() {
                path.push((time, observers::motion(simulation.model(), &simulation.state()).theta));
            }
        };
        sample(simulation, 0.0);
        let (mut peak, mut most_dissipated, mut largest): (f64, f64, f64) = (0.0, 0.0, 0.0);
        let mut before = simulation.state().core.counters.substeps;
        self.drive(simulation, step, |simulation, steps, time| {
            let core = &simulation.state().core;
            let sum: f64 = core.q.iter().chain(&core.v).chain(&core.a).chain(&core.lambda).sum();
            let energies = observers::energies(simulation.model(), &simulation.state());
            if !(sum + energies.error).is_finite() {
                return false;
            }
            let norms = observers::constraint_norms(simulation.model(), &simulation.state());
            peak = peak.max(energies.kinetic);
            outcome.joules = outcome.joules.max(energies.error.abs());
            let observers::Energies { kinetic, dissipated, input, .. } = energies;
            largest = largest.max(kinetic).max(dissipated).max(input.abs());
            most_dissipated = most_dissipated.max(dissipated);
            if dissipated < most_dissipated {
                outcome.taken_back = outcome.taken_back.max((most_dissipated - dissipated) / largest);
            }
            outcome.energy = outcome.joules / unit.max(self.kinetic_part * peak);
            outcome.position = outcome.position.max(norms.position / size);
            outcome.velocity = outcome.velocity.max(norms.velocity / size);
            if !(self.vertex_outputs && in_vertex(simulation)) {
                outcome.judged = [outcome.judged[0].max(norms.position / size), outcome.judged[1].max(norms.velocity / size)];
            }
            let taken = core.counters.substeps - before;
            before = core.counters.substeps;
            outcome.most = outcome.most.max(taken.div_ceil(steps));
            sample(simulation, time);
            true
        })
    }
}

fn in_vertex(simulation: &Simulation) -> bool {
    observers::singularity(simulation.model(), &simulation.state()).kind == observers::SingularityKind::Constraint
}
