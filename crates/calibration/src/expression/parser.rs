//! Parser of formulas: recursive descent with a bounded depth, which emits the steps of a program.

use super::error::ExpressionError;
use super::formula::{Criterion, Expression, Step};
use super::function::{Function, constant, nearest};
use super::functional::Functional;
use super::lexer::{Token, Word, words};
use std::str::FromStr;

/// Deepest nesting of parentheses, functions, signs and powers. Each level takes at most six calls.
const DEEPEST: usize = 100;

/// Comparisons of relations.
const COMPARISONS: [&str; 5] = ["==", "<=", ">=", "<", ">"];

pub(super) struct Parser<'t> {
    text: &'t str,
    words: Vec<Word>,
    at: usize,
    depth: usize,
    /// The expression so far.
    made: Expression,
}

/// Parses an expression that fills the text.
pub(super) fn expression(text: &str) -> Result<Expression, ExpressionError> {
    let mut parser = Parser::new(text)?;
    let mut made = parser.sum_of_its_own()?;
    if let Some(word) = parser.next() {
        let is_comparison = matches!(&word.token, Token::Sign(sign) if COMPARISONS.contains(sign));
        return Err(match is_comparison {
            true => parser.error(&word, format!("'{}' is a relation, but a value is expected", word.text)),
            false => parser.unexpected(&word),
        });
    }
    made.text = text.to_owned();
    Ok(made)
}

impl<'t> Parser<'t> {
    pub(super) fn new(text: &'t str) -> Result<Self, ExpressionError> {
        let words = words(text)?;
        if words.is_empty() {
            return Err(ExpressionError::new(text, 1, "the expression is empty"));
        }
        Ok(Self { text, words, at: 0, depth: 0, made: Expression::empty(text) })
    }

    /// Returns the column of the next word.
    pub(super) fn column(&self) -> usize {
        self.words.get(self.at).map_or(1, |word| word.column)
    }

    /// Parses a sum as a separate expression, whose columns are those of the whole text.
    pub(super) fn sum_of_its_own(&mut self) -> Result<Expression, ExpressionError> {
        let first = self.at;
        let outer = std::mem::replace(&mut self.made, Expression::empty(""));
        self.sum()?;
        let letters = |word: &Word| word.column - 1..word.column - 1 + word.text.chars().count();
        let span = match (self.words.get(first), self.words.get(self.at - 1)) {
            (Some(one), Some(last)) => letters(one).start..letters(last).end,
            _ => 0..0,
        };
        let mut made = std::mem::replace(&mut self.made, outer);
        made.text = self.text.chars().skip(span.start).take(span.len()).collect();
        Ok(made)
    }

    /// Returns the next comparison, if there is one.
    pub(super) fn comparison(&mut self) -> Option<&'static str> {
        COMPARISONS.into_iter().find(|sign| self.take(sign).is_some())
    }

    pub(super) fn error(&self, word: &Word, message: impl Into<String>) -> ExpressionError {
        ExpressionError::new(self.text, word.column, message)
    }

    pub(super) fn error_at_end(&self, message: impl Into<String>) -> ExpressionError {
        ExpressionError::new(self.text, self.text.trim_end().chars().count() + 1, message)
    }

    pub(super) fn next(&self) -> Option<Word> {
        self.words.get(self.at).cloned()
    }

    /// Takes the next word if it is this sign.
    fn take(&mut self, sign: &str) -> Option<Word> {
        let word =
            self.words.get(self.at).filter(|word| matches!(word.token, Token::Sign(s) if s == sign))?;
        self.at += 1;
        Some(word.clone())
    }

    /// Returns the error of a word after a complete expression.
    pub(super) fn unexpected(&self, word: &Word) -> ExpressionError {
        let message = match word.token {
            Token::Sign("=") => "'=' is not an operator. Write == for equality".to_owned(),
            Token::Sign(")") => "')' has no '('".to_owned(),
            Token::Sign(",") => {
                "a comma separates arguments of a function. Use a decimal point in numbers".to_owned()
            }
            _ => format!("expected an operator before '{}'", word.text),
        };
        self.error(word, message)
    }

    fn sum(&mut self) -> Result<(), ExpressionError> {
        self.chain(&[("+", Step::Add), ("-", Step::Subtract)], Self::product)
    }

    fn product(&mut self) -> Result<(), ExpressionError> {
        self.chain(&[("*", Step::Multiply), ("/", Step::Divide)], Self::sign)
    }

    /// Parses operands joined by operators, from left to right.
    fn chain(
        &mut self,
        operators: &[(&str, Step)],
        operand: fn(&mut Self) -> Result<(), ExpressionError>,
    ) -> Result<(), ExpressionError> {
        operand(self)?;
        while let Some((_, step)) = operators.iter().find(|(sign, _)| self.take(sign).is_some()) {
            operand(self)?;
            self.made.program.push(*step);
        }
        Ok(())
    }

    fn sign(&mut self) -> Result<(), ExpressionError> {
        let is_negative = self.take("-").is_some();
        if !is_negative && self.take("+").is_none() {
            return self.power();
        }
        self.nested(Self::sign)?;
        if is_negative {
            self.made.program.push(Step::Negate);
        }
        Ok(())
    }

    fn power(&mut self) -> Result<(), ExpressionError> {
        self.atom()?;
        if self.take("**").is_some() {
            self.nested(Self::sign)?;
            self.made.program.push(Step::Power);
        }
        Ok(())
    }

    fn nested(
        &mut self,
        parse: impl FnOnce(&mut Self) -> Result<(), ExpressionError>,
    ) -> Result<(), ExpressionError> {
        if self.depth == DEEPEST {
            let message = format!("more than {DEEPEST} parentheses, signs or powers are nested");
            return Err(match self.next() {
                Some(word) => self.error(&word, message),
                None => self.error_at_end(message),
            });
        }
        self.depth += 1;
        parse(self)?;
        self.depth -= 1;
        Ok(())
    }

    fn atom(&mut self) -> Result<(), ExpressionError> {
        let Some(word) = self.next() else {
            return Err(self.error_at_end("a number, a name or '(' is missing at the end"));
        };
        self.at += 1;
        match &word.token {
            Token::Number(value) => self.made.program.push(Step::Number(*value)),
            Token::Sign("(") => {
                self.nested(Self::sum)?;
                self.close(&word)?;
            }
            Token::Name { name, is_quoted: false } if self.take("(").is_some() => self.call(&word, name)?,
            Token::Name { name, is_quoted } => match constant(name).filter(|_| !is_quoted) {
                Some((name, value)) => {
                    if self.made.constants.iter().all(|(known, _)| *known != name) {
                        self.made.constants.push((name, word.column));
                    }
                    self.made.program.push(Step::Number(value));
                }
                None => {
                    self.name(name, word.column);
                }
            },
            Token::Sign(sign) => {
                let message = match *sign {
                    "," | ")" if self.at >= 2 && self.words[self.at - 2].text == "(" => {
                        format!("an argument is missing before '{sign}'")
                    }
                    sign => format!("expected a number, a name or '(', not '{sign}'"),
                };
                return Err(self.error(&word, message));
            }
        }
        Ok(())
    }

    fn name(&mut self, name: &str, column: usize) -> usize {
        let index = self.made.index_of(name, column);
        self.made.program.push(Step::Name(index));
        index
    }

    fn close(&mut self, opened: &Word) -> Result<(), ExpressionError> {
        if self.take(")").is_some() {
            return Ok(());
        }
        match self.next() {
            None => {
                let is_function = opened.text != "(";
                let column = opened.column + if is_function { opened.text.chars().count() } else { 0 };
                Err(self.error_at_end(format!("')' is missing; '(' is at column {column}")))
            }
            Some(word) => Err(self.unexpected(&word)),
        }
    }

    /// Parses the arguments of a function or a criterion after its parenthesis.
    fn call(&mut self, word: &Word, name: &str) -> Result<(), ExpressionError> {
        let (function, functional) = (Function::of_name(name), Functional::of_name(name));
        if function.is_none() && functional.is_none() {
            let like = like(name).map_or_else(
                || format!("; available: {}", available().collect::<Vec<_>>().join(", ")),
                |like| format!("; '{like}'?"),
            );
            return Err(self.error(word, format!("'{name}' is not a function{like}")));
        }
        let mut arguments = Vec::new();
        self.nested(|parser| {
            loop {
                arguments.push(parser.sum_of_its_own()?);
                if parser.take(",").is_none() {
                    return Ok(());
                }
            }
        })?;
        self.close(word)?;
        // `max` and `min` of one argument are criteria.
        let functional = functional.filter(|_| function.is_none() || arguments.len() == 1);
        let (least, most) = match (functional, function) {
            (Some(functional), _) => {
                let (least, most) = functional.n_arguments();
                (least, Some(most))
            }
            (None, function) => function.map_or((1, None), Function::n_arguments),
        };
        let n = arguments.len();
        if n < least || most.is_some_and(|most| n > most) {
            let at_least = match most {
                None => format!("at least {least}"),
                Some(most) if most > least => format!("{least} to {most}"),
                Some(_) => least.to_string(),
            };
            let noun = if most.unwrap_or(least) == 1 { "argument" } else { "arguments" };
            let verb = if n == 1 { "is" } else { "are" };
            return Err(self.error(word, format!("{name} has {at_least} {noun}, but {n} {verb} given")));
        }
        match (functional, function) {
            (Some(functional), _) => self.criterion(word, Criterion { functional, arguments })?,
            (None, Some(function)) => {
                for (k, argument) in arguments.iter().enumerate() {
                    self.made.append(argument);
                    // More than two arguments of min and max are several calls.
                    if k > 0 || n == 1 {
                        self.made.program.push(Step::Call(function));
                    }
                }
            }
            (None, None) => {}
        }
        Ok(())
    }

    /// Adds a criterion. The formula treats its text like a name.
    fn criterion(&mut self, word: &Word, criterion: Criterion) -> Result<(), ExpressionError> {
        let text = criterion.text();
        if let Some(inner) = criterion.arguments.iter().flat_map(Expression::criteria).next() {
            let message =
                format!("{} is one number, so it has no {}", inner.text(), criterion.functional.name());
            return Err(self.error(word, message));
        }
        if let Some(first) = criterion.arguments.first().filter(|first| first.names.is_empty()) {
            return Err(self.error(word, format!("{} contains no variable of the model", first.text)));
        }
        if let Some(band) = criterion.arguments.get(2) {
            let value = if band.names.is_empty() { band.value(&[]) } else { f64::NAN };
            if !(value > 0.0 && value < 1.0) {
                let message =
                    format!("the band of {text} must be a number between 0 and 1, not {}", band.text);
                return Err(self.error(word, message));
            }
        }
        let index = self.name(&text, word.column);
        if self.made.criteria.iter().all(|(listed, _)| *listed != index) {
            self.made.criteria.push((index, criterion));
        }
        Ok(())
    }
}

/// Returns the names of all functions and criteria, without duplicates.
fn available() -> impl Iterator<Item = &'static str> {
    Function::names().chain(Functional::names().filter(|name| Function::of_name(name).is_none()))
}

/// Returns what to write instead of an unknown function or criterion.
fn like(name: &str) -> Option<&'static str> {
    let last = name.rsplit('.').next().unwrap_or(name);
    Function::spelled(last).or_else(|| Functional::spelled(last)).or_else(|| nearest(last, available()))
}

impl FromStr for Expression {
    type Err = ExpressionError;

    fn from_str(text: &str) -> Result<Self, ExpressionError> {
        expression(text)
    }
}

impl TryFrom<String> for Expression {
    type Error = ExpressionError;

    fn try_from(text: String) -> Result<Self, ExpressionError> {
        text.parse()
    }
}

#[cfg(test)]
mod tests {
    use super::super::formula::quoted;
    use super::*;

    #[test]
    fn expressions_have_the_precedence_of_python() {
        for (text, expected) in [
            ("2 + 3 * 4", 14.0),
            ("(2 + 3) * 4", 20.0),
            ("2 - 3 - 4", -5.0),
            ("16 / 4 / 2", 2.0),
            ("-2 ** 2", -4.0),
            ("2 ** -1", 0.5),
            ("2 ** 3 ** 2", 512.0),
            ("2 * -3", -6.0),
            ("+-+3", -3.0),
            ("1.5e2 + .5 + 2.", 152.5),
            ("2E-1", 0.2),
            ("max(1, min(5, 3), 2)", 3.0),
            ("abs(-3) + sqrt(16)", 7.0),
            ("log(e) + log10(1000) + exp(0)", 5.0),
            ("cos(pi)", -1.0),
            ("atan2(1, 1) * 4 - pi", 0.0),
        ] {
            let expression: Expression = text.parse().unwrap();
            assert_eq!(expression.value(&[]), expected, "{text}");
        }
    }

    #[test]
    fn names_are_read_as_in_fmi() {
        for (text, expected) in [
            ("arm.friction * k[1]", &["arm.friction", "k[1]"][..]),
            ("a.b[2,3].c_1 + T0[run 1]", &["a.b[2,3].c_1", "T0[run 1]"]),
            ("'my name' - \"it's\"", &["my name", "it's"]),
            ("'e' + \"arm.'a b'.k\"", &["e", "arm.'a b'.k"]),
            ("x + y + x", &["x", "y"]),
            ("exp + exp(max)", &["exp", "max"]),
            ("größe + _a", &["größe", "_a"]),
        ] {
            let expression: Expression = text.parse().unwrap();
            assert_eq!(expression.names(), expected, "{text}");
        }
        for name in ["arm.friction", "k[1]", "my name", "it's", "e", "2a", "a.", "T0[run 1]", "a-b"] {
            let expression: Expression = quoted(name).parse().unwrap();
            assert_eq!(expression.names(), [name]);
            assert_eq!(
                Expression::affine(name, 2.0, -1.0).text().parse::<Expression>().unwrap().names(),
                [name]
            );
        }
    }

    #[test]
    fn errors_have_column_and_remedy() {
        for (text, column, expected) in [
            ("", 1, "the expression is empty"),
            ("  ", 1, "the expression is empty"),
            ("a ^ 2", 3, "Write ** for a power"),
            ("a b", 3, "expected an operator before 'b'"),
            ("2a", 2, "expected an operator before 'a'"),
            ("a +", 4, "a number, a name or '(' is missing at the end"),
            ("(a + b", 7, "')' is missing; '(' is at column 1"),
            ("a + b)", 6, "')' has no '('"),
            ("a * * b", 5, "expected a number, a name or '(', not '*'"),
            ("a, b", 2, "a comma separates arguments of a function"),
            ("1,5 * a", 2, "decimal point"),
            ("sqr(a)", 1, "'sqr' is not a function; 'sqrt'?"),
            ("ln(a)", 1, "'ln' is not a function; 'log'?"),
            ("np.exp(a)", 1, "'np.exp' is not a function; 'exp'?"),
            ("log(a, b)", 1, "log has 1 argument, but 2 are given"),
            ("atan2(a)", 1, "atan2 has 2 arguments, but 1 is given"),
            ("abs(a", 6, "')' is missing; '(' is at column 4"),
            ("ise(y, 1, 2)", 1, "ise has 1 to 2 arguments, but 3 are given"),
            ("1 + final(max(y))", 5, "max(y) is one number, so it has no final"),
            ("max(1 + 2)", 1, "1 + 2 contains no variable of the model"),
            ("settling_time(y, 1, 2)", 1, "must be a number between 0 and 1, not 2"),
            ("maximum(y)", 1, "'maximum' is not a function; 'max'?"),
            ("sqrt()", 6, "an argument is missing"),
            ("'abc", 1, "the quote is not closed"),
            ("''", 1, "the name between the quotes is empty"),
            ("k[1", 2, "the bracket is not closed"),
            ("k[]", 2, "the brackets are empty"),
            ("a ≤ b", 3, "'≤' is not used here"),
            ("1e999", 1, "is too large"),
            ("1.2.3", 4, "expected an operator before '.3'"),
            ("a = b", 3, "Write == for equality"),
            ("a == b", 3, "is a relation"),
            ("a <= b", 3, "is a relation"),
            ("a and b", 3, "expected an operator"),
            ("a // b", 4, "expected a number"),
            ("a\u{0}b", 2, "is not used here"),
        ] {
            let error = text.parse::<Expression>().unwrap_err();
            assert_eq!(error.column, column, "{text}: {error}");
            assert!(error.to_string().contains(expected), "{text}: {error}");
        }
        let shown = "1 - k1 ^ 2".parse::<Expression>().unwrap_err().to_string();
        assert_eq!(
            shown,
            "'^' is not an operator. Write ** for a power (column 8)\n    1 - k1 ^ 2\n           ^"
        );
    }

    #[test]
    fn long_and_deep_texts_end_in_an_error_or_a_value() {
        let sum = vec!["1"; 2000].join(" + ");
        assert_eq!(sum.parse::<Expression>().unwrap().value(&[]), 2000.0);
        for deep in [
            "(".repeat(4000),
            "-".repeat(4000) + "1",
            "1**".repeat(1000) + "1",
            "abs(".repeat(900),
            format!("{}1{}", "(".repeat(500), ")".repeat(500)),
        ] {
            let error = deep.parse::<Expression>().unwrap_err();
            assert!(error.to_string().contains("nested"), "{error}");
        }
        let long = vec!["1"; 20_000].join("+");
        assert!(long.parse::<Expression>().unwrap_err().to_string().contains("characters"), "length");
        // A long text is shown around the mistake.
        let shown =
            format!("{} ^ 1", vec!["a"; 1000].join(" + ")).parse::<Expression>().unwrap_err().to_string();
        assert!(shown.chars().count() < 300, "{shown}");
    }

    #[test]
    fn expression_survives_json_as_its_text() {
        let expression: Expression = " 1 -  k1*2".parse().unwrap();
        let json = serde_json::to_string(&expression).unwrap();
        assert_eq!(json, "\" 1 -  k1*2\"");
        assert_eq!(serde_json::from_str::<Expression>(&json).unwrap(), expression);
        assert!(serde_json::from_str::<Expression>("\"1 +\"").unwrap_err().to_string().contains("column 4"));
    }
}
