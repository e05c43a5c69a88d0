//! `slitpose faults`, and the faults that a command injects.

use std::fmt::Write as _;

use super::{CommandError, Outcome, options, talk};
use slitpose_head::faults::{Fault, KINDS, Lasts};

/// Lists the faults that `--fault` injects into simulated boards and replayed captures.
///
/// Each line shows a fault as it is typed, what it does, and what is seen of it: the status of poses, the health of
/// the head, counts, and an exit code other than 0. With the name of a fault it says all about it.
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:\n  slitpose faults\n  slitpose faults occlude\n  \
                        slitpose run --device sim --duration 3s --fault occlude:cell=2,from=1s,for=500ms\n  \
                        slitpose replay contact.mcap --fault flip:rate=1e-5 --fault noisy:cell=1")]
pub(super) struct Args {
    /// One fault
    #[arg(value_name = "KIND", value_parser = KINDS.map(|kind| kind.name), hide_possible_values = true)]
    kind: Option<String>,
}

/// Faults for one board.
#[derive(clap::Args, Clone, Debug)]
pub(super) struct FaultOptions {
    /// Inject a fault, KIND:KEY=VALUE,… such as occlude:cell=2,from=1s,for=500ms; `slitpose faults` lists them. Times
    /// are device time from the first scan on; seed=N draws other random numbers. Once for each fault
    #[arg(long, value_name = "SPEC", value_parser = str::parse::<Fault>)]
    pub(super) fault: Vec<Fault>,
}

impl FaultOptions {
    /// The name of the option, if it was given.
    pub(super) fn given(&self) -> Option<&'static str> {
        (!self.fault.is_empty()).then_some("--fault")
    }

    /// Says that faults are injected, if any are.
    pub(super) fn tell(&self) {
        let texts: Vec<_> = self.fault.iter().map(ToString::to_string).collect();
        if !texts.is_empty() {
            talk(format_args!("faults are injected: {}", texts.join(" ")));
        }
    }
}

pub(super) fn run(args: &Args) -> Result<Outcome, CommandError> {
    let mut text = String::new();
    let mut layer = None;
    for kind in KINDS.iter().filter(|kind| args.kind.as_deref().is_none_or(|name| name == kind.name)) {
        if layer.replace(kind.layer) != Some(kind.layer) && args.kind.is_none() {
            let gap = if text.is_empty() { "" } else { "\n" };
            // A string takes everything.
            let _ = writeln!(text, "{gap}{}:", kind.layer.title());
        }
        let exit = if kind.exit == 0 { String::new() } else { format!("; exit code {}", kind.exit) };
        let _ = writeln!(text, "{:<40} {}\n{:<40} -> {}{exit}", kind.example, kind.what, "", kind.sees);
        if args.kind.is_none() {
            continue;
        }
        for key in kind.keys {
            let default = key.default.map_or("needed".to_owned(), |default| format!("default {default}"));
            let _ = writeln!(text, "  {:<8} {}; {default}", key.name, key.unit.example());
        }
        let _ = writeln!(text, "  {:<8} device time of its begin, from the first scan on; default 0s", "from");
        let lasts = match kind.lasts {
            Lasts::Instant => None,
            Lasts::ToTheEnd => Some("to the end"),
            Lasts::For(time) => Some(time),
        };
        if let Some(lasts) = lasts {
            let _ = writeln!(text, "  {:<8} how long it lasts; default {lasts}", "for");
        }
        let _ = writeln!(text, "  {:<8} time from one begin to the next; default: it begins once", "every");
        let _ = writeln!(text, "  {:<8} of its random numbers; default 1", "seed");
        for (place, reason) in [("replay", kind.not_in_recordings()), ("simulate", kind.not_in_simulate())] {
            if let Some(reason) = reason {
                let _ = writeln!(text, "not in {place}: {reason}");
            }
        }
    }
    options::print(&text)
}
