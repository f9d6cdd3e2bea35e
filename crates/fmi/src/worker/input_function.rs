//! Functions of time that drive inputs. They run in the process that created them. A worker process requests
//! each value from its caller while it answers.

use super::frame::{Frame, is_in_frame};
use serde::de::Error as _;
use serde::ser::Error as _;
use serde::{Deserialize, Deserializer, Serialize, Serializer};
use std::cell::RefCell;
use std::collections::BTreeMap;
use std::fmt;
use std::io;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, PoisonError, Weak};

/// A function of time that drives an input.
///
/// In a message to a worker process, the function is serialized as a number, with which the worker requests
/// values from this process. It cannot be serialized elsewhere.
#[derive(Clone)]
pub struct InputFunction(Arc<Numbered>);

struct Numbered {
    number: u64,
    /// Number of the function in the caller of this worker process, if it belongs to the caller.
    of_caller: Option<u64>,
    function: Box<dyn Fn(f64) -> f64 + Send + Sync>,
}

/// Functions of this process that still exist, by number.
static FUNCTIONS: Mutex<BTreeMap<u64, Weak<Numbered>>> = Mutex::new(BTreeMap::new());

impl Drop for Numbered {
    fn drop(&mut self) {
        FUNCTIONS.lock().unwrap_or_else(PoisonError::into_inner).remove(&self.number);
    }
}

impl InputFunction {
    /// Creates a function of this process.
    pub fn new(function: impl Fn(f64) -> f64 + Send + Sync + 'static) -> Self {
        Self::numbered(None, Box::new(function))
    }

    fn numbered(of_caller: Option<u64>, function: Box<dyn Fn(f64) -> f64 + Send + Sync>) -> Self {
        static NEXT: AtomicU64 = AtomicU64::new(0);
        let number = NEXT.fetch_add(1, Ordering::Relaxed);
        let registered = Arc::new(Numbered { number, of_caller, function });
        FUNCTIONS.lock().unwrap_or_else(PoisonError::into_inner).insert(number, Arc::downgrade(&registered));
        Self(registered)
    }

    /// Returns the value at a time.
    pub fn value(&self, time: f64) -> f64 {
        (self.0.function)(time)
    }

    /// True if both are the same function.
    pub fn is_same(&self, other: &Self) -> bool {
        Arc::ptr_eq(&self.0, &other.0)
            || (self.0.of_caller.is_some() && self.0.of_caller == other.0.of_caller)
    }

    /// Returns the value of the function of this process with this number; NaN if it no longer exists.
    pub(crate) fn value_of(number: u64, time: f64) -> f64 {
        let function =
            FUNCTIONS.lock().unwrap_or_else(PoisonError::into_inner).get(&number).and_then(Weak::upgrade);
        function.map_or(f64::NAN, |numbered| (numbered.function)(time))
    }
}

impl fmt::Debug for InputFunction {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("function")
    }
}

impl Serialize for InputFunction {
    fn serialize<S: Serializer>(&self, to: S) -> Result<S::Ok, S::Error> {
        match is_in_frame() {
            true => self.0.number.serialize(to),
            false => Err(S::Error::custom("functions of time cannot be stored")),
        }
    }
}

impl<'de> Deserialize<'de> for InputFunction {
    fn deserialize<D: Deserializer<'de>>(from: D) -> Result<Self, D::Error> {
        let number = u64::deserialize(from)?;
        match is_in_frame() {
            true => Ok(Self::numbered(Some(number), Box::new(move |time| ask_for_value(number, time)))),
            false => Err(D::Error::custom("the function of time was not stored")),
        }
    }
}

/// A request for a value.
#[derive(Serialize, Deserialize)]
struct ValueRequest {
    function: u64,
    time: f64,
}

/// Sends a frame to the caller, and reads the reply into it.
pub(super) type Exchange = Box<dyn FnMut(&mut Frame) -> io::Result<()>>;

thread_local! {
    /// Connection of the thread that answers the caller.
    static CALLER: RefCell<Option<(Exchange, Frame)>> = const { RefCell::new(None) };
}

/// Sets the connection through which this thread requests values from its caller.
pub(super) fn set_caller(exchange: Exchange) {
    CALLER.set(Some((exchange, Frame::default())));
}

/// Requests the value of one of its functions from the caller of this worker process. Returns NaN if the
/// caller does not answer.
fn ask_for_value(function: u64, time: f64) -> f64 {
    let ask = |(exchange, frame): &mut (Exchange, Frame)| {
        frame.clear();
        frame.is_asking = true;
        frame.set_head(&ValueRequest { function, time })?;
        exchange(frame)?;
        Ok::<_, io::Error>(frame.numbers.first().copied())
    };
    CALLER.with_borrow_mut(|caller| {
        caller.as_mut().and_then(|caller| ask(caller).ok().flatten()).unwrap_or(f64::NAN)
    })
}

/// Replaces a request for a value by the answer.
pub(super) fn answer_request(frame: &mut Frame) -> io::Result<()> {
    let ValueRequest { function, time } = frame.head()?;
    frame.clear();
    frame.numbers.push(InputFunction::value_of(function, time));
    Ok(())
}

/// Maximum size of such an answer.
pub(super) const VALUE: super::frame::FrameSize = super::frame::FrameSize::of_numbers(1);
