//! Words of a formula with their columns.

use super::error::ExpressionError;

/// Word of a formula.
#[derive(Debug, Clone, PartialEq)]
pub(super) enum Token {
    Number(f64),
    /// A name. Quoted names are never functions or constants.
    Name {
        name: String,
        is_quoted: bool,
    },
    /// An operator, a comparison, a parenthesis or a comma.
    Sign(&'static str),
}

/// Word with its text and its column.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Word {
    pub(super) token: Token,
    pub(super) text: String,
    pub(super) column: usize,
}

/// Signs, longer ones first.
const SIGNS: [&str; 14] = ["**", "==", "<=", ">=", "+", "-", "*", "/", "(", ")", ",", "<", ">", "="];

/// Longest text in characters.
pub(super) const LONGEST: usize = 10_000;

fn starts_name(c: char) -> bool {
    c.is_alphabetic() || c == '_'
}

fn is_in_name(c: char) -> bool {
    c.is_alphanumeric() || c == '_'
}

/// Returns the words of a text.
pub(super) fn words(text: &str) -> Result<Vec<Word>, ExpressionError> {
    let letters: Vec<char> = text.chars().collect();
    let n = letters.len();
    if n > LONGEST {
        let message = format!("the expression has {n} characters; at most {LONGEST} are possible");
        return Err(ExpressionError::new("", 1, message));
    }
    let mut words = Vec::new();
    let mut at = 0;
    while at < n {
        let first = letters[at];
        if first.is_whitespace() {
            at += 1;
            continue;
        }
        let (token, end) = match first {
            '0'..='9' | '.' => number(text, &letters, at)?,
            '\'' | '"' => quoted(text, &letters, at)?,
            c if starts_name(c) => name(text, &letters, at)?,
            _ => sign(text, &letters, at)?,
        };
        words.push(Word { token, text: letters[at..end].iter().collect(), column: at + 1 });
        at = end;
    }
    Ok(words)
}

fn number(text: &str, letters: &[char], start: usize) -> Result<(Token, usize), ExpressionError> {
    let digits = |from: usize| from + letters[from..].iter().take_while(|c| c.is_ascii_digit()).count();
    let mut end = digits(start);
    if letters.get(end) == Some(&'.') {
        end = digits(end + 1);
    }
    if let Some('e' | 'E') = letters.get(end) {
        let sign = usize::from(matches!(letters.get(end + 1), Some('+' | '-')));
        let last = digits((end + 1 + sign).min(letters.len()));
        if last > end + 1 + sign {
            end = last;
        }
    }
    let written: String = letters[start..end].iter().collect();
    match written.parse::<f64>() {
        Ok(value) if value.is_finite() => Ok((Token::Number(value), end)),
        Ok(_) => Err(ExpressionError::new(text, start + 1, format!("{written} is too large"))),
        Err(_) => Err(ExpressionError::new(text, start + 1, format!("'{written}' is not a number"))),
    }
}

fn quoted(text: &str, letters: &[char], start: usize) -> Result<(Token, usize), ExpressionError> {
    let inside = &letters[start + 1..];
    match inside.iter().position(|c| *c == letters[start]) {
        None => Err(ExpressionError::new(text, start + 1, "the quote is not closed")),
        Some(0) => Err(ExpressionError::new(text, start + 1, "the name between the quotes is empty")),
        Some(n) => Ok((Token::Name { name: inside[..n].iter().collect(), is_quoted: true }, start + n + 2)),
    }
}

/// Reads `a`, `a.b`, `a[1].b` or `T0[run 1]`. The content of brackets is taken as it is.
fn name(text: &str, letters: &[char], start: usize) -> Result<(Token, usize), ExpressionError> {
    let mut end = start;
    loop {
        end += letters[end..].iter().take_while(|c| is_in_name(**c)).count();
        while letters.get(end) == Some(&'[') {
            match letters[end..].iter().position(|c| *c == ']') {
                None => return Err(ExpressionError::new(text, end + 1, "the bracket is not closed")),
                Some(1) => return Err(ExpressionError::new(text, end + 1, "the brackets are empty")),
                Some(n) => end += n + 1,
            }
        }
        let continues =
            letters.get(end) == Some(&'.') && letters.get(end + 1).is_some_and(|c| starts_name(*c));
        if !continues {
            break;
        }
        end += 1;
    }
    Ok((Token::Name { name: letters[start..end].iter().collect(), is_quoted: false }, end))
}

fn sign(text: &str, letters: &[char], start: usize) -> Result<(Token, usize), ExpressionError> {
    let starts_with =
        |sign: &&&str| sign.chars().enumerate().all(|(i, c)| letters.get(start + i) == Some(&c));
    if let Some(sign) = SIGNS.iter().find(starts_with) {
        return Ok((Token::Sign(sign), start + sign.len()));
    }
    let message = match letters[start] {
        '^' => "'^' is not an operator. Write ** for a power".to_owned(),
        '!' => "'!' is not an operator. Write ==, <= or >=".to_owned(),
        c @ ('≤' | '≥' | '≠') => format!("'{c}' is not used here. Write <= or >="),
        c @ ('−' | '–') => format!("'{c}' is not used here. Write -"),
        c if c.is_control() => format!("the character {c:?} is not used here"),
        c => format!("'{c}' is not used here. Quote names that contain it, 'my name'"),
    };
    Err(ExpressionError::new(text, start + 1, message))
}

/// True if a name is read as this name without quotes.
pub(super) fn is_plain(written: &str) -> bool {
    let letters: Vec<char> = written.chars().collect();
    let starts = letters.first().is_some_and(|c| starts_name(*c));
    let is_constant = super::function::constant(written).is_some();
    starts && !is_constant && matches!(name(written, &letters, 0), Ok((_, end)) if end == letters.len())
}
