//! What counts where an option is not given and the value follows from elsewhere: one table for help
//! texts and for `run --print-config`.

use clap::Command;

const STREAM: [(&str, &str); 3] = [("tier", "exact"), ("tolerance", "1e-6"), ("filter", "off")];

const RECORDED: [(&str, &str); 4] = [
    ("tier", "as recorded, else exact"),
    ("tolerance", "as recorded, else 1e-6"),
    ("filter", "as recorded, else off"),
    ("calibration", "as recorded, else the tolerances of the scene"),
];

const TOLERANCES: (&str, &str) = ("calibration", "the tolerances of the scene, if it has any");

const LOOKED_AT: (&str, &str) = ("format", "summary on a terminal, else ndjson");

const TOOL: [(&str, &str); 2] = [("trajectory", "smooth"), ("seed", "1")];

/// Options of a verb, and their defaults. A value has no spaces; anything else is a rule.
fn of_verb(verb: &str) -> Vec<(&'static str, &'static str)> {
    match verb {
        "run" => [&STREAM[..], &TOOL, &[LOOKED_AT, ("speed", "1")], &RUN].concat(),
        "replay" => [&RECORDED[..], &[LOOKED_AT, ("speed", "max; with --live 1")]].concat(),
        "export" => [&RECORDED[..], &[("format", "by the ending of --output")]].concat(),
        "simulate" => [&STREAM[..2], &TOOL, &[TOLERANCES]].concat(),
        "model" => vec![("tier", "exact"), ("tolerance", "1e-10"), ("calibration", "none")],
        "solve" => [&STREAM[..2], &[TOLERANCES]].concat(),
        "report" => vec![("poses", "1000, quick: 100")],
        "doctor" => vec![("scene", "the one the board belongs to")],
        _ => Vec::new(),
    }
}

const RUN: [(&str, &str); 3] = [
    ("calibration", "the tolerances of the scene, or usual ones; of a simulated board none"),
    ("patience", "forever; with --duration not at all"),
    ("config", "~/.config/slitpose/config.toml or /etc/slitpose/config.toml, if there is one"),
];

/// The default of `option` of `verb`, if it has one.
pub(super) fn of(verb: &str, option: &str) -> Option<&'static str> {
    of_verb(verb).into_iter().find(|(id, _)| *id == option).map(|(_, default)| default)
}

/// Adds the default to the help of each option.
pub(super) fn in_help(command: Command) -> Command {
    command.mut_subcommands(|verb| {
        of_verb(verb.get_name()).into_iter().fold(verb, |verb, (option, default)| {
            verb.mut_arg(option, |arg| {
                let help = arg.get_help().map(ToString::to_string).unwrap_or_default();
                let stop = if help.is_empty() { "" } else { " " };
                arg.help(format!("{help}{stop}[default: {default}]"))
            })
        })
    })
}

#[cfg(test)]
mod tests {
    use super::super::{command, model, options, solve};
    use super::*;

    #[test]
    fn tolerances_are_those_in_use() {
        for (verb, tolerance) in [
            ("run", options::DEFAULT_TOLERANCE),
            ("simulate", options::DEFAULT_TOLERANCE),
            ("solve", solve::DEFAULT_TOLERANCE),
            ("model", model::DEFAULT_TOLERANCE),
        ] {
            assert_eq!(of(verb, "tolerance").unwrap().parse(), Ok(tolerance), "{verb}");
        }
        assert!(of("replay", "tolerance").unwrap().ends_with(of("run", "tolerance").unwrap()));
    }

    #[test]
    fn every_option_is_there_and_its_help_says_so() {
        for verb in command().get_subcommands() {
            for (option, default) in of_verb(verb.get_name()) {
                let arg = verb.get_arguments().find(|arg| arg.get_id() == option);
                let arg = arg.unwrap_or_else(|| panic!("{} has no --{option}", verb.get_name()));
                let help = arg.get_help().unwrap().to_string();
                assert_eq!(help.matches("[default: ").count(), 1, "{option}: {help}");
                assert!(help.ends_with(&format!("[default: {default}]")), "{option}: {help}");
                assert!(arg.get_default_values().is_empty(), "{option} has two defaults");
            }
        }
    }
}
