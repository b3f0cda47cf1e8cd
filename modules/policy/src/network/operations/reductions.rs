//! Operations over all elements along an axis, and normalisations.

use super::super::tensor::{Data, Tensor, axis, text};
use super::{Described, Inputs, Operation, map};

pub(super) fn operation(of: &Described<'_>) -> Result<Option<Operation>, String> {
    let sum = |row: &[f32]| row.iter().fold(0.0, |sum, x| sum + x);
    Ok(Some(match of.node.operation.as_str() {
        "ReduceSum" => reduction(of, sum),
        "ReduceMean" => reduction(of, move |row| sum(row) / row.len() as f32),
        "ReduceMax" => reduction(of, |row| row.iter().copied().fold(f32::NEG_INFINITY, f32::max)),
        "ReduceMin" => reduction(of, |row| row.iter().copied().fold(f32::INFINITY, f32::min)),
        "ReduceL2" => reduction(of, |row| row.iter().fold(0.0, |sum, x| sum + x * x).sqrt()),
        "ArgMax" => {
            let (along, keeps) = (of.int("axis", 0), of.int("keepdims", 1) != 0);
            of.only("select_last_index", 0)?;
            map(move |input| largest(input, along, keeps))
        }
        "Softmax" => softmax(of, |exp, sum, _| exp / sum),
        "LogSoftmax" => softmax(of, |_, sum, x| x - libm::logf(sum)),
        "LayerNormalization" => {
            let (from, epsilon) = (of.int("axis", -1), of.float("epsilon", 1e-5));
            Box::new(move |inputs| Ok(vec![layer_normalised(inputs, from, epsilon)?]))
        }
        "BatchNormalization" => {
            of.only("training_mode", 0)?;
            let epsilon = of.float("epsilon", 1e-5);
            Box::new(move |inputs| Ok(vec![batch_normalised(inputs, epsilon)?]))
        }
        _ => return Ok(None),
    }))
}

/// The axes are an attribute or, in newer versions, the second input; without any they are all.
fn reduction(of: &Described<'_>, reduce: impl Fn(&[f32]) -> f32 + Send + 'static) -> Operation {
    let (given, keeps) = (of.ints("axes"), of.int("keepdims", 1) != 0);
    let keeps_without_axes = of.int("noop_with_empty_axes", 0) != 0;
    Box::new(move |inputs| {
        let input = inputs.get(0)?;
        let dimensions = input.shape.len();
        let axes = inputs.optional(1).map(Tensor::ints).transpose()?.or(given.as_deref()).unwrap_or_default();
        if axes.is_empty() && keeps_without_axes {
            return Ok(vec![input.clone()]);
        }
        let mut reduced = axes.iter().map(|place| axis(*place, dimensions)).collect::<Result<Vec<_>, _>>()?;
        if axes.is_empty() {
            reduced = (0..dimensions).collect();
        }
        let kept: Vec<usize> = (0..dimensions).filter(|place| !reduced.contains(place)).collect();
        // What is reduced comes last, in its own order.
        reduced.sort_unstable();
        reduced.dedup();
        let order: Vec<i64> = kept.iter().chain(&reduced).map(|place| *place as i64).collect();
        let rows = super::layout::transposed(input, Some(&order))?;
        let length: usize = reduced.iter().map(|place| input.shape[*place]).product();
        let found = rows.floats()?.chunks(length.max(1)).map(&reduce).collect();
        let size = |place: usize| match (reduced.contains(&place), keeps) {
            (false, _) => Some(input.shape[place]),
            (true, true) => Some(1),
            (true, false) => None,
        };
        Ok(vec![Tensor::floats_of((0..dimensions).filter_map(size).collect(), found)?])
    })
}

/// The place of the largest element along an axis, the first of several.
fn largest(input: &Tensor, along: i64, keeps: bool) -> Result<Tensor, String> {
    let along = axis(along, input.shape.len())?;
    let (before, size, behind) = input.around(along);
    let floats = input.floats()?;
    let rows = (0..before).flat_map(|row| (0..behind).map(move |column| (row, column)));
    let place = |(row, column): (usize, usize)| {
        let at = |place: usize| floats[(row * size + place) * behind + column];
        (1..size).fold(0, |best, place| if at(place) > at(best) { place } else { best }) as i64
    };
    let mut shape = input.shape.clone();
    if keeps {
        shape[along] = 1;
    } else {
        shape.remove(along);
    }
    if size == 0 {
        return Err("looks for the largest of no numbers".to_owned());
    }
    Tensor::new(shape, Data::Ints(rows.map(place).collect()))
}

/// `finish` takes the exponential of an element, their sum, and the element less the largest.
fn softmax(of: &Described<'_>, finish: impl Fn(f32, f32, f32) -> f32 + Send + 'static) -> Operation {
    // Older versions take all dimensions from the axis on as one.
    let is_old = of.opset < 13;
    let along = of.int("axis", if is_old { 1 } else { -1 });
    map(move |input| {
        let along = axis(along, input.shape.len())?;
        let (before, mut size, mut behind) = input.around(along);
        if is_old {
            (size, behind) = (size * behind, 1);
        }
        let mut floats = input.floats()?.to_vec();
        for (row, column) in (0..before).flat_map(|row| (0..behind).map(move |column| (row, column))) {
            let places = (0..size).map(|place| (row * size + place) * behind + column);
            let most = places.clone().fold(f32::NEG_INFINITY, |most, place| most.max(floats[place]));
            let sum = places.clone().fold(0.0, |sum, place| sum + libm::expf(floats[place] - most));
            for place in places {
                let x = floats[place] - most;
                floats[place] = finish(libm::expf(x), sum, x);
            }
        }
        Tensor::floats_of(input.shape.clone(), floats)
    })
}

fn layer_normalised(inputs: &Inputs<'_>, from: i64, epsilon: f32) -> Result<Tensor, String> {
    let input = inputs.get(0)?;
    let from = axis(from, input.shape.len())?;
    let length = input.shape[from..].iter().product::<usize>().max(1);
    let (scale, bias) = (inputs.get(1)?.floats()?, inputs.optional(2).map(Tensor::floats).transpose()?);
    if scale.len() != length || bias.is_some_and(|bias| bias.len() != length) {
        return Err(format!("has no scale or bias for {}", text(&input.shape[from..])));
    }
    let mut floats = input.floats()?.to_vec();
    for row in floats.chunks_mut(length) {
        let mean = row.iter().fold(0.0, |sum, x| sum + x) / length as f32;
        let variance = row.iter().fold(0.0, |sum, x| sum + (x - mean) * (x - mean)) / length as f32;
        let deviation = (variance + epsilon).sqrt();
        for (place, x) in row.iter_mut().enumerate() {
            *x = (*x - mean) / deviation * scale[place] + bias.map_or(0.0, |bias| bias[place]);
        }
    }
    Tensor::floats_of(input.shape.clone(), floats)
}

fn batch_normalised(inputs: &Inputs<'_>, epsilon: f32) -> Result<Tensor, String> {
    let input = inputs.get(0)?;
    let &[_, channels, ref behind @ ..] = &input.shape[..] else {
        return Err(format!("takes channels, and is given {}", text(&input.shape)));
    };
    let mut of_channels = [&[][..]; 4];
    for (place, numbers) in of_channels.iter_mut().enumerate() {
        *numbers = inputs.get(place + 1)?.floats()?;
        if numbers.len() != channels {
            return Err(format!("has {} numbers for {channels} channels", numbers.len()));
        }
    }
    let [scale, bias, mean, variance] = of_channels;
    let plane = behind.iter().product::<usize>().max(1);
    let mut floats = input.floats()?.to_vec();
    for (number, row) in floats.chunks_mut(plane).enumerate() {
        let channel = number % channels.max(1);
        let factor = scale[channel] / (variance[channel] + epsilon).sqrt();
        row.iter_mut().for_each(|x| *x = (*x - mean[channel]) * factor + bias[channel]);
    }
    Tensor::floats_of(input.shape.clone(), floats)
}
