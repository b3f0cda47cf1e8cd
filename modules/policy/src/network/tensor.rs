//! Arrays of numbers with a shape.

/// The most elements of a tensor: a file cannot make the program allocate more.
pub(super) const MOST_ELEMENTS: usize = 1 << 26;

/// The elements, in the order in which the last index changes first.
#[derive(Clone, Debug, PartialEq)]
pub(super) enum Data {
    Floats(Vec<f32>),
    /// Of shapes and indices; truth is 1.
    Ints(Vec<i64>),
}

#[derive(Clone, Debug, PartialEq)]
pub(super) struct Tensor {
    pub(super) shape: Vec<usize>,
    pub(super) data: Data,
}

/// How many elements a shape has.
pub(super) fn count(shape: &[usize]) -> Result<usize, String> {
    let count = shape.iter().try_fold(1_usize, |count, dimension| count.checked_mul(*dimension));
    count.filter(|count| *count <= MOST_ELEMENTS).ok_or_else(|| {
        format!("a tensor of {} is larger than the {MOST_ELEMENTS} numbers that are possible", text(shape))
    })
}

/// A shape as people write it: `1 x 12`.
pub(super) fn text(shape: &[usize]) -> String {
    match shape {
        [] => "one number".to_owned(),
        _ => shape.iter().map(usize::to_string).collect::<Vec<_>>().join(" x "),
    }
}

impl Tensor {
    pub(super) fn new(shape: Vec<usize>, data: Data) -> Result<Self, String> {
        let found = match &data {
            Data::Floats(floats) => floats.len(),
            Data::Ints(ints) => ints.len(),
        };
        if count(&shape)? != found {
            return Err(format!("{found} numbers do not fill a shape of {}", text(&shape)));
        }
        Ok(Self { shape, data })
    }

    pub(super) fn floats_of(shape: Vec<usize>, floats: Vec<f32>) -> Result<Self, String> {
        Self::new(shape, Data::Floats(floats))
    }

    pub(super) fn ints_of(ints: Vec<i64>) -> Self {
        Self { shape: vec![ints.len()], data: Data::Ints(ints) }
    }

    pub(super) fn len(&self) -> usize {
        match &self.data {
            Data::Floats(floats) => floats.len(),
            Data::Ints(ints) => ints.len(),
        }
    }

    pub(super) fn floats(&self) -> Result<&[f32], String> {
        match &self.data {
            Data::Floats(floats) => Ok(floats),
            Data::Ints(_) => Err("takes floating-point numbers, and is given integers".to_owned()),
        }
    }

    pub(super) fn ints(&self) -> Result<&[i64], String> {
        match &self.data {
            Data::Ints(ints) => Ok(ints),
            Data::Floats(_) => Err("takes integers, and is given floating-point numbers".to_owned()),
        }
    }

    /// Its integers as sizes or positions, where negative ones are not possible.
    pub(super) fn sizes(&self) -> Result<Vec<usize>, String> {
        let size = |int: &i64| usize::try_from(*int).map_err(|_| format!("{int} is no size"));
        self.ints()?.iter().map(size).collect()
    }

    /// Its only number.
    pub(super) fn scalar(&self) -> Result<f32, String> {
        match &self.data {
            Data::Floats(floats) if floats.len() == 1 => Ok(floats[0]),
            Data::Ints(ints) if ints.len() == 1 => Ok(ints[0] as f32),
            _ => Err(format!("takes one number, and is given {}", text(&self.shape))),
        }
    }

    pub(super) fn with_shape(&self, shape: Vec<usize>) -> Result<Self, String> {
        Self::new(shape, self.data.clone())
    }

    /// The elements at these places, in a new shape.
    pub(super) fn pick(
        &self,
        shape: Vec<usize>,
        places: impl Iterator<Item = usize>,
    ) -> Result<Self, String> {
        count(&shape)?;
        const MISSING: &str = "an index is outside of the tensor";
        let data = match &self.data {
            Data::Floats(all) => {
                let picked = places.map(|place| all.get(place).copied()).collect::<Option<_>>();
                Data::Floats(picked.ok_or(MISSING)?)
            }
            Data::Ints(all) => {
                let picked = places.map(|place| all.get(place).copied()).collect::<Option<_>>();
                Data::Ints(picked.ok_or(MISSING)?)
            }
        };
        Self::new(shape, data)
    }

    /// How many elements lie before this axis, along it, and behind it.
    pub(super) fn around(&self, axis: usize) -> (usize, usize, usize) {
        let before = self.shape[..axis].iter().product();
        (before, self.shape[axis], self.shape[axis + 1..].iter().product())
    }
}

/// An axis, which counts from the end if it is negative.
pub(super) fn axis(axis: i64, dimensions: usize) -> Result<usize, String> {
    let from_start = if axis < 0 { axis.saturating_add(dimensions as i64) } else { axis };
    usize::try_from(from_start)
        .ok()
        .filter(|axis| *axis < dimensions)
        .ok_or_else(|| format!("there is no axis {axis} in {dimensions} dimensions"))
}

/// The shape of both, where a dimension of 1 stands for any.
pub(super) fn broadcast(a: &[usize], b: &[usize]) -> Result<Vec<usize>, String> {
    let dimensions = a.len().max(b.len());
    let dimension = |shape: &[usize], place: usize| {
        (place + shape.len()).checked_sub(dimensions).map_or(1, |place| shape[place])
    };
    let both = (0..dimensions).map(|place| match (dimension(a, place), dimension(b, place)) {
        (a, b) if a == b => Ok(a),
        (1, other) | (other, 1) => Ok(other),
        _ => Err(format!("the shapes {} and {} do not fit", text(a), text(b))),
    });
    let both = both.collect::<Result<Vec<_>, _>>()?;
    count(&both)?;
    Ok(both)
}

/// For each element of `wide` the place of its element in `narrow`, which was broadcast to it.
pub(super) fn places(narrow: &[usize], wide: &[usize]) -> Vec<usize> {
    let mut strides = vec![0; wide.len()];
    let mut stride = 1;
    for (place, dimension) in narrow.iter().enumerate().rev() {
        if *dimension != 1 {
            strides[place + wide.len() - narrow.len()] = stride;
        }
        stride *= dimension;
    }
    walk(wide, &strides)
}

/// The places of all elements of a shape, if a step along each axis is so long.
pub(super) fn walk(shape: &[usize], strides: &[usize]) -> Vec<usize> {
    let mut found = vec![0];
    for (dimension, stride) in shape.iter().zip(strides) {
        found =
            found.iter().flat_map(|start| (0..*dimension).map(move |index| start + index * stride)).collect();
    }
    found
}
