//! Operations that move elements, and change none.

use super::super::tensor::{Data, MOST_ELEMENTS, Tensor, axis, broadcast, count, places, walk};
use super::{Described, Inputs, Operation, map};

pub(super) fn operation(of: &Described<'_>) -> Result<Option<Operation>, String> {
    Ok(Some(match of.node.operation.as_str() {
        // Dropout drops nothing once a network has been trained.
        "Identity" | "Dropout" => map(|input| Ok(input.clone())),
        "Constant" => {
            let value = constant(of)?;
            Box::new(move |_| Ok(vec![value.clone()]))
        }
        "ConstantOfShape" => {
            let value = of.attribute("value").and_then(|value| value.tensor.clone());
            let value = value.map_or_else(|| Tensor::floats_of(vec![1], vec![0.0]), Ok)?;
            map(move |shape| {
                let shape = shape.sizes()?;
                let count = count(&shape)?;
                value.pick(shape, std::iter::repeat_n(0, count))
            })
        }
        "Shape" => map(|input| Ok(Tensor::ints_of(input.shape.iter().map(|size| *size as i64).collect()))),
        "Cast" => {
            let kind = of.int("to", 1);
            map(move |input| cast(input, kind))
        }
        "Reshape" => {
            of.only("allowzero", 0)?;
            Box::new(|inputs| Ok(vec![reshaped(inputs.get(0)?, inputs.get(1)?.ints()?)?]))
        }
        "Flatten" => {
            let from = of.int("axis", 1);
            map(move |input| {
                let dimensions = input.shape.len();
                let axis = if from == dimensions as i64 { dimensions } else { axis(from, dimensions)? };
                let (front, back) = input.shape.split_at(axis);
                input.with_shape(vec![front.iter().product(), back.iter().product()])
            })
        }
        "Squeeze" => with_axes(of, squeezed),
        "Unsqueeze" => with_axes(of, unsqueezed),
        "Transpose" => {
            let order = of.ints("perm");
            map(move |input| transposed(input, order.as_deref()))
        }
        "Expand" => Box::new(|inputs| {
            let input = inputs.get(0)?;
            let shape = broadcast(&input.shape, &inputs.get(1)?.sizes()?)?;
            Ok(vec![input.pick(shape.clone(), places(&input.shape, &shape).into_iter())?])
        }),
        "Concat" => {
            let axis = of.int("axis", 0);
            Box::new(move |inputs| Ok(vec![joined(inputs, axis)?]))
        }
        "Split" => {
            let (along, sizes) = (of.int("axis", 0), of.ints("split"));
            let parts = of.node.outputs.len();
            Box::new(move |inputs| split(inputs, along, sizes.as_deref(), parts))
        }
        "Slice" => {
            let given = ["starts", "ends", "axes"].map(|name| of.ints(name));
            Box::new(move |inputs| Ok(vec![sliced(inputs, &given)?]))
        }
        "Gather" => {
            let along = of.int("axis", 0);
            Box::new(move |inputs| Ok(vec![gathered(inputs.get(0)?, inputs.get(1)?, along)?]))
        }
        _ => return Ok(None),
    }))
}

fn constant(of: &Described<'_>) -> Result<Tensor, String> {
    let (name, attribute) = of.node.attributes.first_key_value().ok_or("has no value")?;
    match name.as_str() {
        "value" => attribute.tensor.clone().ok_or_else(|| "has no value".to_owned()),
        "value_float" => Tensor::floats_of(Vec::new(), vec![attribute.float]),
        "value_floats" => Tensor::floats_of(vec![attribute.floats.len()], attribute.floats.clone()),
        "value_int" => Tensor::new(Vec::new(), Data::Ints(vec![attribute.int])),
        "value_ints" => Ok(Tensor::ints_of(attribute.ints.clone())),
        other => Err(format!("has a {other}, which is not supported")),
    }
}

/// The numbers of TensorProto.DataType.
fn cast(input: &Tensor, kind: i64) -> Result<Tensor, String> {
    let data = match (&input.data, kind) {
        (Data::Floats(floats), 1 | 11) => Data::Floats(floats.clone()),
        (Data::Ints(ints), 1 | 11) => Data::Floats(ints.iter().map(|int| *int as f32).collect()),
        (Data::Floats(floats), 6 | 7) => Data::Ints(floats.iter().map(|float| *float as i64).collect()),
        (Data::Floats(floats), 9) => {
            Data::Ints(floats.iter().map(|float| i64::from(*float != 0.0)).collect())
        }
        (Data::Ints(ints), 6 | 7) => Data::Ints(ints.clone()),
        (Data::Ints(ints), 9) => Data::Ints(ints.iter().map(|int| i64::from(*int != 0)).collect()),
        _ => {
            return Err(format!(
                "makes elements of type {kind}; float, double, int32, int64 and bool are possible"
            ));
        }
    };
    Tensor::new(input.shape.clone(), data)
}

/// 0 keeps a size, and -1 is what remains.
fn reshaped(input: &Tensor, wanted: &[i64]) -> Result<Tensor, String> {
    let size = |(place, size): (usize, &i64)| match size {
        0 => input.shape.get(place).copied(),
        -1 => Some(1),
        size => usize::try_from(*size).ok(),
    };
    let shape = wanted.iter().enumerate().map(size).collect::<Option<Vec<_>>>();
    let mut shape = shape.ok_or_else(|| format!("cannot give a tensor the shape {wanted:?}"))?;
    if let Some(rest) = wanted.iter().position(|size| *size == -1) {
        shape[rest] = input.len().checked_div(count(&shape)?).unwrap_or(0);
    }
    input.with_shape(shape)
}

/// An operation whose axes are an attribute or, in newer versions, the second input.
fn with_axes(
    of: &Described<'_>,
    compute: impl Fn(&Tensor, Option<&[i64]>) -> Result<Tensor, String> + Send + 'static,
) -> Operation {
    let given = of.ints("axes");
    Box::new(move |inputs| {
        let axes = inputs.optional(1).map(Tensor::ints).transpose()?.or(given.as_deref());
        Ok(vec![compute(inputs.get(0)?, axes)?])
    })
}

fn squeezed(input: &Tensor, axes: Option<&[i64]>) -> Result<Tensor, String> {
    let dimensions = input.shape.len();
    let removed: Vec<usize> = match axes {
        Some(axes) => axes.iter().map(|place| axis(*place, dimensions)).collect::<Result<_, _>>()?,
        None => (0..dimensions).filter(|place| input.shape[*place] == 1).collect(),
    };
    let kept = (0..dimensions).filter(|place| !removed.contains(place));
    input.with_shape(kept.map(|place| input.shape[place]).collect())
}

fn unsqueezed(input: &Tensor, axes: Option<&[i64]>) -> Result<Tensor, String> {
    let axes = axes.ok_or("lacks its axes")?;
    let dimensions = input.shape.len() + axes.len();
    let added = axes.iter().map(|place| axis(*place, dimensions)).collect::<Result<Vec<_>, _>>()?;
    let mut rest = input.shape.iter();
    let shape =
        (0..dimensions).map(|place| if added.contains(&place) { Some(1) } else { rest.next().copied() });
    input.with_shape(shape.collect::<Option<_>>().ok_or("has the same axis twice")?)
}

pub(super) fn transposed(input: &Tensor, order: Option<&[i64]>) -> Result<Tensor, String> {
    let dimensions = input.shape.len();
    let order: Vec<usize> = match order {
        Some(order) => order.iter().map(|place| axis(*place, dimensions)).collect::<Result<_, _>>()?,
        None => (0..dimensions).rev().collect(),
    };
    let stride = |axis: usize| input.shape[axis + 1..].iter().product();
    let shape: Vec<usize> = order.iter().map(|axis| input.shape[*axis]).collect();
    let strides: Vec<usize> = order.iter().map(|axis| stride(*axis)).collect();
    input.pick(shape.clone(), walk(&shape, &strides).into_iter())
}

fn joined(inputs: &Inputs<'_>, along: i64) -> Result<Tensor, String> {
    let first = inputs.get(0)?;
    let along = axis(along, first.shape.len())?;
    let mut shape = first.shape.clone();
    shape[along] = 0;
    for input in inputs.all() {
        let mut others = input.shape.clone();
        let size = others.get_mut(along).map(std::mem::take);
        let is_alike = others.iter().enumerate().all(|(place, size)| place == along || shape[place] == *size);
        let (Some(size), true) = (size.filter(|_| others.len() == shape.len()), is_alike) else {
            return Err("joins tensors whose shapes do not fit".to_owned());
        };
        shape[along] += size;
    }
    let count = count(&shape)?;
    let before = shape[..along].iter().product::<usize>();
    fn rows<'a, T: Copy + 'a>(parts: &[(&'a [T], usize)], before: usize, count: usize) -> Vec<T> {
        let mut all = Vec::with_capacity(count);
        for row in 0..before {
            for (elements, length) in parts {
                all.extend_from_slice(&elements[row * length..(row + 1) * length]);
            }
        }
        all
    }
    let length = |input: &Tensor| input.shape[along..].iter().product();
    let data = match &first.data {
        Data::Floats(_) => {
            let parts = inputs.all().map(|input| Ok((input.floats()?, length(input))));
            Data::Floats(rows(&parts.collect::<Result<Vec<_>, String>>()?, before, count))
        }
        Data::Ints(_) => {
            let parts = inputs.all().map(|input| Ok((input.ints()?, length(input))));
            Data::Ints(rows(&parts.collect::<Result<Vec<_>, String>>()?, before, count))
        }
    };
    Tensor::new(shape, data)
}

/// Some of the elements along an axis.
fn along(input: &Tensor, axis: usize, chosen: &[usize]) -> Result<Tensor, String> {
    let (before, size, behind) = input.around(axis);
    let mut shape = input.shape.clone();
    shape[axis] = chosen.len();
    count(&shape)?;
    let rows = (0..before).flat_map(|row| chosen.iter().map(move |place| row * size + place));
    input.pick(shape, rows.flat_map(|start| start * behind..(start + 1) * behind))
}

fn split(
    inputs: &Inputs<'_>,
    axis_: i64,
    sizes: Option<&[i64]>,
    parts: usize,
) -> Result<Vec<Tensor>, String> {
    let input = inputs.get(0)?;
    let axis = axis(axis_, input.shape.len())?;
    let size = input.shape[axis];
    let sizes: Vec<usize> = match inputs.optional(1).map(Tensor::ints).transpose()?.or(sizes) {
        Some(sizes) => sizes.iter().map(|size| usize::try_from(*size).unwrap_or(0)).collect(),
        None => {
            let each = size.div_ceil(parts.max(1));
            (0..parts).map(|part| size.saturating_sub(part * each).min(each)).collect()
        }
    };
    if sizes.iter().try_fold(0_usize, |sum, size| sum.checked_add(*size)) != Some(size) {
        return Err(format!("cannot split {size} into {sizes:?}"));
    }
    let mut start = 0;
    let part = |size: &usize| {
        start += size;
        along(input, axis, &(start - size..start).collect::<Vec<_>>())
    };
    sizes.iter().map(part).collect()
}

/// Starts, ends, axes and steps are inputs, or attributes in older versions.
fn sliced(inputs: &Inputs<'_>, given: &[Option<Vec<i64>>; 3]) -> Result<Tensor, String> {
    let list = |place: usize| {
        let input = inputs.optional(place).map(|input| input.ints().map(<[i64]>::to_vec)).transpose()?;
        Ok::<_, String>(input.or_else(|| given.get(place - 1).cloned().flatten()))
    };
    let (starts, ends) = (list(1)?.ok_or("lacks its starts")?, list(2)?.ok_or("lacks its ends")?);
    let axes = list(3)?.unwrap_or_else(|| (0..starts.len() as i64).collect());
    let steps = list(4)?.unwrap_or_else(|| vec![1; starts.len()]);
    let mut found = inputs.get(0)?.clone();
    for (((start, end), along_), step) in starts.iter().zip(&ends).zip(&axes).zip(&steps) {
        let axis = axis(*along_, found.shape.len())?;
        let size = found.shape[axis] as i64;
        let from_start = |place: i64, low: i64, high: i64| {
            (if place < 0 { place.saturating_add(size) } else { place }).clamp(low, high)
        };
        let chosen: Vec<usize> = match *step {
            step @ 1.. => {
                let (start, end) = (from_start(*start, 0, size), from_start(*end, 0, size));
                (start..end).step_by(step as usize).map(|place| place as usize).collect()
            }
            step @ ..=-1 => {
                let (start, end) = (from_start(*start, -1, size - 1), from_start(*end, -1, size - 1));
                let step = usize::try_from(step.unsigned_abs()).unwrap_or(MOST_ELEMENTS);
                (end + 1..=start).rev().step_by(step).map(|place| place as usize).collect()
            }
            0 => return Err("has a step of 0".to_owned()),
        };
        found = along(&found, axis, &chosen)?;
    }
    Ok(found)
}

fn gathered(input: &Tensor, indices: &Tensor, along_: i64) -> Result<Tensor, String> {
    let axis_ = axis(along_, input.shape.len())?;
    let size = input.shape[axis_];
    let chosen = indices.ints()?.iter().map(|index| axis(*index, size)).collect::<Result<Vec<_>, _>>();
    let picked =
        along(input, axis_, &chosen.map_err(|_| format!("takes elements that a size of {size} has not"))?)?;
    let shape = [&input.shape[..axis_], &indices.shape, &input.shape[axis_ + 1..]].concat();
    picked.with_shape(shape)
}
