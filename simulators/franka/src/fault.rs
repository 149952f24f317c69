//! Faults of the simulated Franka.

/// One fault.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum FciFault {
    /// The external activation device is pressed, or released.
    UserStop(bool),
    /// A hand guides the arm, or releases it.
    Guiding(bool),
    /// An external force pushes the tool: force at its origin, base axes, N.
    Push([f64; 3]),
    /// The robot does not send the next states; their number.
    DropStates(u32),
    /// The next answers do not arrive; their number.
    DropAnswers(u32),
    /// The robot neither sends nor receives for this time, s.
    Freeze(f64),
    /// The connection is cut.
    Disconnect,
}

/// A fault request that cannot be parsed.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error(
    "fault {name} with \"{argument}\" is not known: user_stop on|off, guiding on|off, push X,Y,Z (N), drop_states N, drop_answers N, \
     freeze S, disconnect"
)]
pub struct BadFault {
    name: String,
    argument: String,
}

impl FciFault {
    /// Parses name and argument of a query.
    ///
    /// # Errors
    /// [`BadFault`], which lists the known faults.
    pub fn parse(name: &str, argument: &str) -> Result<Self, BadFault> {
        let argument = argument.trim();
        let on = match argument {
            "on" | "true" | "1" | "" => Some(true),
            "off" | "false" | "0" => Some(false),
            _ => None,
        };
        let force = || {
            let numbers: Option<Vec<f64>> = argument
                .split(',')
                .map(|word| word.trim().parse().ok().filter(|x: &f64| x.abs() <= 1000.0))
                .collect();
            <[f64; 3]>::try_from(numbers?).ok()
        };
        let found = match name {
            "user_stop" => on.map(Self::UserStop),
            "guiding" => on.map(Self::Guiding),
            "push" => force().map(Self::Push),
            "drop_states" => argument.parse().ok().map(Self::DropStates),
            "drop_answers" => argument.parse().ok().map(Self::DropAnswers),
            "freeze" => argument
                .parse()
                .ok()
                .filter(|s| (0.0..=3600.0).contains(s))
                .map(Self::Freeze),
            "disconnect" => Some(Self::Disconnect),
            _ => None,
        };
        found.ok_or_else(|| BadFault {
            name: name.to_owned(),
            argument: argument.to_owned(),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn texts_become_faults_or_list_the_known_ones() {
        assert_eq!(
            FciFault::parse("push", "0, 0,-80"),
            Ok(FciFault::Push([0.0, 0.0, -80.0]))
        );
        assert_eq!(
            FciFault::parse("user_stop", "off"),
            Ok(FciFault::UserStop(false))
        );
        for (name, argument) in [
            ("push", "1,2"),
            ("freeze", "nan"),
            ("drop_states", "-1"),
            ("x", ""),
        ] {
            let said = FciFault::parse(name, argument).unwrap_err().to_string();
            assert!(said.contains("user_stop on|off"), "{said}");
        }
    }
}
