//! Servo commands with the delay `servo.delay`: a drive reads, filters and passes on a reference before it acts.
//!
//! A reference acts `servo.delay` after the master has set it; until the first one acts, the reference of the start does. At the time of a
//! change the macro step is divided in two parts, and no step of an error-controlled method passes this time. References that change within
//! a call are delayed as polynomials and act, like all inputs, by their value at the middle of a macro step or of its part.
//!
//! All times count down to 0 and are reduced by each macro step in turn, so their bits do not depend on how calls group macro steps.

use std::collections::VecDeque;
use std::fmt;

use borsh::{BorshDeserialize, BorshSerialize};

use super::macro_steps::{FailureCause, MacroSteps, StepFailure};
use super::{Inputs, Model, Settings, Signal};
use crate::integrator::Inconsistency;

/// Room for waiting commands of a scene with long macro steps.
const LEAST_ROOM: usize = 64;
/// Largest room: 3.4 MB, and as much for the copy at the beginning of a call.
const MOST_ROOM: usize = 16_384;
/// Commands for each macro step within the delay: a master may set several within one.
const COMMANDS_PER_STEP: f64 = 4.0;
/// Further commands: the one being set, the end of its ramp, and one for round-off.
const EXTRA_ROOM: usize = 3;

/// Fraction of a macro step by which a command may begin to act too early or too late: it then begins at the end of the step. Sums of the
/// lengths of 100,000 steps of 1 µs, or of steps of 1 ms at times of 1e5 s, have errors of 1e-7 steps. A part as short as these errors would
/// be a step of round-off.
const ROUND_OFF: f64 = 1e-6;

/// A command that does not act yet.
#[derive(Clone, Copy, Debug, PartialEq, BorshSerialize, BorshDeserialize)]
struct Command {
    /// Time until the command acts, s.
    due: f64,
    /// References from then on; loads are 0.
    references: Signal,
}

/// Commands of a run with `servo.delay`.
#[derive(Debug, BorshSerialize, BorshDeserialize)]
pub(super) struct Commands {
    /// References that act; loads are 0.
    acting: Signal,
    /// Time since these references began to act, s.
    age: f64,
    /// Commands that do not act yet, in the order of their times.
    waiting: VecDeque<Command>,
    /// Copy of `waiting` at the beginning of a call, to go back to if the call fails. Allocated once, like `waiting`.
    #[borsh(skip)]
    before: VecDeque<Command>,
}

/// Compares the stored fields.
impl PartialEq for Commands {
    fn eq(&self, other: &Self) -> bool {
        let Self { acting, age, waiting, before: _ } = self;
        (acting, age, waiting) == (&other.acting, &other.age, &other.waiting)
    }
}

/// A copy has the room of the original, and a copy in place allocates nothing if it has that room already.
impl Clone for Commands {
    fn clone(&self) -> Self {
        let mut copy = Self { acting: self.acting, age: self.age, waiting: VecDeque::new(), before: VecDeque::new() };
        copy.clone_from(self);
        copy
    }

    fn clone_from(&mut self, other: &Self) {
        (self.acting, self.age) = (other.acting, other.age);
        self.reserve(other.waiting.capacity());
        self.waiting.clone_from(&other.waiting);
    }
}

/// Takes macro steps with constant inputs. A trait object, so that the library has one copy of its callers.
type Step<'a> = dyn FnMut(&Inputs, MacroSteps) -> Result<(), StepFailure> + 'a;

/// More commands wait than there is room for.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TooManyCommands {
    delay: Delay,
}

impl fmt::Display for TooManyCommands {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let (most, Delay { time, step }) = (self.delay.room(), self.delay);
        write!(
            f,
            "servo.theta or servo.omega have changed more than {most} times within servo.delay = {time:?} s, the limit for \
             solver.stepSize = {step:?} s: they must change less often"
        )
    }
}

/// Delay of a scene.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Delay {
    /// `servo.delay`, s.
    time: f64,
    /// `solver.stepSize`, s.
    step: f64,
}

impl Delay {
    /// Delay of a model; `None` if its references act at once.
    pub(super) fn of(model: &Model) -> Option<Self> {
        let Model { command_delay: time, settings: Settings { step_size: step, .. }, .. } = *model;
        (time > 0.0).then_some(Self { time, step })
    }

    /// Largest number of commands that may wait.
    fn room(self) -> usize {
        ((COMMANDS_PER_STEP * self.time / self.step).ceil() as usize + EXTRA_ROOM).clamp(LEAST_ROOM, MOST_ROOM)
    }
}

impl Commands {
    /// Commands of a run that starts with these inputs; `None` without a delay.
    pub(super) fn start(model: &Model, inputs: &Inputs) -> Option<Box<Self>> {
        Delay::of(model).map(|delay| {
            let acting = Signal::held(inputs.references());
            let mut commands = Self { acting, age: 0.0, waiting: VecDeque::new(), before: VecDeque::new() };
            commands.make_room(delay);
            Box::new(commands)
        })
    }

    /// Reserves the room of their scene for commands read from bytes.
    pub(super) fn make_room(&mut self, delay: Delay) {
        self.reserve(delay.room());
    }

    fn reserve(&mut self, room: usize) {
        for commands in [&mut self.waiting, &mut self.before] {
            commands.reserve(room.saturating_sub(commands.len()));
        }
    }

    /// The loads of these inputs with the references that act `later` seconds from now.
    pub(super) fn acting(&self, inputs: &Inputs, later: f64) -> Inputs {
        let due = self.waiting.partition_point(|command| command.due <= later);
        let references = match due.checked_sub(1).map(|newest| &self.waiting[newest]) {
            None => self.acting.at(self.age + later),
            Some(command) => command.references.at(later - command.due),
        };
        inputs.with_references(&references)
    }

    /// The inputs that act `later` seconds from now if the master leaves them at `inputs`, whose references begin to act after the delay.
    pub(super) fn expected(&self, delay: Delay, inputs: &Inputs, later: f64) -> Inputs {
        if later < delay.time { self.acting(inputs, later) } else { *inputs }
    }

    /// Makes `steps` macro steps of h seconds; the references of `signal` act after the delay. If `step` fails, the commands do not change.
    pub(super) fn over(
        &mut self,
        delay: Delay,
        signal: &Signal,
        (h, steps): (f64, u64),
        step: &mut Step<'_>,
    ) -> Result<(), StepFailure> {
        let (acting, age) = (self.acting, self.age);
        self.before.clone_from(&self.waiting);
        self.advance(delay, signal, (h, steps), step).inspect_err(|_| {
            (self.acting, self.age) = (acting, age);
            std::mem::swap(&mut self.waiting, &mut self.before);
        })
    }

    /// Makes macro steps. A failure leaves the commands undefined.
    fn advance(&mut self, delay: Delay, signal: &Signal, (h, steps): (f64, u64), step: &mut Step<'_>) -> Result<(), StepFailure> {
        let (references, rounded) = (signal.references(), ROUND_OFF * h);
        self.enqueue(delay, references)?;
        self.begin_due(rounded);
        for k in 0..steps {
            let begin = k as f64 * h;
            let is_held = signal.is_held() && self.acting.is_held();
            if is_held && self.waiting.is_empty() {
                let rest = MacroSteps { h, count: steps - k, open_ended: true, change: f64::INFINITY };
                return step(&self.acting(&signal.value, 0.0), rest).map_err(|failure| failure.after(begin));
            }
            let mut taken = 0.0;
            loop {
                let (left, due) = (h - taken, self.waiting.front().map_or(f64::INFINITY, |first| first.due));
                let part = if due < left - rounded { due } else { left };
                let change = if due <= part + rounded { part } else { due };
                let inputs = self.acting(&signal.at(begin + taken + part / 2.0), part / 2.0);
                let open_ended = signal.is_held() && self.acting.is_held();
                step(&inputs, MacroSteps { h: part, count: 1, open_ended, change })
                    .map_err(|failure| failure.after(begin + taken))?;
                self.pass(part, rounded);
                if part == left {
                    break;
                }
                taken += part;
            }
        }
        if !references.is_held() {
            self.enqueue(delay, Signal::held(references.at(steps as f64 * h)))?;
            self.begin_due(rounded);
        }
        Ok(())
    }

    /// Appends references to the queue, unless they equal the newest ones. They replace references of the same time. Refused if the queue
    /// has no room for them and the end of their ramp.
    fn enqueue(&mut self, delay: Delay, references: Signal) -> Result<(), StepFailure> {
        let newest = self.waiting.back().map_or(&self.acting, |last| &last.references);
        if *newest == references {
            return Ok(());
        }
        let same_time = self.waiting.pop_back_if(|last| last.due == delay.time).is_some();
        if !same_time && self.waiting.len() + 1 + usize::from(!references.is_held()) > delay.room() {
            return Err(StepFailure { elapsed: 0.0, cause: FailureCause::Commands(TooManyCommands { delay }) });
        }
        self.waiting.push_back(Command { due: delay.time, references });
        Ok(())
    }

    /// Advances the time, s, at most up to the next command.
    fn pass(&mut self, time: f64, rounded: f64) {
        // Constant references have no age, because an age would depend on how calls group macro steps.
        if !self.acting.is_held() {
            self.age += time;
        }
        self.waiting.iter_mut().for_each(|command| command.due -= time);
        self.begin_due(rounded);
    }

    /// Commands that are due begin to act.
    fn begin_due(&mut self, rounded: f64) {
        while let Some(first) = self.waiting.pop_front_if(|first| first.due <= rounded) {
            (self.acting, self.age) = (first.references, 0.0);
        }
    }

    /// Refuses stored commands that no run of the model can have.
    pub(super) fn check(&self, delay: Delay) -> Result<(), Inconsistency> {
        let Self { acting, age, waiting, before: _ } = self;
        if waiting.len() > delay.room() {
            return Err("more commands wait for servo.delay than there is room for");
        }
        let mut from = 0.0;
        for Command { due, .. } in waiting {
            if !(*due > from && *due <= delay.time) {
                return Err("the commands that wait for servo.delay are not in the order of their times");
            }
            from = *due;
        }
        if !(*age >= 0.0 && age.is_finite()) || acting.is_held() && *age != 0.0 {
            return Err("the age of a command is not valid");
        }
        // Each command acts from its beginning to the beginning of the next one; the last one has no end.
        let begins = std::iter::once((-age, acting)).chain(waiting.iter().map(|command| (command.due, &command.references)));
        let ends = waiting.iter().map(|command| Some(command.due)).chain([None]);
        let is_sound = |((begin, references), end): ((f64, &Signal), Option<f64>)| {
            references.references() == *references
                && references.value.are_finite()
                && end.map_or(references.is_held(), |end| references.at(end - begin).are_finite())
        };
        if begins.zip(ends).all(is_sound) { Ok(()) } else { Err("a command has values that no master can have set") }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::simulation::bindings::default_inputs;

    /// Lengths of the macro steps of 0.12 s at `begin` s, with a command every 10 ms; the times of the steps are rounded, as those of a master are.
    fn parts(delay: Delay, begin: f64) -> Vec<f64> {
        let mut commands =
            Commands { acting: Signal::held(default_inputs()), age: 0.0, waiting: VecDeque::new(), before: VecDeque::new() };
        let mut parts = Vec::new();
        for k in 0..(0.12 / delay.step).round() as u64 {
            let [from, to] = [k, k + 1].map(|k| begin + k as f64 * delay.step);
            let command = (k as f64 * delay.step / 0.01 + 1e-9).floor();
            let signal = Signal::held(Inputs { servo_theta: [command; 2], ..default_inputs() });
            let mut step = |_: &Inputs, steps: MacroSteps| {
                parts.push(steps.h);
                Ok(())
            };
            commands.over(delay, &signal, (to - from, 1), &mut step).expect("steps");
        }
        parts
    }

    /// Delays of whole macro steps split none of them, however many steps a delay has and however large the time is.
    #[test]
    fn whole_steps_are_not_split() {
        for (step, time, begin) in [
            (1e-6, 0.1, 0.0),
            (2e-6, 0.05, 0.0),
            (5e-6, 0.1, 0.0),
            (1e-6, 0.03, 0.0),
            (1e-6, 0.07, 0.0),
            (1e-3, 0.017, 1e5),
            (1.0 / 60.0, 2.0 / 60.0, 3e4),
        ] {
            let shortest = parts(Delay { time, step }, begin).into_iter().fold(f64::INFINITY, f64::min);
            // Round-off of the times.
            assert!(shortest > (1.0 - 1e-6) * step, "{step} s, {time} s: {shortest}");
        }
    }
}
