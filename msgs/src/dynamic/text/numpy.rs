//! Arrays of numbers as printed by NumPy, in which rclpy stores fixed arrays.
//!
//! # References
//! `numpy/_core/arrayprint.py` of NumPy 2 (`FloatingFormat`, `IntegerFormat`, `_formatArray`,
//! `_array_repr_implementation`), with its default options: precision 8, threshold 1000, 3 items at each end,
//! 75 columns.

use crate::dynamic::{Array, ValueRef};

const COLUMNS: usize = 75;
const PRECISION: usize = 8;
const THRESHOLD: usize = 1000;
const EDGE_ITEMS: usize = 3;

/// `repr(array)`
pub(super) fn to_repr(array: &Array) -> String {
    const PREFIX: &str = "array(";
    // The dtype, unless it is the default of literals.
    let of_type = match array {
        Array::Float64(_) | Array::Int64(_) if !array.is_empty() => None,
        Array::Float64(_) => Some("float64"),
        Array::Float32(_) => Some("float32"),
        Array::Int8(_) => Some("int8"),
        Array::UInt8(_) => Some("uint8"),
        Array::Int16(_) => Some("int16"),
        Array::UInt16(_) => Some("uint16"),
        Array::Int32(_) => Some("int32"),
        Array::UInt32(_) => Some("uint32"),
        Array::UInt64(_) => Some("uint64"),
        _ => None,
    };
    let text = format!("{PREFIX}{}", listed(array, ", ", PREFIX.len(), COLUMNS - 1));
    let Some(of_type) = of_type else { return text + ")" };
    let text = text + ",";
    let last_line = text.len() - text.rfind('\n').map_or(0, |end| end + 1);
    let of_type = format!("dtype={of_type})");
    let is_too_long = last_line + of_type.len() + 1 > COLUMNS;
    let space = if is_too_long { format!("\n{}", " ".repeat(PREFIX.len())) } else { " ".into() };
    text + &space + &of_type
}

/// `str(array)`
pub(super) fn to_str(array: &Array) -> String {
    listed(array, " ", 0, COLUMNS)
}

fn listed(array: &Array, separator: &str, indentation: usize, columns: usize) -> String {
    let count = array.len();
    if count == 0 {
        return "[]".into();
    }
    let is_cut = count > THRESHOLD;
    let is_shown = |index: &usize| !is_cut || *index < EDGE_ITEMS || *index >= count - EDGE_ITEMS;
    let words = words(&(0..count).filter(is_shown).filter_map(|index| array.get(index)).collect::<Vec<_>>());
    let hanging = " ".repeat(indentation + 1);
    let width = columns - separator.trim_end().len().max(1);
    let (mut text, mut line) = (String::new(), hanging.clone());
    let mut add = |word: &str, is_last: bool| {
        if line.len() + word.len() > width && line.len() > hanging.len() {
            text.push_str(line.trim_end());
            text.push('\n');
            line.clone_from(&hanging);
        }
        line.push_str(word);
        line.push_str(if is_last { "" } else { separator });
    };
    for (index, word) in words.iter().enumerate() {
        if is_cut && index == EDGE_ITEMS {
            add("...", false);
        }
        add(word, index + 1 == words.len());
    }
    text.push_str(&line);
    format!("[{}]", &text[hanging.len()..])
}

/// The numbers, padded to the same width.
fn words(values: &[ValueRef<'_>]) -> Vec<String> {
    let is_float = matches!(values.first(), Some(ValueRef::Float32(_) | ValueRef::Float64(_)));
    if is_float {
        return float_words(values);
    }
    let texts = values.iter().map(|value| match value.as_i64() {
        Some(integer) => integer.to_string(),
        None => value.as_u64().unwrap_or_default().to_string(),
    });
    right_aligned(texts.collect())
}

fn float_words(values: &[ValueRef<'_>]) -> Vec<String> {
    let magnitudes = || {
        let finite = values.iter().filter_map(|value| value.as_f64()).filter(|value| value.is_finite());
        finite.map(f64::abs).filter(|magnitude| *magnitude != 0.0)
    };
    let (least, most) = magnitudes().fold((f64::MAX, 0.0_f64), |(a, b), m| (a.min(m), b.max(m)));
    let is_scientific =
        magnitudes().next().is_some() && (most >= 1e8 || least < 1e-4 || most / least > 1000.0);
    let parts: Vec<_> = values
        .iter()
        .map(|value| if is_scientific { scientific(*value) } else { positional(*value) })
        .collect();
    let width = |part: fn(&Number) -> usize| {
        parts.iter().filter(|number| number.is_finite).map(part).max().unwrap_or(0)
    };
    let (whole, fraction) = (width(|number| number.whole.len()), width(|number| number.fraction.len()));
    let texts =
        parts.iter().map(|Number { whole: digits, fraction: decimals, exponent, is_finite }| {
            match (is_finite, is_scientific) {
                (false, _) => digits.clone(),
                (true, false) => format!("{digits:>whole$}.{decimals:<fraction$}"),
                (true, true) => format!("{digits:>whole$}.{decimals:0<fraction$}e{exponent}"),
            }
        });
    right_aligned(texts.collect())
}

fn right_aligned(texts: Vec<String>) -> Vec<String> {
    let width = texts.iter().map(String::len).max().unwrap_or(0);
    texts.into_iter().map(|text| format!("{text:>width$}")).collect()
}

/// The characters of a number.
struct Number {
    /// With the sign; the whole word if not finite.
    whole: String,
    fraction: String,
    /// With its sign, or empty.
    exponent: String,
    is_finite: bool,
}

fn positional(value: ValueRef<'_>) -> Number {
    let number = value.as_f64().unwrap_or_default();
    if !number.is_finite() {
        return other(number);
    }
    let shortest = match value {
        ValueRef::Float32(value) => format!("{value}"),
        _ => format!("{number}"),
    };
    let decimals = shortest.split_once('.').map_or(0, |(_, decimals)| decimals.len());
    let text = if decimals > PRECISION { format!("{number:.PRECISION$}") } else { shortest };
    let (whole, fraction) = text.split_once('.').unwrap_or((&text, ""));
    let fraction = fraction.trim_end_matches('0').to_owned();
    Number { whole: whole.to_owned(), fraction, exponent: String::new(), is_finite: true }
}

fn scientific(value: ValueRef<'_>) -> Number {
    let number = value.as_f64().unwrap_or_default();
    if !number.is_finite() {
        return other(number);
    }
    let shortest = match value {
        ValueRef::Float32(value) => format!("{value:e}"),
        _ => format!("{number:e}"),
    };
    let digits = shortest
        .split_once('e')
        .map_or(0, |(mantissa, _)| mantissa.split_once('.').map_or(0, |(_, d)| d.len()));
    let text = if digits > PRECISION { format!("{number:.PRECISION$e}") } else { shortest };
    let (mantissa, exponent) = text.split_once('e').unwrap_or((&text, "0"));
    let (whole, fraction) = mantissa.split_once('.').unwrap_or((mantissa, ""));
    let (sign, exponent) = exponent.strip_prefix('-').map_or(('+', exponent), |digits| ('-', digits));
    Number {
        whole: whole.to_owned(),
        fraction: fraction.trim_end_matches('0').to_owned(),
        exponent: format!("{sign}{exponent:0>2}"),
        is_finite: true,
    }
}

fn other(number: f64) -> Number {
    let word = if number.is_nan() {
        "nan"
    } else if number > 0.0 {
        "inf"
    } else {
        "-inf"
    };
    Number { whole: word.into(), fraction: String::new(), exponent: String::new(), is_finite: false }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// What NumPy 2.4.6 prints.
    #[test]
    fn arrays_are_printed_as_in_numpy() {
        let cases: [(Array, &str, &str); 10] = [
            (vec![0.0; 3].into(), "array([0., 0., 0.])", "[0. 0. 0.]"),
            (vec![0.0, 9.81, 0.1].into(), "array([0.  , 9.81, 0.1 ])", "[0.   9.81 0.1 ]"),
            (vec![1e-5, 2.0].into(), "array([1.e-05, 2.e+00])", "[1.e-05 2.e+00]"),
            (vec![1.0, f64::NAN, f64::NEG_INFINITY].into(), "array([  1.,  nan, -inf])", "[  1.  nan -inf]"),
            (vec![1_i16, 200, -3].into(), "array([  1, 200,  -3], dtype=int16)", "[  1 200  -3]"),
            (
                vec![0.1_f32, 1.0 / 3.0].into(),
                "array([0.1       , 0.33333334], dtype=float32)",
                "[0.1        0.33333334]",
            ),
            (
                vec![1.0 / 3.0, 1e-5].into(),
                "array([3.33333333e-01, 1.00000000e-05])",
                "[3.33333333e-01 1.00000000e-05]",
            ),
            (
                vec![1.123_456_789_012, 20.5].into(),
                "array([ 1.12345679, 20.5       ])",
                "[ 1.12345679 20.5       ]",
            ),
            (vec![-1e-7, 0.0].into(), "array([-1.e-07,  0.e+00])", "[-1.e-07  0.e+00]"),
            (
                (0..16).collect::<Vec<u8>>().into(),
                "array([ 0,  1,  2,  3,  4,  5,  6,  7,  8,  9, 10, 11, 12, 13, 14, 15],\n      dtype=uint8)",
                "[ 0  1  2  3  4  5  6  7  8  9 10 11 12 13 14 15]",
            ),
        ];
        for (array, repr, str) in cases {
            assert_eq!((&*to_repr(&array), &*to_str(&array)), (repr, str));
        }
        let halves: Array = (0..40).map(|number| f64::from(number) * 0.5).collect::<Vec<_>>().into();
        let expected = "array([ 0. ,  0.5,  1. ,  1.5,  2. ,  2.5,  3. ,  3.5,  4. ,  4.5,  5. ,
        5.5,  6. ,  6.5,  7. ,  7.5,  8. ,  8.5,  9. ,  9.5, 10. , 10.5,
       11. , 11.5, 12. , 12.5, 13. , 13.5, 14. , 14.5, 15. , 15.5, 16. ,
       16.5, 17. , 17.5, 18. , 18.5, 19. , 19.5])";
        assert_eq!(to_repr(&halves), expected);
        assert!(to_str(&halves).starts_with(
            "[ 0.   0.5  1.   1.5  2.   2.5  3.   3.5  4.   4.5  5.   5.5  6.   6.5\n  7.   7.5"
        ));
        let many: Array = (0..1001).collect::<Vec<i64>>().into();
        assert_eq!(to_str(&many), "[   0    1    2 ...  998  999 1000]");
    }
}
