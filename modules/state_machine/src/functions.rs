//! Functions for expressions: geometry of messages, ages of messages, active states.
//!
//! Angles are in rad, lengths in m, times in s; frames as in REP-103. Points are maps with `x`, `y` and
//! perhaps `z`, such as geometry_msgs/Point; orientations are maps with `x`, `y`, `z`, `w`, such as
//! geometry_msgs/Quaternion.

use crate::world::World;
use parking_lot::RwLock;
use rhai::{Dynamic, Engine, EvalAltResult, FLOAT, INT, ImmutableString, Map, Position};
use std::f64::consts::{PI, TAU};
use std::sync::Arc;

type Answer<T> = Result<T, Box<EvalAltResult>>;

/// Registers the functions that need nothing but their arguments.
pub(crate) fn register(engine: &mut Engine) {
    // Those of the language that would stop the robot.
    engine.register_fn("sleep", |_: INT| refuse_sleep());
    engine.register_fn("sleep", |_: FLOAT| refuse_sleep());
    engine.register_fn("exit", refuse_exit);
    engine.register_fn("distance", |a: Map, b: Map| -> Answer<f64> {
        let squares = ["x", "y", "z"]
            .map(|axis| -> Answer<f64> { Ok((coordinate(&a, axis)? - coordinate(&b, axis)?).powi(2)) });
        squares.into_iter().sum::<Answer<f64>>().map(f64::sqrt)
    });
    engine.register_fn("norm", |a: Map| -> Answer<f64> {
        let squares = ["x", "y", "z"].map(|axis| -> Answer<f64> { Ok(coordinate(&a, axis)?.powi(2)) });
        squares.into_iter().sum::<Answer<f64>>().map(f64::sqrt)
    });
    engine
        .register_fn("atan2", |y: Dynamic, x: Dynamic| -> Answer<f64> { Ok(number(&y)?.atan2(number(&x)?)) });
    engine.register_fn("bearing", |to: Map| -> Answer<f64> {
        Ok(coordinate(&to, "y")?.atan2(coordinate(&to, "x")?))
    });
    engine.register_fn("bearing", |from: Map, to: Map| -> Answer<f64> {
        let along = |axis| -> Answer<f64> { Ok(coordinate(&to, axis)? - coordinate(&from, axis)?) };
        Ok(along("y")?.atan2(along("x")?))
    });
    engine.register_fn("wrap_angle", |angle: Dynamic| -> Answer<f64> { number(&angle).map(wrap_angle) });
    engine.register_fn("clamp", |value: Dynamic, low: Dynamic, high: Dynamic| -> Answer<f64> {
        Ok(number(&value)?.min(number(&high)?).max(number(&low)?))
    });
    engine.register_fn("yaw", |orientation: Map| -> Answer<f64> { yaw(&orientation) });
    engine.register_fn("relative", relative);
    engine.register_fn("seconds", |stamp: Map| -> Answer<f64> {
        Ok(coordinate(&stamp, "sec")? + coordinate(&stamp, "nanosec")? / 1e9)
    });
}

/// Registers those that know the chart and its time.
pub(crate) fn register_world(engine: &mut Engine, world: &Arc<RwLock<World>>) {
    let [active, times, clock, ages, receipts] = std::array::from_fn(|_| Arc::clone(world));
    engine.register_fn("In", move |state: ImmutableString| -> bool {
        active.read().entered.contains_key(&*state)
    });
    engine.register_fn("time_in", move |state: ImmutableString| -> f64 {
        let world = times.read();
        world.entered.get(&*state).map_or(0.0, |&since| world.now.saturating_sub(since).as_secs_f64())
    });
    engine.register_fn("time", move || -> f64 { clock.read().now.as_secs_f64() });
    engine.register_fn("age", move |name: ImmutableString| -> Answer<FLOAT> {
        let world = ages.read();
        let received = receipt(&world, &name)?;
        Ok(received.map_or(f64::INFINITY, |at| world.now.saturating_sub(at).as_secs_f64()))
    });
    engine.register_fn("has", move |name: ImmutableString| -> Answer<bool> {
        Ok(receipt(&receipts.read(), &name)?.is_some())
    });
}

fn receipt(world: &World, name: &str) -> Answer<Option<std::time::Duration>> {
    world.received.get(name).copied().ok_or_else(|| {
        let known: Vec<&str> = world.received.keys().map(String::as_str).collect();
        fail(format!("there is no subscription \"{name}\"; there are: {}", known.join(", ")))
    })
}

/// A point of the plane, as seen from a pose (geometry_msgs/Pose): x forward, y left.
fn relative(pose: Map, point: Map) -> Answer<Map> {
    let part = |name: &str| {
        let part = pose.get(name).and_then(|part| part.as_map_ref().ok().map(|map| map.clone()));
        part.ok_or_else(|| fail(format!("a pose has `position` and `orientation`, this has no `{name}`")))
    };
    let (position, angle) = (part("position")?, yaw(&part("orientation")?)?);
    let x = coordinate(&point, "x")? - coordinate(&position, "x")?;
    let y = coordinate(&point, "y")? - coordinate(&position, "y")?;
    let (sine, cosine) = angle.sin_cos();
    Ok(Map::from([
        ("x".into(), Dynamic::from_float(cosine * x + sine * y)),
        ("y".into(), Dynamic::from_float(cosine * y - sine * x)),
    ]))
}

/// The angle about z of an orientation, in (-π, π].
fn yaw(orientation: &Map) -> Answer<f64> {
    let [x, y, z, w] = ["x", "y", "z", "w"].map(|axis| coordinate(orientation, axis));
    let (x, y, z, w) = (x?, y?, z?, w?);
    Ok((2.0 * (w * z + x * y)).atan2(1.0 - 2.0 * (y * y + z * z)))
}

/// The same angle in (-π, π].
fn wrap_angle(angle: f64) -> f64 {
    let wrapped = angle.rem_euclid(TAU);
    if wrapped > PI { wrapped - TAU } else { wrapped }
}

/// A number of a map; `z` is 0 where it is missing.
fn coordinate(of: &Map, name: &str) -> Answer<f64> {
    match of.get(name) {
        Some(value) => number(value),
        None if name == "z" => Ok(0.0),
        None => {
            let known: Vec<&str> = of.keys().map(|key| key.as_str()).collect();
            Err(fail(format!("a value with `{name}` is needed, this has {}", known.join(", "))))
        }
    }
}

fn number(value: &Dynamic) -> Answer<f64> {
    let integer = |value: INT| value as f64;
    value
        .as_float()
        .or_else(|_| value.as_int().map(integer))
        .map_err(|found| fail(format!("a number is needed, not a value of type {found}")))
}

fn refuse_sleep() -> Answer<()> {
    Err(fail("an expression cannot wait; use <send> with a delay".to_owned()))
}

fn refuse_exit() -> Answer<()> {
    Err(fail("an expression cannot end a chart; enter a <final> state".to_owned()))
}

fn fail(text: String) -> Box<EvalAltResult> {
    Box::new(EvalAltResult::ErrorRuntime(text.into(), Position::NONE))
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]

    use crate::expressions::{Evaluator, Program, Syntax};
    use rhai::Scope;

    #[test]
    fn geometry_agrees_with_values_worked_out_by_hand() {
        let half = std::f64::consts::FRAC_1_SQRT_2;
        let turned = format!("#{{x: 0.0, y: 0.0, z: {half}, w: {half}}}");
        let pose = format!("#{{position: #{{x: 1, y: 2, z: 0}}, orientation: {turned}}}");
        for (text, expected) in [
            ("distance(#{x: 0, y: 3}, #{x: 4.0, y: 0.0})".to_owned(), 5.0),
            ("norm(#{x: 1, y: 2, z: 2})".to_owned(), 3.0),
            ("atan2(1, 0)".to_owned(), std::f64::consts::FRAC_PI_2),
            ("bearing(#{x: 1, y: 1}, #{x: 0, y: 1})".to_owned(), std::f64::consts::PI),
            ("wrap_angle(3.5 * PI())".to_owned(), -std::f64::consts::FRAC_PI_2),
            ("wrap_angle(PI())".to_owned(), std::f64::consts::PI),
            ("clamp(5, -1, 1.5)".to_owned(), 1.5),
            (format!("yaw({turned})"), std::f64::consts::FRAC_PI_2),
            // Facing +y at (1, 2), the point (1, 5) is 3 m ahead and (0, 2) 1 m to the left.
            (format!("relative({pose}, #{{x: 1, y: 5}}).x"), 3.0),
            (format!("relative({pose}, #{{x: 0, y: 2}}).y"), 1.0),
            ("seconds(#{sec: 2, nanosec: 500000000})".to_owned(), 2.5),
        ] {
            let program = Program::new(&text, 1, Syntax::Expression).unwrap();
            let value = Evaluator::new().value(&program, &mut Scope::new()).unwrap().as_float().unwrap();
            assert!((value - expected).abs() < 1e-12, "{text} is {value}");
        }
    }

    #[test]
    fn a_wrong_argument_is_named() {
        for (text, words) in [
            ("distance(#{x: 0}, #{x: 1, y: 1})", "a value with `y` is needed"),
            ("yaw(#{x: 'a', y: 0, z: 0, w: 1})", "a number is needed"),
            ("age('bal')", "there is no subscription \"bal\""),
        ] {
            let program = Program::new(text, 1, Syntax::Expression).unwrap();
            let problem = Evaluator::new().value(&program, &mut Scope::new()).unwrap_err();
            assert!(problem.text.contains(words), "{problem}");
        }
    }
}
