//! Access rules of the router in Zenoh's form: everything is denied except what a role needs.
//!
//! Zenoh's rules are by message and direction. Messages from a session are the router's ingress;
//! messages to it are the router's egress. A rule applies to a message if one of its key
//! expressions includes that of the message.

use serde_json::{Value, json};

use super::fleet::Fleet;
use super::roles::{self, Role};

/// Declarations and queries, besides data, of any identity that may read a cell.
const READING: [&str; 3] = [
    "declare_subscriber",
    "liveliness_query",
    "declare_liveliness_subscriber",
];

/// The rules as a file that a person can read too, with one rule per line.
pub fn text(fleet: &Fleet) -> String {
    let rules = rules(fleet);
    let lines = |what: &str| {
        let items = rules["access_control"][what].as_array();
        let items: Vec<String> = items
            .into_iter()
            .flatten()
            .map(|item| format!("      {item},\n"))
            .collect();
        format!("    {what}: [\n{}    ],\n", items.concat())
    };
    format!(
        "// Access rules for the network of: {}. Written by `tangent keys new`; see docs/security.md.\n\
         // Zenoh reads this file when the router starts. All that no rule allows is denied.\n\
         {{\n  access_control: {{\n    enabled: true,\n    default_permission: \"deny\",\n{}{}{}  }},\n}}\n",
        fleet.cells.join(", "),
        lines("rules"),
        lines("subjects"),
        lines("policies"),
    )
}

/// Rules for a router of this fleet: an object with Zenoh's `access_control`. A revoked identity is
/// in no rule, so that everything is denied to it.
pub fn rules(fleet: &Fleet) -> Value {
    let mut table = Table::default();
    let identities = fleet.identities();
    for role in roles::ROLES {
        for identity in &identities {
            if let Some((of, cell)) = roles::parse(identity)
                && of.name == role.name
            {
                // A role of the fleet has access to all cells, which is any one name; a role of a
                // cell only to that cell.
                table.add(role, cell.unwrap_or("*"), identity);
            }
        }
    }
    json!({
        "access_control": {
            "enabled": true,
            "default_permission": "deny",
            "rules": table.rules,
            "subjects": table.subjects,
            "policies": table.policies,
        }
    })
}

#[derive(Default)]
struct Table {
    rules: Vec<Value>,
    subjects: Vec<Value>,
    policies: Vec<Value>,
}

impl Table {
    fn add(&mut self, role: &Role, cell: &str, identity: &str) {
        let mut names = Vec::new();
        let everything = vec![format!("{cell}/**")];
        let mut publishes = Vec::new();
        let mut answers = Vec::new();
        let mut asks = Vec::new();
        let mut tokens = Vec::new();
        for service in role.services {
            let key = |key: &&str| format!("{cell}/{key}");
            publishes.extend(service.publishes.iter().map(key));
            // An identity that may publish a key may also resend its messages.
            let again = |key: &&str| format!("{cell}/history/{key}");
            answers.extend(service.publishes.iter().map(again));
            answers.extend(service.answers.iter().map(key));
            asks.extend(service.asks.iter().map(key));
            tokens.extend(service.tokens.iter().map(key));
            if !service.name.is_empty() {
                publishes.push(format!("{cell}/health/{}", service.name));
                answers.push(format!("{cell}/history/health/{}", service.name));
                answers.push(format!("{cell}/param/{}/*", service.name));
                answers.push(format!("{cell}/parameters/{}", service.name));
                answers.push(format!("{cell}/ping/{}/*", service.name));
                tokens.push(format!("{cell}/alive/{}/*", service.name));
            }
        }
        let mut rule = |what: &str, flow: &str, messages: &[&str], keys: &[String]| {
            if keys.is_empty() {
                return;
            }
            let id = format!("{identity}: {what}");
            self.rules.push(json!({
                "id": id,
                "permission": "allow",
                "flows": [flow],
                "messages": messages,
                "key_exprs": keys,
            }));
            names.push(id);
        };
        rule("reads", "ingress", &READING, &everything);
        rule(
            "is sent",
            "egress",
            &["put", "delete", "reply", "liveliness_token"],
            &everything,
        );
        rule("publishes", "ingress", &["put"], &publishes);
        rule("is alive", "ingress", &["liveliness_token"], &tokens);
        rule(
            "answers",
            "ingress",
            &["declare_queryable", "reply"],
            &answers,
        );
        rule("asks", "ingress", &["query"], &asks);
        if !publishes.is_empty() {
            // A session must know the readers of its topics, or it would publish nothing.
            rule("learns of readers", "egress", &READING, &everything);
        }
        if !answers.is_empty() {
            rule("is asked", "egress", &["query"], &everything);
        }
        if !asks.is_empty() {
            rule(
                "learns of queryables",
                "egress",
                &["declare_queryable"],
                &everything,
            );
        }
        self.subjects
            .push(json!({ "id": identity, "cert_common_names": [identity] }));
        self.policies
            .push(json!({ "rules": names, "subjects": [identity] }));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Evaluates the rules themselves: `true` if some rule of the identity allows the message.
    fn allowed(rules: &Value, identity: &str, flow: &str, message: &str, key: &str) -> bool {
        let list = |value: &Value, what: &str| -> Vec<String> {
            value[what]
                .as_array()
                .unwrap()
                .iter()
                .map(|v| v.as_str().unwrap().to_owned())
                .collect()
        };
        let acl = &rules["access_control"];
        let names: Vec<String> = acl["policies"]
            .as_array()
            .unwrap()
            .iter()
            .filter(|policy| list(policy, "subjects").contains(&identity.to_owned()))
            .flat_map(|policy| list(policy, "rules"))
            .collect();
        let key = zenoh::key_expr::KeyExpr::try_from(key).unwrap();
        acl["rules"].as_array().unwrap().iter().any(|rule| {
            names.contains(&rule["id"].as_str().unwrap().to_owned())
                && list(rule, "flows").contains(&flow.to_owned())
                && list(rule, "messages").contains(&message.to_owned())
                && list(rule, "key_exprs").iter().any(|allowed| {
                    zenoh::key_expr::KeyExpr::try_from(allowed.as_str())
                        .unwrap()
                        .includes(&key)
                })
        })
    }

    #[test]
    fn an_identity_may_do_its_own_and_nothing_else() {
        let rules = rules(&Fleet::of(&["a", "b"]));
        let put = |who: &str, key: &str| allowed(&rules, who, "ingress", "put", key);
        assert!(put("controller.a", "a/arm/command") && put("robot.a", "a/arm/command"));
        for other in [
            "controller.b",
            "rtde.a",
            "netft.a",
            "estimator.a",
            "operator",
            "recorder",
            "viewer",
        ] {
            assert!(!put(other, "a/arm/command"), "{other}");
        }
        assert!(
            put("estimator.a", "a/estimate/mine/normal") && !put("estimator.a", "a/wrench/tool")
        );
        assert!(put("base.a", "a/base/pose") && !put("base.a", "a/arm/command"));
        for other in [
            "base.b",
            "robot.a",
            "simulator.a",
            "estimator.a",
            "operator",
        ] {
            assert!(!put(other, "a/base/pose"), "{other}");
        }
        assert!(put("recorder", "b/health/recorder") && !put("recorder", "b/health/rtde"));
        let ask = |who: &str, key: &str| allowed(&rules, who, "ingress", "query", key);
        assert!(ask("operator", "b/control/task") && ask("operator", "a/param/*/*"));
        assert!(ask("recorder", "a/control/show") && !ask("recorder", "a/control/task"));
        assert!(ask("recorder", "a/history/**") && !ask("viewer", "a/history/arm/state"));
        assert!(ask("controller.a", "a/netft/tare") && !ask("estimator.a", "a/netft/tare"));
        let answer =
            |who: &str, key: &str| allowed(&rules, who, "ingress", "declare_queryable", key);
        assert!(
            answer("controller.a", "a/control/task") && !answer("estimator.a", "a/control/task")
        );
        assert!(
            answer("rtde.a", "a/history/arm/state")
                && !answer("estimator.a", "a/history/arm/state")
        );
        let read =
            |who: &str, key: &str| allowed(&rules, who, "ingress", "declare_subscriber", key);
        assert!(read("viewer", "*/health/*") && read("viewer", "b/**"));
        assert!(read("estimator.a", "a/arm/state") && !read("estimator.a", "b/arm/state"));
    }

    #[test]
    fn one_of_several_estimators_is_locked_out_alone() {
        let mut fleet = Fleet::of(&["a"]);
        fleet.also = vec!["estimator-x.a".into(), "estimator-y.a".into()];
        fleet.revoked = vec!["estimator-x.a".into()];
        let rules = rules(&fleet);
        let put = |who: &str| allowed(&rules, who, "ingress", "put", "a/estimate/mine/normal");
        assert!(put("estimator-y.a") && put("estimator.a") && !put("estimator-x.a"));
        let words = text(&fleet);
        assert!(!words.contains("\"estimator-x.a\""), "it is in no rule");
    }

    #[test]
    fn the_shipped_rules_are_those_that_are_generated() {
        let path = concat!(
            env!("CARGO_MANIFEST_DIR"),
            "/../../deploy/security/access.json5"
        );
        let shipped = std::fs::read_to_string(path).unwrap();
        assert_eq!(
            shipped,
            text(&Fleet::of(&["cell1"])),
            "`tangent keys new FOLDER --for cell1` writes it anew"
        );
    }

    #[test]
    fn zenoh_reads_the_text_as_the_rules() {
        let cells = Fleet::of(&["a", "b"]);
        let read = zenoh::Config::from_json5(&text(&cells)).unwrap();
        let found: Value = serde_json::from_str(&read.get_json("access_control").unwrap()).unwrap();
        let wanted = rules(&cells);
        for what in ["rules", "subjects", "policies"] {
            let count = |value: &Value| value[what].as_array().unwrap().len();
            assert_eq!(count(&found), count(&wanted["access_control"]), "{what}");
        }
        assert_eq!(found["default_permission"], "deny");
    }
}
