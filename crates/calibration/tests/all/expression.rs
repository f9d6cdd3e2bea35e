//! Properties of formulas that hold for any text and any tree.

use calibration::{Expression, Relation};
use proptest::prelude::*;

/// A formula as text, fully parenthesised, with its value computed beside the parser.
#[derive(Debug, Clone)]
struct Made {
    text: String,
    value: f64,
    is_linear: bool,
}

const NAMES: [(&str, f64); 4] = [("a", 0.75), ("b.c[1]", -1.5), ("'my name'", 2.25), ("T0[run 1]", 0.125)];

fn leaf() -> impl Strategy<Value = Made> {
    prop_oneof![
        (0u32..1000, -3i32..3).prop_map(|(mantissa, exponent)| {
            let text = format!("{mantissa}e{exponent}");
            Made { value: text.parse().unwrap(), text, is_linear: true }
        }),
        (0usize..NAMES.len())
            .prop_map(|k| { Made { text: NAMES[k].0.to_owned(), value: NAMES[k].1, is_linear: true } }),
    ]
}

fn tree() -> impl Strategy<Value = Made> {
    leaf().prop_recursive(6, 60, 2, |inner| {
        let pair = (inner.clone(), inner.clone());
        prop_oneof![
            (pair.clone(), 0usize..4).prop_map(|((a, b), k)| {
                let value = [a.value + b.value, a.value - b.value, a.value * b.value, a.value / b.value][k];
                let text = format!("({} {} {})", a.text, ["+", "-", "*", "/"][k], b.text);
                Made { text, value, is_linear: k < 2 && a.is_linear && b.is_linear }
            }),
            inner.clone().prop_map(|a| Made { text: format!("(-{})", a.text), value: -a.value, ..a }),
            (inner, 0usize..4).prop_map(|(a, k)| {
                let value = [a.value.abs(), a.value.exp(), a.value.sqrt(), a.value.tanh()][k];
                let text = format!("{}({})", ["abs", "exp", "sqrt", "tanh"][k], a.text);
                Made { text, value, is_linear: false }
            }),
            pair.prop_map(|(a, b)| {
                let is_nan = a.value.is_nan() || b.value.is_nan();
                let value = if is_nan { f64::NAN } else { a.value.max(b.value) };
                Made { text: format!("max({}, {})", a.text, b.text), value, is_linear: false }
            }),
        ]
    })
}

fn values(expression: &Expression) -> Vec<f64> {
    let plain = |name: &str| name.trim_matches('\'').to_owned();
    let value = |name: &String| NAMES.iter().find(|(known, _)| plain(known) == *name).unwrap().1;
    expression.names().iter().map(value).collect()
}

/// Words that make most texts nearly correct.
fn words() -> impl Strategy<Value = String> {
    let word = prop::sample::select(vec![
        "a", "k[1]", "b.c", "'x y'", "\"q\"", "1", "2.5e-3", ".", "+", "-", "*", "**", "/", "^", "(", ")",
        ",", "==", "<=", ">=", "<", ">", "=", "!", "sqrt(", "max(", "atan2(", "foo(", "pi", "e", " ", "[",
        "]", "'", "é", "\u{0}",
    ]);
    prop::collection::vec(word, 0..30).prop_map(|words| words.concat())
}

fn check(text: &str) {
    let n = text.chars().count();
    match text.parse::<Expression>() {
        Ok(expression) => {
            let values = vec![0.5; expression.names().len()];
            expression.value(&values);
            assert_eq!(expression.derivatives(&values).len(), values.len());
            expression.linear_form();
            let again: Expression = expression.text().parse().unwrap();
            assert_eq!(again, expression);
        }
        Err(error) => {
            assert!((1..=n + 1).contains(&error.column), "{text:?}: {error:?}");
            assert!(!error.to_string().is_empty());
        }
    }
    match text.parse::<Relation>() {
        Ok(relation) => assert!(!relation.inequalities().is_empty()),
        Err(error) => assert!((1..=n + 1).contains(&error.column), "{text:?}: {error:?}"),
    }
}

proptest! {
    #[test]
    fn any_text_gives_a_formula_or_an_error_with_its_column(text: String) {
        check(&text);
    }

    #[test]
    fn nearly_correct_text_gives_a_formula_or_an_error_with_its_column(text in words()) {
        check(&text);
    }

    #[test]
    fn formula_has_the_value_of_its_tree(made in tree()) {
        let expression: Expression = made.text.parse().unwrap();
        let value = expression.value(&values(&expression));
        prop_assert!(value == made.value || value.is_nan() && made.value.is_nan(), "{} {}", value, made.value);
    }

    #[test]
    fn linear_form_has_the_value_and_the_derivatives_of_the_formula(made in tree()) {
        let expression: Expression = made.text.parse().unwrap();
        let values = values(&expression);
        let form = expression.linear_form();
        prop_assert!(form.is_some() || !made.is_linear);
        if let Some(form) = form {
            let slopes = expression.derivatives(&values);
            let of_form: Vec<f64> = form.coefficients.iter().map(|(_, slope)| *slope).collect();
            for (slope, expected) in of_form.iter().zip(&slopes) {
                prop_assert!((slope - expected).abs() <= 1e-9 * (1.0 + expected.abs()), "{:?} {:?}", of_form, slopes);
            }
            let terms = of_form.iter().zip(&values).map(|(slope, value)| slope * value);
            let (size, sum) = terms.fold((form.constant.abs(), form.constant), |(size, sum), term| {
                (size + term.abs(), sum + term)
            });
            let value = expression.value(&values);
            prop_assert!((sum - value).abs() <= 1e-9 * (1.0 + size), "{} {}", sum, value);
        }
    }
}
