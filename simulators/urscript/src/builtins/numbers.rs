//! Arithmetic on numbers, bits, lists, matrices and poses.

use nalgebra::{DMatrix, Rotation3, UnitQuaternion, Vector3};

use super::arguments::{finite, or};
use super::{Done, Outcome, builtins, float, integer, list, pose};
use crate::error::ScriptError;
use crate::limits::LIST_ITEMS_MAX;
use crate::matrix::{matrix, rows};
use crate::pose::{compose, difference, interpolate, invert, isometry, sum};
use crate::value::Value;

builtins! {
    norm(a) = |_, a| float(a[0].numbers()?.iter().map(|x| x * x).sum::<f64>().sqrt());
    pow(base, exponent) = |_, a| float(a[0].float()?.powf(a[1].float()?));
    sqrt(f) = |_, a| float(a[0].float()?.sqrt());
    log(b, f) = |_, a| float(a[1].float()?.log(a[0].float()?));
    sin(f) = |_, a| float(a[0].float()?.sin());
    cos(f) = |_, a| float(a[0].float()?.cos());
    tan(f) = |_, a| float(a[0].float()?.tan());
    asin(f) = |_, a| float(a[0].float()?.asin());
    acos(f) = |_, a| float(a[0].float()?.acos());
    atan(f) = |_, a| float(a[0].float()?.atan());
    atan2(x, y) = |_, a| float(a[0].float()?.atan2(a[1].float()?));
    floor(f) = |_, a| integer(Value::Float(a[0].float()?.floor()).integer()?);
    ceil(f) = |_, a| integer(Value::Float(a[0].float()?.ceil()).integer()?);
    d2r(d) = |_, a| float(a[0].float()?.to_radians());
    r2d(r) = |_, a| float(a[0].float()?.to_degrees());

    integer_to_binary_list(x) = |_, a| {
        let n = a[0].integer()?;
        list((0..32).map(|bit| Value::Bool(n >> bit & 1 == 1)).collect())
    };
    binary_list_to_integer(l) = |_, a| {
        let bits = a[0].items()?;
        if bits.len() > 32 {
            return Err(ScriptError::ListTooLarge { elements: bits.len(), depth: 1 });
        }
        let mut n = 0;
        for (i, bit) in bits.iter().enumerate() {
            n |= i32::from(bit.truth()?) << i;
        }
        integer(n)
    };

    get_list_length(v) = |_, a| integer(a[0].length()?);
    length(v) = |_, a| integer(a[0].length()?);
    size(v) = |_, a| match a[0].rows() {
        Some(rows) if !rows.is_empty() => list(vec![Value::Integer(rows.len() as i32), Value::Integer(rows[0].len() as i32)]),
        _ => integer(a[0].length()?),
    };
    make_list(length, initial_value, capacity) = |_, a| {
        let elements = usize::try_from(a[0].integer()?).unwrap_or(0);
        if elements > LIST_ITEMS_MAX {
            return Err(ScriptError::ListTooLarge { elements, depth: 1 });
        }
        list(vec![a[1].clone(); elements])
    };
    normalize(v) = |_, a| {
        let v = a[0].numbers()?;
        let length = v.iter().map(|x| x * x).sum::<f64>().sqrt();
        if length == 0.0 {
            return Err(ScriptError::DivisionByZero);
        }
        list(v.iter().map(|x| Value::Float(x / length)).collect())
    };
    transpose(m) = |_, a| Ok(Outcome::Value(rows(&matrix(&a[0])?.transpose())?));
    inv(m) = |_, a| match &a[0] {
        Value::Pose(p) => pose(invert(p)),
        other => match Some(matrix(other)?).filter(DMatrix::is_square).and_then(DMatrix::try_inverse) {
            Some(inverse) => Ok(Outcome::Value(rows(&inverse)?)),
            None => Err(ScriptError::Singular),
        },
    };

    pose_trans(p_from, p_from_to) = |_, a| pose(compose(&a[0].six()?, &a[1].six()?));
    pose_inv(p_from) = |_, a| pose(invert(&a[0].six()?));
    pose_sub(p_to, p_from) = |_, a| pose(difference(&a[0].six()?, &a[1].six()?));
    pose_add(p_1, p_2) = |_, a| pose(sum(&a[0].six()?, &a[1].six()?));
    pose_dist(p_from, p_to) = |_, a| distance(a, 0..6);
    point_dist(p_from, p_to) = |_, a| distance(a, 0..3);
    interpolate_pose(p_from, p_to, alpha) = |_, a| pose(interpolate(&finite(a[0].six()?)?, &finite(a[1].six()?)?, or(&a[2], 0.0)?));
    wrench_trans(T_from_to, w_from) = |_, a| {
        let (to, w) = (isometry(&finite(a[0].six()?)?), finite(a[1].six()?)?);
        let inverse = to.rotation.inverse();
        let force = Vector3::new(w[0], w[1], w[2]);
        let torque = Vector3::new(w[3], w[4], w[5]) - to.translation.vector.cross(&force);
        let (force, torque) = (inverse * force, inverse * torque);
        super::six([force.x, force.y, force.z, torque.x, torque.y, torque.z])
    };
    rotvec2rpy(rotation_vector) = |_, a| {
        let rotation = UnitQuaternion::from_scaled_axis(three(&a[0])?);
        let (roll, pitch, yaw) = rotation.euler_angles();
        list([roll, pitch, yaw].map(Value::Float).to_vec())
    };
    rpy2rotvec(rpy) = |_, a| {
        let rpy = three(&a[0])?;
        let vector = Rotation3::from_euler_angles(rpy.x, rpy.y, rpy.z).scaled_axis();
        list([vector.x, vector.y, vector.z].map(Value::Float).to_vec())
    };
}

fn three(value: &Value) -> Result<Vector3<f64>, ScriptError> {
    let numbers = value.numbers()?;
    let count = numbers.len();
    match <[f64; 3]>::try_from(numbers) {
        Ok(v) if v.iter().all(|x| x.is_finite()) => Ok(v.into()),
        Ok(v) => Err(ScriptError::NotFinite { value: v[0] }),
        Err(_) => Err(ScriptError::NotThree { count }),
    }
}

fn distance(a: &[Value], range: std::ops::Range<usize>) -> Done {
    let d = difference(&finite(a[1].six()?)?, &finite(a[0].six()?)?);
    float(d[range].iter().map(|x| x * x).sum::<f64>().sqrt())
}
