//! The log queue: calls add messages, the C interface passes them to the master's logger.
//!
//! Until fmi2SetDebugLogging is called, warnings, discards, errors and fatal errors are always passed on; events are too if loggingOn of
//! fmi2Instantiate is true. After that the master chooses: nothing, everything, or the categories that it names (FMI 2.0.4, section 2.1.5).

use super::CallError;
use crate::variables::Category;

/// fmi2Status (FMI 2.0.4, section 2.1.3) with its numbers, in the order of severity. fmi2Pending, 5, is missing: a step is never pending.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Status {
    /// Done.
    Ok = 0,
    /// Done, but the master has probably made a mistake.
    Warning = 1,
    /// Could not be done; nothing was changed.
    Discard = 2,
    /// Refused; nothing was changed.
    Error = 3,
    /// A defect of this library; the instance can only be freed.
    Fatal = 4,
}

impl Status {
    /// All statuses.
    const ALL: [Self; 5] = [Self::Ok, Self::Warning, Self::Discard, Self::Error, Self::Fatal];

    /// Category of a message with this status.
    pub fn category(self) -> Category {
        match self {
            Self::Ok => Category::LogEvents,
            Self::Warning => Category::LogStatusWarning,
            Self::Discard => Category::LogStatusDiscard,
            Self::Error => Category::LogStatusError,
            Self::Fatal => Category::LogStatusFatal,
        }
    }
}

/// A line for the master's log.
#[derive(Clone, Debug, PartialEq)]
pub struct Message {
    /// Severity; its category follows from it.
    pub status: Status,
    /// The finished text.
    pub text: String,
}

/// Messages on their way to the master.
#[derive(Debug)]
pub struct Log {
    /// Whether messages of each status are passed on.
    passes: [bool; Status::ALL.len()],
    queue: Vec<Message>,
}

impl Log {
    /// An empty queue; `logging_on` as passed to fmi2Instantiate.
    pub fn new(logging_on: bool) -> Self {
        Self { passes: Status::ALL.map(|status| logging_on || status > Status::Ok), queue: Vec::new() }
    }

    /// fmi2SetDebugLogging: no categories means all. Refuses an unknown category, and then changes nothing.
    pub fn choose<'a>(&mut self, on: bool, names: impl Iterator<Item = &'a str>) -> Result<(), CallError> {
        let mut chosen = Vec::new();
        for name in names {
            let category = Category::LIST.iter().find(|category| category.name() == name);
            chosen.push(*category.ok_or_else(|| {
                let declared: Vec<&str> = Category::LIST.iter().map(|category| category.name()).collect();
                CallError::error(format!("log category \"{name}\" is not declared, declared are: {}.", declared.join(", ")))
            })?);
        }
        let all = chosen.is_empty() || chosen.contains(&Category::LogAll);
        self.passes = Status::ALL.map(|status| on && (all || chosen.contains(&status.category())));
        Ok(())
    }

    /// Whether messages of this status are passed on.
    pub fn wants(&self, status: Status) -> bool {
        self.passes[status as usize]
    }

    /// Queues a message if its category is passed on; only then is the text made.
    pub fn push(&mut self, status: Status, text: impl FnOnce() -> String) {
        if self.wants(status) {
            self.queue.push(Message { status, text: text() });
        }
    }

    /// Whether the queue is empty.
    pub fn is_empty(&self) -> bool {
        self.queue.is_empty()
    }

    /// Takes the queued messages.
    pub fn drain(&mut self) -> impl Iterator<Item = Message> {
        self.queue.drain(..)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Statuses that the log passes on.
    fn passing(log: &mut Log) -> Vec<Status> {
        for status in Status::ALL {
            log.push(status, String::new);
        }
        log.drain().map(|message| message.status).collect()
    }

    #[test]
    fn by_default_problems_pass_and_events_only_on_demand() {
        assert_eq!(passing(&mut Log::new(false)), [Status::Warning, Status::Discard, Status::Error, Status::Fatal]);
        assert_eq!(passing(&mut Log::new(true)).len(), 5);
    }

    #[test]
    fn an_explicit_choice_rules() {
        let mut log = Log::new(true);
        log.choose(false, std::iter::empty()).expect("off");
        assert_eq!(passing(&mut log), []);
        log.choose(true, ["logEvents", "logStatusError"].into_iter()).expect("two");
        assert_eq!(passing(&mut log), [Status::Ok, Status::Error]);
        log.choose(true, ["logAll"].into_iter()).expect("all");
        assert_eq!(passing(&mut log).len(), 5);
        log.choose(true, std::iter::empty()).expect("all");
        assert_eq!(passing(&mut log).len(), 5);
    }

    #[test]
    fn an_unknown_category_is_refused_and_changes_nothing() {
        let mut log = Log::new(false);
        let refused = log.choose(true, ["logEvents", "logSql"].into_iter()).expect_err("logSql");
        assert!(refused.message.contains("\"logSql\" is not declared, declared are: logEvents, "), "{}", refused.message);
        assert_eq!(passing(&mut log).len(), 4);
    }
}
