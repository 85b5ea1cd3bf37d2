//! The method's parameters as flags, made from its table.

use clap::{Arg, ArgAction, ArgMatches, Command};

use crate::centerline::{
    POINTS, ParameterError, ParameterKind, ParameterSpec, Parameters, PointsSpec, Preset, TABLE,
};

/// A flag for the preset and one for each row of [`TABLE`] and [`POINTS`], under the paper's names.
#[derive(Debug, Clone, Default)]
pub(super) struct ParameterArgs {
    preset: Option<String>,
    values: Vec<(&'static str, String)>,
}

impl ParameterArgs {
    /// The preset's values with those of the flags over them.
    ///
    /// # Errors
    /// [`ParameterError`] for a value that the table does not allow.
    pub fn parameters(&self) -> Result<Parameters, ParameterError> {
        let preset = self.preset.as_deref().map(str::parse::<Preset>).transpose()?;
        let mut parameters = Parameters::of(preset.unwrap_or_default());
        for (name, value) in &self.values {
            parameters.set(name, value)?;
        }
        Ok(parameters)
    }
}

impl clap::FromArgMatches for ParameterArgs {
    fn from_arg_matches(matches: &ArgMatches) -> Result<Self, clap::Error> {
        let mut args = Self::default();
        args.update_from_arg_matches(matches)?;
        Ok(args)
    }

    fn update_from_arg_matches(&mut self, matches: &ArgMatches) -> Result<(), clap::Error> {
        self.preset = matches.get_one::<String>("preset").cloned();
        let given = |spec: &ParameterSpec| Some((spec.name, matches.get_one::<String>(spec.name)?.clone()));
        self.values = TABLE.iter().filter_map(given).collect();
        for spec in POINTS {
            let points = matches.get_many::<String>(spec.name).unwrap_or_default();
            self.values.extend(points.map(|point| (spec.name, point.clone())));
        }
        Ok(())
    }
}

impl clap::Args for ParameterArgs {
    fn augment_args(command: Command) -> Command {
        let preset = Arg::new("preset")
            .long("preset")
            .value_name("PRESET")
            .help("default: scaled to the local radius; paper: the printed constants and formulas")
            .help_heading(HEADING)
            .value_parser(Preset::NAMES);
        command.arg(preset).args(TABLE.iter().map(flag)).args(POINTS.iter().map(points_flag))
    }

    fn augment_args_for_update(command: Command) -> Command {
        Self::augment_args(command)
    }
}

const HEADING: &str = "Parameters of the method";

fn flag(spec: &ParameterSpec) -> Arg {
    let arg = Arg::new(spec.name).long(spec.name).help(help(spec)).help_heading(HEADING);
    match spec.kind {
        ParameterKind::Number { .. } => arg.value_name("NUMBER").allow_negative_numbers(true),
        ParameterKind::Flag => {
            arg.value_name("BOOL").num_args(0..=1).require_equals(true).default_missing_value("true")
        }
    }
}

fn points_flag(spec: &PointsSpec) -> Arg {
    let often = if spec.most > 1 { "; give it once a point" } else { "" };
    let help = format!("{}, in the mesh's coordinates{often}", spec.doc);
    let action = if spec.most > 1 { ArgAction::Append } else { ArgAction::Set };
    let arg = Arg::new(spec.name).long(spec.name).value_name("X,Y,Z").help(help).help_heading(HEADING);
    // A negative coordinate looks like a flag.
    arg.action(action).allow_hyphen_values(true)
}

fn help(spec: &ParameterSpec) -> String {
    let value = |value: f64| match spec.kind {
        ParameterKind::Number { .. } => value.to_string(),
        ParameterKind::Flag => (value != 0.0).to_string(),
    };
    let mut facts = match spec.kind {
        ParameterKind::Number { min, max } => format!("unit: {}; {min} to {max}; ", spec.unit),
        ParameterKind::Flag => String::new(),
    };
    facts += &match spec.default {
        None => format!("default: {}; preset paper only", value(spec.paper)),
        Some(default) if default == spec.paper => format!("default: {}", value(default)),
        Some(default) => format!("default: {}; paper: {}", value(default), value(spec.paper)),
    };
    format!("{} [{facts}]", spec.doc)
}

#[cfg(test)]
mod tests {
    use clap::{Args as _, FromArgMatches as _};

    use super::*;

    fn parse(words: &[&str]) -> Result<ParameterArgs, clap::Error> {
        let command = ParameterArgs::augment_args(Command::new("test").no_binary_name(true));
        ParameterArgs::from_arg_matches(&command.try_get_matches_from(words)?)
    }

    #[test]
    fn every_row_of_the_table_is_a_flag_with_its_unit_range_and_default() {
        let mut command = ParameterArgs::augment_args(Command::new("test").term_width(0));
        let help = command.render_long_help().to_string();
        for spec in TABLE {
            assert!(help.contains(&format!("--{}", spec.name)), "{}", spec.name);
            assert!(help.contains(spec.doc), "{}", spec.name);
        }
        assert!(help.contains("unit: diagonal; 0.0005 to 0.2; default: 0.025; preset paper only"), "{help}");
    }

    #[test]
    fn flags_set_parameters_over_the_preset() {
        let args = parse(&["--preset", "paper", "--omega=0.8", "--d_cut", "0.05", "--smoothing"]).unwrap();
        let parameters = args.parameters().unwrap();
        assert_eq!(parameters.preset(), Preset::Paper);
        assert_eq!((parameters.omega(), parameters.d_cut()), (0.8, 0.05));
        assert!(parameters.smoothing());
        assert_eq!(parse(&[]).unwrap().parameters().unwrap(), Parameters::default());
        assert!(!parse(&["--smoothing=false"]).unwrap().parameters().unwrap().smoothing());
    }

    #[test]
    fn points_are_given_once_each() {
        let args = parse(&["--include", "-1,2,3", "--include=4,5,6", "--root", "-7,-8,-9"]).unwrap();
        let parameters = args.parameters().unwrap();
        assert_eq!(parameters.include().len(), 2);
        assert_eq!((parameters.include()[0].x, parameters.root().unwrap().z), (-1.0, -9.0));
        assert!(parse(&["--root", "1,2,3", "--root", "1,2,3"]).is_err());
        assert!(parse(&["--exclude", "1,2"]).unwrap().parameters().is_err());
    }

    #[test]
    fn values_outside_the_table_are_refused() {
        let error = parse(&["--mu", "7"]).unwrap().parameters().unwrap_err();
        assert!(error.to_string().contains("0.05 to 0.95"), "{error}");
        assert!(parse(&["--omega=-1"]).unwrap().parameters().is_err());
        assert!(parse(&["--preset", "other"]).is_err());
        assert!(parse(&["--nothing", "1"]).is_err());
    }
}
