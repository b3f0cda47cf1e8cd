//! Products of matrices, and convolutions.

use super::super::tensor::{Tensor, broadcast, count, places, text};
use super::layout::transposed;
use super::{Described, Inputs, Operation};

pub(super) fn operation(of: &Described<'_>) -> Result<Option<Operation>, String> {
    Ok(Some(match of.node.operation.as_str() {
        "MatMul" => Box::new(|inputs| Ok(vec![product(inputs.get(0)?, inputs.get(1)?)?])),
        "Gemm" => gemm(of)?,
        "Conv" => convolution(of)?,
        _ => return Ok(None),
    }))
}

/// Adds the product of a row with a matrix of `row.len()` rows to `sum`. Each element of the sum is added up
/// in the order of the row, so that vector instructions of any width give the same bits.
pub(super) fn add_product(row: &[f32], matrix: &[f32], sum: &mut [f32]) {
    let width = sum.len();
    if width == 0 {
        return;
    }
    let (fours, rest) = row.as_chunks::<4>();
    let mut lines = matrix.chunks_exact(width);
    for &[a, b, c, d] in fours {
        // Four lines at once, as the sum need not be loaded and stored so often.
        let (Some(of_a), Some(of_b), Some(of_c), Some(of_d)) =
            (lines.next(), lines.next(), lines.next(), lines.next())
        else {
            return;
        };
        for ((((sum, of_a), of_b), of_c), of_d) in sum.iter_mut().zip(of_a).zip(of_b).zip(of_c).zip(of_d) {
            *sum = *sum + a * of_a + b * of_b + c * of_c + d * of_d;
        }
    }
    for (x, line) in rest.iter().zip(lines) {
        for (sum, weight) in sum.iter_mut().zip(line) {
            *sum += x * weight;
        }
    }
}

/// The product of two tensors: of their last two dimensions, for all that come before. Of a vector, as the
/// first, it is that of a row; as the second, of a column.
fn product(a: &Tensor, b: &Tensor) -> Result<Tensor, String> {
    let misfit = || format!("cannot multiply {} by {}", text(&a.shape), text(&b.shape));
    let a_shape = if let [size] = a.shape[..] { vec![1, size] } else { a.shape.clone() };
    let b_shape = if let [size] = b.shape[..] { vec![size, 1] } else { b.shape.clone() };
    let ([a_before @ .., rows, inner], [b_before @ .., b_inner, columns]) = (&a_shape[..], &b_shape[..])
    else {
        return Err(misfit());
    };
    // One matrix for all, or one for each.
    if inner != b_inner || !(b_before.is_empty() || a_before == b_before) {
        return Err(misfit());
    }
    let mut shape = a_before.to_vec();
    shape.extend((a.shape.len() > 1).then_some(*rows));
    shape.extend((b.shape.len() > 1).then_some(*columns));
    let mut found = vec![0.0; count(&shape)?];
    let (a_floats, b_floats) = (a.floats()?, b.floats()?);
    for (number, (row, sum)) in
        a_floats.chunks(*inner.max(&1)).zip(found.chunks_mut(*columns.max(&1))).enumerate()
    {
        let matrix = if b_before.is_empty() { 0 } else { number / rows };
        add_product(row, &b_floats[matrix * inner * columns..], sum);
    }
    Tensor::floats_of(shape, found)
}

fn gemm(of: &Described<'_>) -> Result<Operation, String> {
    let (alpha, beta) = (of.float("alpha", 1.0), of.float("beta", 1.0));
    let is_transposed = ["transA", "transB"].map(|name| of.int(name, 0) != 0);
    // Once, instead of in each run.
    let weights =
        of.constant(1).filter(|_| is_transposed[1]).map(|weights| transposed(weights, None)).transpose()?;
    Ok(Box::new(move |inputs| {
        let turned = |place: usize| {
            let input = inputs.get(place)?;
            is_transposed[place].then(|| transposed(input, None)).transpose()
        };
        let a = turned(0)?;
        let b = if weights.is_some() { None } else { turned(1)? };
        let a = a.as_ref().map_or_else(|| inputs.get(0), Ok)?;
        let b = weights.as_ref().or(b.as_ref()).map_or_else(|| inputs.get(1), Ok)?;
        if a.shape.len() != 2 || b.shape.len() != 2 {
            return Err(format!("cannot multiply {} by {}", text(&a.shape), text(&b.shape)));
        }
        let mut found = product(a, b)?;
        let columns = b.shape[1].max(1);
        let shape = std::mem::take(&mut found.shape);
        let mut floats = found.floats()?.to_vec();
        if alpha != 1.0 {
            floats.iter_mut().for_each(|x| *x *= alpha);
        }
        if let Some(added) = inputs.optional(2) {
            let places = places(&added.shape, &shape);
            if broadcast(&added.shape, &shape)? != shape {
                return Err(format!("cannot add {} to {}", text(&added.shape), text(&shape)));
            }
            let added = added.floats()?;
            for (row, places) in floats.chunks_mut(columns).zip(places.chunks(columns)) {
                row.iter_mut().zip(places).for_each(|(x, place)| *x += beta * added[*place]);
            }
        }
        Ok(vec![Tensor::floats_of(shape, floats)?])
    }))
}

/// A convolution in one or two dimensions.
fn convolution(of: &Described<'_>) -> Result<Operation, String> {
    if !matches!(of.text("auto_pad"), "" | "NOTSET" | "VALID") {
        return Err(format!("has auto_pad = {}; export it with pads", of.text("auto_pad")));
    }
    let sizes = |name: &str, default: usize| {
        let given = of.ints(name).unwrap_or_default();
        let sizes = given.iter().map(|size| usize::try_from(*size).ok()).collect::<Option<Vec<_>>>();
        let sizes = sizes.filter(|sizes| sizes.iter().all(|size| *size <= u32::MAX as usize));
        let sizes = sizes.ok_or_else(|| format!("has {name} = {given:?}"))?;
        Ok::<_, String>(move |place: usize| sizes.get(place).copied().unwrap_or(default))
    };
    let (stride, dilation, pad) = (sizes("strides", 1)?, sizes("dilations", 1)?, sizes("pads", 0)?);
    let groups = usize::try_from(of.int("group", 1)).unwrap_or(0);
    Ok(Box::new(move |inputs| {
        let (input, kernel) = (inputs.get(0)?, inputs.get(1)?);
        let misfit = || format!("cannot fold {} with {}", text(&input.shape), text(&kernel.shape));
        let (&[batch, channels, ref space @ ..], &[filters, depth, ref window @ ..]) =
            (&input.shape[..], &kernel.shape[..])
        else {
            return Err(misfit());
        };
        let dimensions = space.len();
        let fits = groups > 0 && channels == depth * groups && filters % groups == 0;
        if !fits || !(1..=2).contains(&dimensions) || window.len() != dimensions {
            return Err(misfit());
        }
        let size = |place: usize| {
            let padded = space[place] + pad(place) + pad(place + dimensions);
            let reach = window[place].checked_sub(1)?.checked_mul(dilation(place))?;
            Some(padded.checked_sub(reach + 1)? / stride(place).max(1) + 1)
        };
        let sizes = (0..dimensions).map(size).collect::<Option<Vec<_>>>().ok_or_else(misfit)?;
        let shape = [&[batch, filters], &sizes[..]].concat();
        let mut found = Vec::with_capacity(count(&shape)?);
        // One dimension is two, of which the first is 1.
        let two = |sizes: &[usize], one: usize| match *sizes {
            [width] => [one, width],
            [height, width] => [height, width],
            _ => [0, 0],
        };
        let of_axis = |value: &dyn Fn(usize) -> usize, none: usize| {
            if dimensions == 1 { [none, value(0)] } else { [value(0), value(1)] }
        };
        let ([height, width], [tall, wide]) = (two(space, 1), two(window, 1));
        let [rows, columns] = two(&sizes, 1);
        let (stride, dilation, pad) = (of_axis(&stride, 1), of_axis(&dilation, 1), of_axis(&pad, 0));
        let (pixels, weights) = (input.floats()?, kernel.floats()?);
        let bias = inputs.optional(2).map(Tensor::floats).transpose()?;
        if bias.is_some_and(|bias| bias.len() != filters) {
            return Err(misfit());
        }
        let inside = |index: usize, tap: usize, axis: usize, size: usize| {
            let place = (index * stride[axis] + tap * dilation[axis]).checked_sub(pad[axis])?;
            (place < size).then_some(place)
        };
        for image in 0..batch {
            for filter in 0..filters {
                let group = filter / (filters / groups);
                for (row, column) in (0..rows).flat_map(|row| (0..columns).map(move |column| (row, column))) {
                    let mut sum = bias.map_or(0.0, |bias| bias[filter]);
                    for channel in 0..depth {
                        let plane = (image * channels + group * depth + channel) * height * width;
                        let taps = (filter * depth + channel) * tall * wide;
                        for tap in 0..tall {
                            let Some(y) = inside(row, tap, 0, height) else { continue };
                            for across in 0..wide {
                                let Some(x) = inside(column, across, 1, width) else { continue };
                                sum += pixels[plane + y * width + x] * weights[taps + tap * wide + across];
                            }
                        }
                    }
                    found.push(sum);
                }
            }
        }
        Ok(vec![Tensor::floats_of(shape, found)?])
    }))
}

/// The inputs as rows, which a network with memory takes one after another.
pub(super) fn rows<'a>(inputs: &Inputs<'a>, place: usize, width: usize) -> Result<&'a [f32], String> {
    let input = inputs.get(place)?;
    if width == 0 || input.len() % width != 0 {
        return Err(format!("cannot take {} in rows of {width}", text(&input.shape)));
    }
    input.floats()
}
