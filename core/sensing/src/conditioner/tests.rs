use super::*;
use nalgebra::UnitQuaternion;
use proptest::prelude::*;

const RATE: f64 = 1000.0;

fn payload() -> Payload {
    Payload {
        mass_kg: 0.42,
        com_in_sensor_m: [0.004, -0.007, 0.055],
        inertia_kg_m2: [0.0; 3],
    }
}

fn mounting() -> Pose<Sensor, Tool> {
    Pose::new(
        Vector3::new(0.01, 0.02, 0.12),
        UnitQuaternion::new(Vector3::new(0.1, -0.2, 0.7)),
    )
}

fn conditioner() -> WrenchConditioner {
    WrenchConditioner::new(&ConditioningConfig::default(), &payload(), mounting(), RATE).unwrap()
}

/// Reading of an ideal sensor with zero `bias` while `contact` acts at the tool.
fn reading(
    i: usize,
    base_from_tool: Pose<Base, Tool>,
    contact: &Wrench<Tool>,
    bias: &Wrench<Sensor>,
) -> Reading {
    let base_from_sensor = base_from_tool * mounting().inverse();
    let gravity = base_from_sensor.unrotate(&Vector3::new(0.0, 0.0, -9.80665));
    let weight = payload().mass_kg * gravity;
    let load = Wrench::new(
        weight,
        Vector3::from(payload().com_in_sensor_m).cross(&weight),
    );
    let wrench = mounting().transform_wrench(contact) + load + *bias;
    Reading::new(i as f64 / RATE, wrench, base_from_tool)
}

fn turned(v: [f64; 3]) -> Pose<Base, Tool> {
    Pose::new(Vector3::new(0.4, 0.1, 0.3), UnitQuaternion::new(v.into()))
}

fn tared(pose: Pose<Base, Tool>, bias: &Wrench<Sensor>) -> (WrenchConditionerState, usize) {
    let (conditioner, mut state) = (conditioner(), WrenchConditionerState::default());
    conditioner.start_tare(&mut state, TareGround::Assumed);
    let mut i = 0;
    while state.is_taring() {
        conditioner.update(&mut state, &reading(i, pose, &Wrench::zero(), bias));
        i += 1;
    }
    assert_eq!(
        state.take_tare_outcome().unwrap().map(|t| t.samples),
        Ok(500)
    );
    (state, i)
}

fn bias() -> Wrench<Sensor> {
    Wrench::from_vector(&Vector6::new(2.0, -3.0, 1.0, 0.1, 0.2, -0.1))
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]
    #[test]
    fn a_free_tool_reads_zero_in_every_orientation_after_a_tare_in_any(
        at in prop::array::uniform3(-3.0f64..3.0), then in prop::array::uniform3(-3.0f64..3.0),
    ) {
        let conditioner = conditioner();
        let (mut state, mut i) = tared(turned(at), &bias());
        for _ in 0..20 {
            let out = conditioner.update(&mut state, &reading(i, turned(then), &Wrench::zero(), &bias()));
            prop_assert!(out.validity.is_valid());
            prop_assert!(out.wrench.vector().norm() < 1e-9, "{:?}", out.wrench);
            i += 1;
        }
    }

    #[test]
    fn a_steady_contact_is_read_at_the_tool(at in prop::array::uniform3(-3.0f64..3.0),
                                            contact in prop::array::uniform6(-20.0f64..20.0)) {
        let conditioner = conditioner();
        let (mut state, start) = tared(turned(at), &bias());
        let contact = Wrench::from_vector(&contact.into());
        let mut last = None;
        for i in start..start + 2 * conditioner.filter().settling_samples() as usize {
            last = Some(conditioner.update(&mut state, &reading(i, turned(at), &contact, &bias())));
        }
        let error = last.unwrap().wrench - contact;
        prop_assert!(error.vector().norm() < 1e-4, "{error:?}");
    }

    #[test]
    fn no_reading_whatever_makes_the_output_not_finite(
        readings in prop::collection::vec((prop::array::uniform6(prop::num::f64::ANY), 0u32..5, 0u8..3, any::<bool>()), 1..80),
    ) {
        let (conditioner, mut state) = (conditioner(), WrenchConditionerState::default());
        conditioner.start_tare(&mut state, TareGround::Assumed);
        for (i, (wrench, missed, condition, posed)) in readings.into_iter().enumerate() {
            let mut reading = reading(i, turned([0.0; 3]), &Wrench::zero(), &Wrench::zero());
            reading.wrench = Wrench::from_vector(&wrench.map(|x| x.clamp(-1e12, 1e12)).into());
            reading.missed = missed * 1000;
            reading.condition = [SensorCondition::Good, SensorCondition::Saturated, SensorCondition::Error][condition as usize];
            if !posed {
                reading.base_from_tool = None;
            }
            let out = conditioner.update(&mut state, &reading);
            prop_assert!(out.wrench.is_finite());
            if condition != 0 || !reading.wrench.is_finite() {
                prop_assert!(!out.validity.is_valid());
            }
        }
    }
}

#[test]
fn pressing_reads_negative_force_along_the_tools_z() {
    // A tool that points straight down on a floor: z_tool = -n, and the floor pushes up with 3 N.
    let sensor_from_tool = Pose::new(Vector3::new(0.0, 0.0, 0.1), UnitQuaternion::identity());
    let conditioner = WrenchConditioner::new(
        &ConditioningConfig {
            filter_cutoff_hz: 0.0,
            ..ConditioningConfig::default()
        },
        &Payload::default(),
        sensor_from_tool,
        RATE,
    )
    .unwrap();
    let down = turned([std::f64::consts::PI, 0.0, 0.0]);
    // 3 N up in the base is -3 N along z of a sensor that points down; 1 N along x at the tip
    // causes 0.1 Nm at the sensor.
    let at_sensor = Wrench::from_vector(&Vector6::new(1.0, 0.0, -3.0, 0.0, 0.1, 0.0));
    let out = conditioner.update(
        &mut WrenchConditionerState::default(),
        &Reading::new(0.0, at_sensor, down),
    );
    let expected = Vector6::new(1.0, 0.0, -3.0, 0.0, 0.0, 0.0);
    assert!((out.wrench.vector() - expected).norm() < 1e-15);
    assert_eq!(out.delay_s, 0.0);
}

#[test]
fn the_tare_has_an_age_and_is_never_implicit() {
    let (conditioner, mut state) = (conditioner(), WrenchConditionerState::default());
    for i in 0..2000 {
        let out = conditioner.update(
            &mut state,
            &reading(i, turned([0.0; 3]), &Wrench::zero(), &bias()),
        );
        assert_eq!(out.bias_age_s, None);
        assert_eq!(out.bias, Wrench::zero());
    }
    let (mut state, start) = tared(turned([0.0; 3]), &bias());
    let later = reading(start + 1499, turned([0.0; 3]), &Wrench::zero(), &bias());
    let out = conditioner.update(&mut state, &later);
    assert!((out.bias_age_s.unwrap() - 1.5).abs() < 1e-9);
    assert!((out.bias - bias()).vector().norm() < 1e-12);
}

#[test]
fn a_tare_while_moving_shaking_wandering_or_blind_is_refused_and_the_old_one_kept() {
    let conditioner = conditioner();
    let run = |change: &dyn Fn(usize, &mut Reading)| {
        let (mut state, start) = tared(turned([0.0; 3]), &bias());
        let before = *state.tare().unwrap();
        conditioner.start_tare(&mut state, TareGround::Assumed);
        for i in 0..500 {
            let mut reading = reading(start + i, turned([0.0; 3]), &Wrench::zero(), &bias());
            change(i, &mut reading);
            conditioner.update(&mut state, &reading);
        }
        assert_eq!(state.tare(), Some(&before));
        state.take_tare_outcome().unwrap().unwrap_err()
    };
    assert!(matches!(
        run(&|i, r| r.base_from_tool = Some((turned([i as f64 * 1e-5, 0.0, 0.0]), 0.0))),
        TareRefusal::Moving { .. }
    ));
    assert!(matches!(
        run(&|i, r| r.wrench.force.x += if i % 2 == 0 { 0.6 } else { -0.6 }),
        TareRefusal::Scattered { force_n, .. } if (force_n - 0.6).abs() < 0.01
    ));
    assert!(matches!(
        run(&|i, r| r.wrench.force.y += i as f64 * 0.001),
        TareRefusal::Wandering { force_n, .. } if (force_n - 0.25).abs() < 0.01
    ));
    assert_eq!(
        run(&|_, r| r.base_from_tool = None),
        TareRefusal::NoOrientation(Validity::Missing)
    );
    assert_eq!(
        run(&|i, r| {
            if i == 20 {
                r.condition = SensorCondition::Saturated;
            }
        }),
        TareRefusal::BadReading(Validity::Saturated)
    );
    assert_eq!(
        run(&|_, r| r.wrench.torque.z = f64::NAN),
        TareRefusal::BadReading(Validity::NotFinite)
    );
}

/// A tare with this justification under a load of `load_n` along z, from sample `start` on. Returns
/// its result and the index of the sample after it.
fn tare_under(
    state: &mut WrenchConditionerState,
    ground: TareGround,
    load_n: f64,
    start: usize,
) -> (Result<Tare, TareRefusal>, usize) {
    let conditioner = conditioner();
    let load = Wrench::from_vector(&Vector6::new(0.0, 0.0, load_n, 0.0, 0.0, 0.0));
    conditioner.start_tare(state, ground);
    let mut i = start;
    while state.is_taring() {
        conditioner.update(state, &reading(i, turned([0.0; 3]), &load, &bias()));
        i += 1;
    }
    (state.take_tare_outcome().unwrap(), i)
}

/// Force of the untared reading beyond the zero that the limit is measured from, N, under a load
/// along z.
fn beyond_n(state: &mut WrenchConditionerState, load_n: f64, start: usize) -> f64 {
    let load = Wrench::from_vector(&Vector6::new(0.0, 0.0, load_n, 0.0, 0.0, 0.0));
    let mut out = None;
    for i in start..start + 500 {
        let loaded = reading(i, turned([0.0; 3]), &load, &bias());
        out = Some(conditioner().update(state, &loaded));
    }
    let out = out.unwrap();
    (out.untared - out.reference.unwrap().0).force.norm()
}

#[test]
fn small_jumps_under_a_growing_load_do_not_add_up() {
    let (mut state, mut i) = tared(turned([0.0; 3]), &bias());
    let mut refused_at_n = None;
    for step in 1..=20 {
        let load_n = -0.25 * f64::from(step);
        let (outcome, end) = tare_under(&mut state, TareGround::Assumed, load_n, i);
        i = end;
        if let Err(refusal) = outcome {
            assert!(matches!(refusal, TareRefusal::Jump { .. }), "{refusal}");
            refused_at_n = Some(-load_n);
            break;
        }
    }
    assert!(refused_at_n.unwrap() <= 0.5, "{refused_at_n:?}");
}

#[test]
fn drift_over_hours_excuses_only_so_much_of_a_load() {
    let (mut state, _) = tared(turned([0.0; 3]), &bias());
    // Two hours later, at 0.05 N a minute: a load of 3 N.
    let later = 7200 * RATE as usize;
    let (outcome, end) = tare_under(&mut state, TareGround::Assumed, -3.0, later);
    assert!(matches!(outcome, Err(TareRefusal::Jump { .. })));
    let (outcome, _) = tare_under(&mut state, TareGround::Shown, -3.0, end);
    assert!(outcome.is_ok());
}

#[test]
fn a_zero_on_a_persons_word_hides_no_load_from_the_untared_limit() {
    let (mut state, start) = tared(turned([0.0; 3]), &bias());
    let (outcome, i) = tare_under(&mut state, TareGround::SaidClear, -20.0, start);
    assert!(outcome.is_ok());
    assert!((beyond_n(&mut state, -40.0, i) - 40.0).abs() < 1e-6);
    // A zero assumed after it does not hide the load either.
    let (outcome, i) = tare_under(&mut state, TareGround::Assumed, -20.2, i + 500);
    assert!(outcome.is_ok());
    assert!((beyond_n(&mut state, -40.0, i) - 40.0).abs() < 1e-6);
    // After a motion has shown that no load acts, the zero is a reference for the limit: a tool was
    // changed.
    let (outcome, i) = tare_under(&mut state, TareGround::Shown, -20.2, i + 500);
    assert!(outcome.is_ok());
    assert!((beyond_n(&mut state, -40.0, i) - 19.8).abs() < 1e-6);
}

#[test]
fn a_new_zero_makes_no_swing() {
    let conditioner = conditioner();
    let (mut state, start) = tared(turned([0.0; 3]), &bias());
    let drifted = bias() + Wrench::from_vector(&Vector6::new(0.3, 0.0, 0.0, 0.0, 0.0, 0.0));
    conditioner.start_tare(&mut state, TareGround::Assumed);
    let mut largest: f64 = 0.0;
    for i in start..start + 600 {
        let free = reading(i, turned([0.0; 3]), &Wrench::zero(), &drifted);
        let out = conditioner.update(&mut state, &free);
        if !state.is_taring() {
            largest = largest.max(out.wrench.force.norm());
        }
    }
    assert!(largest < 1e-6, "{largest} N");
}

#[test]
fn a_saturated_record_stays_visible_for_the_hold_and_its_numbers_go_nowhere() {
    let conditioner = conditioner();
    let (mut state, start) = tared(turned([0.0; 3]), &bias());
    let free = |i| reading(i, turned([0.0; 3]), &Wrench::zero(), &bias());
    let mut bad = free(start);
    bad.condition = SensorCondition::Saturated;
    bad.wrench.force.z = 300.0;
    assert_eq!(
        conditioner.update(&mut state, &bad).validity,
        Validity::Saturated
    );
    // 10 ms of hold at 1 kHz; the last sample falls on the edge.
    for i in 1..10 {
        let out = conditioner.update(&mut state, &free(start + i));
        assert_eq!(out.validity, Validity::Saturated, "{i}");
        assert!(out.wrench.vector().norm() < 1e-9);
    }
    let out = conditioner.update(&mut state, &free(start + 11));
    assert_eq!(out.validity, Validity::Valid);
}

#[test]
fn an_old_or_missing_orientation_is_said_unless_nothing_hangs_there() {
    let conditioner = conditioner();
    let mut state = WrenchConditionerState::default();
    let mut old = reading(0, turned([0.0; 3]), &Wrench::zero(), &Wrench::zero());
    old.base_from_tool = Some((turned([0.0; 3]), 0.2));
    assert_eq!(
        conditioner.update(&mut state, &old).validity,
        Validity::Stale
    );
    old.base_from_tool = None;
    assert_eq!(
        conditioner.update(&mut state, &old).validity,
        Validity::Missing
    );
    let bare = WrenchConditioner::new(
        &ConditioningConfig::default(),
        &Payload::default(),
        mounting(),
        RATE,
    )
    .unwrap();
    let out = bare.update(&mut WrenchConditionerState::default(), &old);
    assert_eq!(out.validity, Validity::Valid);
}

#[test]
fn lost_readings_do_not_slow_the_filter_down() {
    let conditioner = conditioner();
    let contact = Wrench::from_vector(&Vector6::new(0.0, 0.0, -3.0, 0.0, 0.0, 0.0));
    let step = |every: usize| {
        let (mut state, start) = tared(turned([0.0; 3]), &bias());
        let mut out = None;
        for i in (start..start + 40).filter(|i| (i - start) % every == every - 1) {
            let mut reading = reading(i, turned([0.0; 3]), &contact, &bias());
            reading.missed = every as u32 - 1;
            out = Some(conditioner.update(&mut state, &reading).wrench.force.z);
        }
        out.unwrap()
    };
    assert!((step(1) - step(10)).abs() < 1e-12);
}

#[test]
fn after_a_long_gap_the_filter_starts_at_the_new_reading() {
    let conditioner = conditioner();
    let (mut state, start) = tared(turned([0.0; 3]), &bias());
    let contact = Wrench::from_vector(&Vector6::new(0.0, 0.0, -3.0, 0.0, 0.0, 0.0));
    let mut reading = reading(start + 5000, turned([0.0; 3]), &contact, &bias());
    reading.missed = 5000;
    let out = conditioner.update(&mut state, &reading);
    assert!((out.wrench - contact).vector().norm() < 1e-9);
}

#[test]
fn bad_parameters_are_refused_by_name() {
    let config = ConditioningConfig {
        fault_hold_s: f64::NAN,
        ..ConditioningConfig::default()
    };
    let error = WrenchConditioner::new(&config, &payload(), mounting(), RATE).unwrap_err();
    assert_eq!(error.key, "fault_hold_s");
}
