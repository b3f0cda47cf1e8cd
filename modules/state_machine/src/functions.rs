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
    register_mathematics(engine);
    engine.register_fn("distance", |a: Map, b: Map| -> Answer<f64> {
        let squares = ["x", "y", "z"]
            .map(|axis| -> Answer<f64> { Ok((coordinate(&a, axis)? - coordinate(&b, axis)?).powi(2)) });
        squares.into_iter().sum::<Answer<f64>>().map(f64::sqrt)
    });
    engine.register_fn("norm", |a: Map| -> Answer<f64> {
        let squares = ["x", "y", "z"].map(|axis| -> Answer<f64> { Ok(coordinate(&a, axis)?.powi(2)) });
        squares.into_iter().sum::<Answer<f64>>().map(f64::sqrt)
    });
    engine.register_fn("atan2", |y: Dynamic, x: Dynamic| -> Answer<f64> {
        Ok(libm::atan2(number(&y)?, number(&x)?))
    });
    engine.register_fn("bearing", |to: Map| -> Answer<f64> {
        Ok(libm::atan2(coordinate(&to, "y")?, coordinate(&to, "x")?))
    });
    engine.register_fn("bearing", |from: Map, to: Map| -> Answer<f64> {
        let along = |axis| -> Answer<f64> { Ok(coordinate(&to, axis)? - coordinate(&from, axis)?) };
        Ok(libm::atan2(along("y")?, along("x")?))
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

/// Registers those of the language that would call the C library, whose results differ between machines.
fn register_mathematics(engine: &mut Engine) {
    type Function = fn(FLOAT) -> FLOAT;
    const OF_ONE: [(&str, Function); 14] = [
        ("sin", libm::sin),
        ("cos", libm::cos),
        ("tan", libm::tan),
        ("sinh", libm::sinh),
        ("cosh", libm::cosh),
        ("tanh", libm::tanh),
        ("asin", libm::asin),
        ("acos", libm::acos),
        ("atan", libm::atan),
        ("asinh", libm::asinh),
        ("acosh", libm::acosh),
        ("atanh", libm::atanh),
        ("exp", libm::exp),
        ("ln", libm::log),
    ];
    for (name, function) in OF_ONE {
        engine.register_fn(name, function);
    }
    engine.register_fn("atan", libm::atan2 as fn(FLOAT, FLOAT) -> FLOAT);
    engine.register_fn("hypot", libm::hypot as fn(FLOAT, FLOAT) -> FLOAT);
    engine.register_fn("log", libm::log10 as fn(FLOAT) -> FLOAT);
    engine.register_fn("log", |x: FLOAT, base: FLOAT| libm::log(x) / libm::log(base));
    engine.register_fn("**", libm::pow as fn(FLOAT, FLOAT) -> FLOAT);
    engine.register_fn("**", |x: FLOAT, y: INT| libm::pow(x, y as FLOAT));
    engine.register_fn("**", |x: INT, y: FLOAT| libm::pow(x as FLOAT, y));
    engine.register_fn("**=", |x: &mut FLOAT, y: FLOAT| *x = libm::pow(*x, y));
    engine.register_fn("**=", |x: &mut FLOAT, y: INT| *x = libm::pow(*x, y as FLOAT));
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
    let (sine, cosine) = libm::sincos(angle);
    Ok(Map::from([
        ("x".into(), Dynamic::from_float(cosine * x + sine * y)),
        ("y".into(), Dynamic::from_float(cosine * y - sine * x)),
    ]))
}

/// The angle about z of an orientation, in (-π, π].
fn yaw(orientation: &Map) -> Answer<f64> {
    let [x, y, z, w] = ["x", "y", "z", "w"].map(|axis| coordinate(orientation, axis));
    let (x, y, z, w) = (x?, y?, z?, w?);
    Ok(libm::atan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z)))
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
    fn mathematics_is_the_same_on_every_machine() {
        for number in 0..2000 {
            let x = 0.01 + f64::from(number) / 37.0;
            for (text, expected) in [
                (format!("sin({x:?})"), libm::sin(x)),
                (format!("exp({x:?} / 60)"), libm::exp(x / 60.0)),
                (format!("log({x:?})"), libm::log10(x)),
                (format!("{x:?} ** 0.3"), libm::pow(x, 0.3)),
                (format!("let y = {x:?}; y **= 0.7; y"), libm::pow(x, 0.7)),
            ] {
                let program = Program::new(&text, 1, Syntax::Statements).unwrap();
                let value = Evaluator::new().value(&program, &mut Scope::new()).unwrap().as_float().unwrap();
                assert_eq!(value.to_bits(), expected.to_bits(), "{text} is {value}");
            }
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
