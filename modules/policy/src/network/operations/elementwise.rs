//! Operations on each element.

use super::super::tensor::{Data, Tensor, broadcast, places};
use super::{Described, Inputs, Operation};

pub(super) fn operation(of: &Described<'_>) -> Result<Option<Operation>, String> {
    let alpha = |default| of.float("alpha", default);
    Ok(Some(match of.node.operation.as_str() {
        "Abs" => unary(f32::abs),
        "Neg" => unary(|x| -x),
        "Sign" => unary(|x| if x == 0.0 { 0.0 } else { x.signum() }),
        "Reciprocal" => unary(|x| 1.0 / x),
        "Floor" => unary(f32::floor),
        "Ceil" => unary(f32::ceil),
        "Round" => unary(f32::round_ties_even),
        "Sqrt" => unary(f32::sqrt),
        "Exp" => unary(libm::expf),
        "Log" => unary(libm::logf),
        "Sin" => unary(libm::sinf),
        "Cos" => unary(libm::cosf),
        "Atan" => unary(libm::atanf),
        "Erf" => unary(libm::erff),
        "Tanh" => unary(libm::tanhf),
        "Sigmoid" => unary(sigmoid),
        "Relu" => unary(|x| if x < 0.0 { 0.0 } else { x }),
        "LeakyRelu" => {
            let alpha = alpha(0.01);
            unary(move |x| if x < 0.0 { alpha * x } else { x })
        }
        "Elu" => {
            let alpha = alpha(1.0);
            unary(move |x| if x < 0.0 { alpha * libm::expm1f(x) } else { x })
        }
        "Celu" => {
            let alpha = alpha(1.0);
            unary(move |x| if x < 0.0 { alpha * libm::expm1f(x / alpha) } else { x })
        }
        "Selu" => {
            let (alpha, gamma) = (alpha(1.673_263_2), of.float("gamma", 1.050_701));
            unary(move |x| gamma * if x < 0.0 { alpha * libm::expm1f(x) } else { x })
        }
        "Softplus" => unary(softplus),
        "Softsign" => unary(|x| x / (1.0 + x.abs())),
        "HardSigmoid" => {
            let (alpha, beta) = (alpha(0.2), of.float("beta", 0.5));
            unary(move |x| (alpha * x + beta).clamp(0.0, 1.0))
        }
        "HardSwish" => unary(|x| x * (x / 6.0 + 0.5).clamp(0.0, 1.0)),
        "Mish" => unary(|x| x * libm::tanhf(softplus(x))),
        "Gelu" if of.text("approximate") == "tanh" => {
            unary(|x| 0.5 * x * (1.0 + libm::tanhf(0.797_884_6 * (x + 0.044_715 * x * x * x))))
        }
        "Gelu" => unary(|x| 0.5 * x * (1.0 + libm::erff(x * std::f32::consts::FRAC_1_SQRT_2))),
        "Add" => binary(|a, b| a + b, |a, b| Some(a.wrapping_add(b))),
        "Sub" => binary(|a, b| a - b, |a, b| Some(a.wrapping_sub(b))),
        "Mul" => binary(|a, b| a * b, |a, b| Some(a.wrapping_mul(b))),
        "Div" => binary(|a, b| a / b, i64::checked_div),
        "Pow" => binary(power, |a, b| a.checked_pow(u32::try_from(b).ok()?)),
        "PRelu" => binary(|x, slope| if x < 0.0 { slope * x } else { x }, |_, _| None),
        // Of what is not a number nothing else may come.
        "Min" => folded(|a, b| if a < b || a.is_nan() { a } else { b }, |a, b| Some(a.min(b))),
        "Max" => folded(|a, b| if a > b || a.is_nan() { a } else { b }, |a, b| Some(a.max(b))),
        "Less" => compared(|a, b| a < b, |a, b| a < b),
        "LessOrEqual" => compared(|a, b| a <= b, |a, b| a <= b),
        "Greater" => compared(|a, b| a > b, |a, b| a > b),
        "GreaterOrEqual" => compared(|a, b| a >= b, |a, b| a >= b),
        "Equal" => compared(|a, b| a == b, |a, b| a == b),
        "Not" => Box::new(|inputs| {
            let input = inputs.get(0)?;
            let ints = input.ints()?.iter().map(|truth| i64::from(*truth == 0)).collect();
            Ok(vec![Tensor::new(input.shape.clone(), Data::Ints(ints))?])
        }),
        "Where" => Box::new(|inputs| Ok(vec![chosen(inputs)?])),
        "Clip" => {
            let limits = (of.float("min", f32::MIN), of.float("max", f32::MAX));
            Box::new(move |inputs| Ok(vec![clipped(inputs, limits)?]))
        }
        _ => return Ok(None),
    }))
}

pub(super) fn sigmoid(x: f32) -> f32 {
    1.0 / (1.0 + libm::expf(-x))
}

fn softplus(x: f32) -> f32 {
    // What is large would overflow, and differs from its logarithm by less than a bit.
    if x > 20.0 { x } else { libm::log1pf(libm::expf(x)) }
}

fn power(base: f32, exponent: f32) -> f32 {
    if exponent == 2.0 { base * base } else { libm::powf(base, exponent) }
}

fn unary(compute: impl Fn(f32) -> f32 + Send + 'static) -> Operation {
    super::map(move |input| {
        let floats = input.floats()?.iter().map(|x| compute(*x)).collect();
        Tensor::floats_of(input.shape.clone(), floats)
    })
}

/// Applies one of the functions to the elements of both, where a dimension of 1 stands for any.
fn paired(
    a: &Tensor,
    b: &Tensor,
    floats: impl Fn(f32, f32) -> f32,
    ints: impl Fn(i64, i64) -> Option<i64>,
) -> Result<Tensor, String> {
    let shape = broadcast(&a.shape, &b.shape)?;
    let data = match (&a.data, &b.data) {
        (Data::Floats(a_floats), Data::Floats(b_floats)) if a.shape == b.shape => {
            Data::Floats(a_floats.iter().zip(b_floats).map(|(a, b)| floats(*a, *b)).collect())
        }
        (Data::Floats(a_floats), Data::Floats(b_floats)) => {
            let pairs = places(&a.shape, &shape).into_iter().zip(places(&b.shape, &shape));
            Data::Floats(pairs.map(|(at, bt)| floats(a_floats[at], b_floats[bt])).collect())
        }
        (Data::Ints(a_ints), Data::Ints(b_ints)) => {
            let pairs = places(&a.shape, &shape).into_iter().zip(places(&b.shape, &shape));
            let found = pairs.map(|(at, bt)| ints(a_ints[at], b_ints[bt])).collect::<Option<_>>();
            Data::Ints(found.ok_or("is not possible with these integers")?)
        }
        _ => return Err("is given integers and floating-point numbers at once".to_owned()),
    };
    Tensor::new(shape, data)
}

fn binary(
    floats: impl Fn(f32, f32) -> f32 + Send + 'static,
    ints: impl Fn(i64, i64) -> Option<i64> + Send + 'static,
) -> Operation {
    Box::new(move |inputs| Ok(vec![paired(inputs.get(0)?, inputs.get(1)?, &floats, &ints)?]))
}

fn folded(
    floats: impl Fn(f32, f32) -> f32 + Send + 'static,
    ints: impl Fn(i64, i64) -> Option<i64> + Send + 'static,
) -> Operation {
    Box::new(move |inputs| {
        let first = inputs.get(0)?.clone();
        Ok(vec![inputs.all().skip(1).try_fold(first, |all, next| paired(&all, next, &floats, &ints))?])
    })
}

fn compared(
    floats: impl Fn(f32, f32) -> bool + Send + 'static,
    ints: impl Fn(i64, i64) -> bool + Send + 'static,
) -> Operation {
    Box::new(move |inputs| {
        let truth = |a, b| if floats(a, b) { 1.0 } else { 0.0 };
        let found = paired(inputs.get(0)?, inputs.get(1)?, truth, |a, b| Some(i64::from(ints(a, b))))?;
        let data = match found.data {
            Data::Floats(floats) => Data::Ints(floats.iter().map(|truth| i64::from(*truth != 0.0)).collect()),
            ints @ Data::Ints(_) => ints,
        };
        Ok(vec![Tensor::new(found.shape, data)?])
    })
}

fn chosen(inputs: &Inputs<'_>) -> Result<Tensor, String> {
    let (condition, a, b) = (inputs.get(0)?, inputs.get(1)?, inputs.get(2)?);
    let shape = broadcast(&broadcast(&condition.shape, &a.shape)?, &b.shape)?;
    let truths = condition.ints()?;
    let truths = places(&condition.shape, &shape).into_iter().map(|place| truths[place] != 0);
    // Of each element of the result its place in `a`, or behind all of `a` that in `b`.
    let from = truths.zip(places(&a.shape, &shape)).zip(places(&b.shape, &shape));
    let places = from.map(|((is_a, in_a), in_b)| if is_a { in_a } else { a.len() + in_b });
    let both = match (&a.data, &b.data) {
        (Data::Floats(a), Data::Floats(b)) => Data::Floats([&a[..], b].concat()),
        (Data::Ints(a), Data::Ints(b)) => Data::Ints([&a[..], b].concat()),
        _ => return Err("is given integers and floating-point numbers at once".to_owned()),
    };
    Tensor::new(vec![a.len() + b.len()], both)?.pick(shape, places)
}

/// The limits are inputs, or attributes in older versions.
fn clipped(inputs: &Inputs<'_>, (low, high): (f32, f32)) -> Result<Tensor, String> {
    let limit = |place, default| inputs.optional(place).map_or(Ok(default), Tensor::scalar);
    let (low, high) = (limit(1, low)?, limit(2, high)?);
    let input = inputs.get(0)?;
    if low.is_nan() || high.is_nan() || low > high {
        return Err(format!("has the limits {low} and {high}"));
    }
    let floats = input.floats()?.iter().map(|x| x.clamp(low, high)).collect();
    Tensor::floats_of(input.shape.clone(), floats)
}
