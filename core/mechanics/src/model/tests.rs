use super::*;

fn ur5() -> ModelData {
    ModelData::builtin("ur5").unwrap()
}

/// The error after one change to a good file.
fn refused(change: impl FnOnce(&mut ModelData)) -> String {
    let mut model = ur5();
    change(&mut model);
    model.validate().unwrap_err().to_string()
}

#[test]
fn every_builtin_loads_under_its_own_name_and_survives_a_round_trip() {
    assert_eq!(
        ModelData::builtin_names().collect::<Vec<_>>(),
        [
            "ur3",
            "ur3e",
            "ur5",
            "ur5e",
            "ur7e",
            "ur10",
            "ur10e",
            "ur12e",
            "ur15",
            "ur16e",
            "ur18",
            "ur20",
            "ur30",
            "panda",
            "smart3s_substitute",
            "planar2"
        ]
    );
    for name in ModelData::builtin_names() {
        let model = ModelData::builtin(name).unwrap();
        assert_eq!(model.name, name);
        assert!(!model.sources.is_empty());
        let text = toml::to_string(&model).unwrap();
        assert_eq!(ModelData::from_toml(&text).unwrap(), model);
    }
}

#[test]
fn a_substitute_says_that_it_is_one() {
    let model = ModelData::builtin("smart3s_substitute").unwrap();
    assert!(model.title.starts_with("Substitute"));
    assert!(model.notes[0].contains("NOT the SMART-3 S"));
    assert!(!model.assumed.is_empty());
}

#[test]
fn borrowed_inertias_are_owned_up_to() {
    let model = ModelData::builtin("ur30").unwrap();
    assert!(model.assumed[0].contains("those of the UR16e"));
}

#[test]
fn an_unknown_robot_names_those_there_are() {
    let error = ModelData::builtin("ur6").unwrap_err().to_string();
    assert!(
        error.contains("`ur6`") && error.contains("ur3, ur3e, ur5, ur5e"),
        "{error}"
    );
}

#[test]
fn an_unknown_key_is_named_with_its_line() {
    let text = ModelData::builtin_text("planar2")
        .unwrap()
        .replacen("mass_kg", "mass", 1);
    let error = ModelData::from_toml(&text).unwrap_err().to_string();
    assert!(
        error.contains("unknown field `mass`")
            && error.contains("mass_kg")
            && error.contains("line"),
        "{error}"
    );
}

#[test]
fn a_missing_key_and_a_wrong_type_are_named() {
    let good = ModelData::builtin_text("planar2").unwrap();
    let missing = good.replacen("velocity_rad_per_s = [5.0, 5.0]", "", 1);
    let error = ModelData::from_toml(&missing).unwrap_err().to_string();
    assert!(
        error.contains("missing field `velocity_rad_per_s`"),
        "{error}"
    );
    let wrong = good.replacen("dof = 2", "dof = \"two\"", 1);
    let error = ModelData::from_toml(&wrong).unwrap_err().to_string();
    assert!(error.contains("dof = \"two\""), "{error}");
}

#[test]
fn whole_numbers_will_do() {
    let text =
        ModelData::builtin_text("planar2")
            .unwrap()
            .replacen("mass_kg = 2.0", "mass_kg = 2", 1);
    let model = ModelData::from_toml(&text).unwrap();
    assert_eq!(model, ModelData::builtin("planar2").unwrap());
}

#[test]
fn lists_of_another_length_than_dof_are_refused() {
    let error = refused(|m| m.dof = 5);
    assert_eq!(
        error,
        "robot model `ur5`: `joint_names` has 6 entries; `dof` is 5, so it needs 5"
    );
    assert!(refused(|m| drop(m.links.pop())).contains("`links` has 5 entries"));
    assert!(refused(|m| m.home_rad.push(0.0)).contains("`home_rad` has 7 entries"));
    assert!(refused(|m| m.dof = 0).contains("`dof` = 0: must be a number of joints from 1 to 8"));
}

#[test]
fn bodies_that_cannot_exist_are_refused() {
    assert_eq!(
        refused(|m| m.links[2].mass_kg = -1.0),
        "robot model `ur5`: `links[2].mass_kg` = -1: must be a finite number above 0"
    );
    assert!(refused(|m| m.links[0].mass_kg = f64::NAN).contains("`links[0].mass_kg` = NaN"));
    assert!(refused(|m| m.links[1].com_m[2] = f64::INFINITY).contains("`links[1].com_m[2]` = inf"));
    assert!(refused(|m| m.links[3].inertia_kg_m2[0][1] = 1e-4).contains("must be symmetric"));
    assert!(refused(|m| m.links[3].inertia_kg_m2[2][2] = -1e-4).contains("positive definite"));
    assert!(refused(|m| m.links[3].inertia_kg_m2 = [[0.0; 3]; 3]).contains("positive definite"));
}

#[test]
fn limits_the_wrong_way_round_are_refused() {
    let error = refused(|m| m.limits.position_lower_rad[4] = 7.0);
    assert!(
        error.contains("`limits.position_lower_rad[4]` = 7 (upper limit 6.28"),
        "{error}"
    );
    assert!(refused(|m| m.limits.velocity_rad_per_s[1] = 0.0).contains("above 0"));
    assert!(refused(|m| m.limits.effort_nm = Some(vec![1.0])).contains("`limits.effort_nm` has 1"));
    assert!(refused(|m| m.home_rad[3] = 9.0).contains("within the position limits"));
}

#[test]
fn a_frame_that_is_not_rigid_is_refused() {
    assert!(refused(|m| m.dh.dhn_from_flange[0][0] = 1.1).contains("rigid transform"));
    assert!(refused(|m| m.dh.base_from_dh0[2][2] = -1.0).contains("rigid transform"));
    assert!(refused(|m| m.dh.base_from_dh0[1][3] = f64::NAN).contains("rigid transform"));
    assert!(refused(|m| m.dh.rows[2].a_m = f64::NAN).contains("`dh.rows[2][0]` = NaN"));
}

#[test]
fn an_arm_of_another_size_is_refused() {
    let error = crate::Arm::<7>::new(&ur5()).unwrap_err().to_string();
    assert_eq!(error, "robot model `ur5` has 6 joints; 7 are needed here");
}
