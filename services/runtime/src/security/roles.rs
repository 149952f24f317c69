//! Rights of each role to publish, answer and query. Every identity of a cell may read everything
//! in it.

/// One role. Keys are relative to the cell's namespace.
#[derive(Clone, Copy, Debug)]
pub struct Role {
    /// First part of the identity.
    pub name: &'static str,
    /// Whether it applies to all cells of the fleet, not to one.
    pub fleet: bool,
    /// Services that it consists of.
    pub services: &'static [Service],
    /// Description, one sentence.
    pub words: &'static str,
}

/// Rights of one service on the network.
#[derive(Clone, Copy, Debug)]
pub struct Service {
    /// Name in `health/NAME`, `alive/NAME/*` and `param/NAME/*`; empty for people, who have none of
    /// these.
    pub name: &'static str,
    /// Topics it publishes besides its health.
    pub publishes: &'static [&'static str],
    /// Queries it answers besides those for its parameters.
    pub answers: &'static [&'static str],
    /// Queries it may send.
    pub asks: &'static [&'static str],
    /// Liveliness tokens it holds besides its own.
    pub tokens: &'static [&'static str],
}

/// What a service sends to a cell for people.
const COMMANDS: &[&str] = &[
    "control/task",
    "control/stop",
    "control/select",
    "netft/tare",
];

const RTDE: Service = Service {
    name: "rtde",
    publishes: &["arm/state", "arm/wrench"],
    answers: &["rtde/*"],
    asks: &[],
    tokens: &[],
};
/// A Franka has no separate sensor: its bridge publishes the wrench, and sets its zero.
const FRANKA: Service = Service {
    name: "franka",
    publishes: &["arm/state", "wrench/*"],
    answers: &["franka/*", "netft/*"],
    asks: &[],
    tokens: &[],
};
/// The only service that publishes `arm/command`.
const CONTROLLER: Service = Service {
    name: "controller",
    publishes: &[
        "arm/command",
        "control/state",
        "control/shaping",
        "control/coverage",
        "tf",
        "tf_static",
        "joint_states",
        "robot_description",
        "markers",
    ],
    answers: &["control/*"],
    asks: &["netft/tare"],
    tokens: &[],
};
const NETFT: Service = Service {
    name: "netft",
    publishes: &["wrench/*"],
    answers: &["netft/*"],
    asks: &[],
    tokens: &[],
};
const ESTIMATOR: Service = Service {
    name: "estimator",
    publishes: &["estimate/**"],
    answers: &[],
    asks: &[],
    tokens: &["alive/estimate/*/*"],
};
const CAMERA: Service = Service {
    name: "camera",
    publishes: &["camera/*"],
    answers: &[],
    asks: &[],
    tokens: &[],
};
/// A bridge from ROS 2. What it uses of these rights is set in the cell file.
const ROS2: Service = Service {
    name: "ros2",
    publishes: &["base/pose", "ros2/**"],
    answers: &[],
    asks: COMMANDS,
    tokens: &[],
};
const RECORDER: Service = Service {
    name: "recorder",
    publishes: &[],
    answers: &[],
    asks: &["control/show", "parameters/*", "history/**"],
    tokens: &[],
};
/// Reads for viewers that do not speak the bus's protocol.
const FOXGLOVE: Service = Service {
    name: "foxglove",
    publishes: &[],
    answers: &[],
    asks: &[],
    tokens: &[],
};
/// The operator's page: sends what the people with a token ask for, and says so. It also asks for
/// the arm to be guided by hand.
const UI: Service = Service {
    name: "ui",
    publishes: &["operator/command"],
    answers: &[],
    asks: &[
        "control/task",
        "control/stop",
        "control/select",
        "netft/tare",
        "control/show",
        "rtde/guide",
        "franka/guide",
    ],
    tokens: &[],
};
const SIMULATOR: Service = Service {
    name: "simulator",
    publishes: &["truth/**", "simulator/*"],
    answers: &[],
    asks: &[],
    tokens: &[],
};
/// The platform under the arm, or a bridge from its odometry to the bus.
const BASE: Service = Service {
    name: "",
    publishes: &["base/pose"],
    answers: &[],
    asks: &[],
    tokens: &[],
};
const OPERATOR: Service = Service {
    name: "",
    publishes: &[],
    answers: &[],
    asks: &[
        "control/*",
        "netft/*",
        "rtde/*",
        "franka/*",
        "param/*/*",
        "parameters/*",
        "ping/*/*",
    ],
    tokens: &[],
};
const VIEWER: Service = Service {
    name: "",
    publishes: &[],
    answers: &[],
    asks: &["ping/*/*"],
    tokens: &[],
};

/// Every role.
pub const ROLES: &[Role] = &[
    cell(
        "robot",
        &[RTDE, CONTROLLER, NETFT],
        "the hard loop in one process: rtde, controller and netft",
    ),
    cell(
        "franka_robot",
        &[FRANKA, CONTROLLER],
        "the hard loop of a Franka in one process: franka and controller",
    ),
    cell("rtde", &[RTDE], "the robot bridge alone"),
    cell("franka", &[FRANKA], "the bridge to a Franka alone"),
    cell(
        "controller",
        &[CONTROLLER],
        "the controller alone; beside it only `robot` and `franka_robot` may publish arm/command",
    ),
    cell("netft", &[NETFT], "the sensor bridge alone"),
    cell("estimator", &[ESTIMATOR], "estimators, on any machine"),
    cell("camera", &[CAMERA], "the camera on the wrist"),
    cell(
        "foxglove",
        &[FOXGLOVE],
        "the server for live viewers; reads only",
    ),
    cell(
        "ui",
        &[UI],
        "the operator's page; it may send tasks, stops, tares and the choice of the estimator, and make the arm free \
         to be moved by hand",
    ),
    cell("simulator", &[SIMULATOR], "the simulated robot and sensor"),
    cell(
        "base",
        &[BASE],
        "the mobile platform under the arm; beside it only `ros2` may publish base/pose",
    ),
    cell(
        "ros2",
        &[ROS2],
        "the bridge to ROS 2; it may publish base/pose and ros2/**, and send tasks",
    ),
    fleet(
        "recorder",
        &[RECORDER],
        "reads; queries the task, the parameters and missed messages, to store them",
    ),
    fleet(
        "operator",
        &[OPERATOR],
        "tasks, tare, parameters; publishes nothing",
    ),
    fleet("viewer", &[VIEWER], "reads only"),
];

/// Identity of the router, which applies the rules and is not subject to them.
pub const ROUTER: &str = "router";

const fn cell(name: &'static str, services: &'static [Service], words: &'static str) -> Role {
    Role {
        name,
        fleet: false,
        services,
        words,
    }
}

const fn fleet(name: &'static str, services: &'static [Service], words: &'static str) -> Role {
    Role {
        name,
        fleet: true,
        services,
        words,
    }
}

/// Identity `ROLE.CELL`, or `ROLE` for a role of the fleet and for the router.
pub fn identity(role: &str, cell: &str) -> String {
    match ROLES.iter().find(|known| known.name == role) {
        Some(known) if !known.fleet => format!("{role}.{cell}"),
        _ => role.to_owned(),
    }
}

/// Role and cell of an identity: `ROLE.CELL`, or `ROLE` for the whole fleet. `ROLE-NAME` in place
/// of `ROLE` is one of several holders, for instance `estimator-laptop2.cell1` or `operator-anna`,
/// with the rights of the role and a key of its own.
pub fn parse(identity: &str) -> Option<(&'static Role, Option<&str>)> {
    let (words, cell) = match identity.split_once('.') {
        Some((words, cell)) => (words, Some(cell)),
        None => (identity, None),
    };
    let name = words.split_once('-').map_or(words, |(role, _)| role);
    let role = ROLES.iter().find(|role| role.name == name)?;
    (role.fleet == cell.is_none()).then_some((role, cell))
}

/// All identities of a fleet of these cells, the router's first.
pub fn identities(cells: &[String]) -> Vec<String> {
    let mut all = vec![ROUTER.to_owned()];
    all.extend(
        ROLES
            .iter()
            .filter(|role| role.fleet)
            .map(|role| role.name.to_owned()),
    );
    for cell in cells {
        all.extend(
            ROLES
                .iter()
                .filter(|role| !role.fleet)
                .map(|role| identity(role.name, cell)),
        );
    }
    all
}

/// The role of a process that runs these services; `None` when no single role covers them.
pub fn role_of(services: &[&str]) -> Option<&'static str> {
    if services.contains(&ROUTER) {
        return Some(ROUTER);
    }
    let covers = |role: &&Role| {
        services
            .iter()
            .all(|wanted| role.services.iter().any(|service| service.name == *wanted))
    };
    let fitting = ROLES.iter().filter(covers);
    // Of several roles, the one with the fewest services.
    fitting
        .min_by_key(|role| role.services.len())
        .filter(|_| !services.is_empty())
        .map(|role| role.name)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn identities_name_role_and_cell() {
        assert_eq!(identity("controller", "cell1"), "controller.cell1");
        assert_eq!(identity("operator", "cell1"), "operator");
        let all = identities(&["a".into(), "b".into()]);
        assert_eq!(all[0], "router");
        assert!(all.contains(&"rtde.b".to_owned()));
        assert_eq!(all.iter().filter(|name| *name == "operator").count(), 1);
    }

    #[test]
    fn one_holder_of_several_has_the_rights_of_the_role() {
        let parsed = |identity| parse(identity).map(|(role, cell)| (role.name, cell));
        assert_eq!(
            parsed("estimator-lab-2.cell-1"),
            Some(("estimator", Some("cell-1")))
        );
        assert_eq!(parsed("controller.a"), Some(("controller", Some("a"))));
        assert_eq!(parsed("operator-anna"), Some(("operator", None)));
        assert_eq!(parsed("franka_robot.a"), Some(("franka_robot", Some("a"))));
        for nobody in ["router", "estimator", "operator.a", "anna", "robot2.a", ""] {
            assert_eq!(parsed(nobody), None, "{nobody}");
        }
    }

    #[test]
    fn a_process_gets_the_least_role_that_covers_it() {
        assert_eq!(role_of(&["controller"]), Some("controller"));
        assert_eq!(role_of(&["rtde", "controller"]), Some("robot"));
        assert_eq!(role_of(&["franka", "controller"]), Some("franka_robot"));
        assert_eq!(role_of(&["router", "simulator"]), Some("router"));
        assert_eq!(role_of(&["recorder"]), Some("recorder"));
        assert_eq!(role_of(&["recorder", "controller"]), None);
        assert_eq!(role_of(&[]), None);
    }

    #[test]
    fn only_controllers_command_and_only_operators_their_page_and_the_bridge_to_ros_send_tasks() {
        for role in ROLES {
            let commands = role
                .services
                .iter()
                .any(|s| s.publishes.contains(&"arm/command"));
            assert_eq!(
                commands,
                ["controller", "robot", "franka_robot"].contains(&role.name),
                "{}",
                role.name
            );
            let moves_base = role
                .services
                .iter()
                .any(|s| s.publishes.contains(&"base/pose"));
            let bridges = role.name == "ros2";
            assert_eq!(moves_base, role.name == "base" || bridges, "{}", role.name);
            let tasks = role
                .services
                .iter()
                .any(|s| s.asks.contains(&"control/*") || s.asks.contains(&"control/task"));
            let sends_for_people = ["operator", "ui"].contains(&role.name);
            assert_eq!(tasks, sends_for_people || bridges, "{}", role.name);
        }
    }
}
