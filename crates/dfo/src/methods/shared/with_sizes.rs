//! A search that first determines unknown parameter sizes (`size_search.rs`), for methods that start from a
//! point.

use super::size_search::{SizeFound, SizeSearch};
use crate::error::Error;
use crate::method_interface::interface::{
    AnswersSoFar, Batch, Method, MethodDetails, Setup, Status, restored, saved,
};
use crate::outcome::answer::{Answers, Best};
use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};

/// Options of a method that needs the sizes of all parameters.
pub trait NeedsSizes: Clone + Serialize + DeserializeOwned {
    /// Name of the method.
    const NAME: &'static str;

    /// Search with known sizes.
    type Search: Method + Serialize + DeserializeOwned;

    /// Starts the search with known sizes.
    ///
    /// # Errors
    /// Returns the errors of the method.
    fn search(&self, setup: Setup) -> Result<Self::Search, Error>;

    /// True if a search is consistent with itself and with the problem. State loaded from a file may be
    /// inconsistent.
    fn is_sound(search: &Self::Search, setup: &Setup) -> bool;
}

/// A running search that first varies each parameter of unknown size alone, with steps of powers of ten.
#[derive(Debug, Clone, Serialize, Deserialize)]
#[serde(bound = "")]
pub struct WithSizes<O: NeedsSizes> {
    options: O,
    setup: Setup,
    sizes: Option<SizeSearch>,
    /// The search, and its setup with the point and sizes found.
    search: Option<(Setup, O::Search)>,
    /// Line of each point of the last batch; `None` for the start point.
    roles: Vec<Option<usize>>,
    waiting: bool,
    n_batches: u64,
    n_points: u64,
    best: Best,
}

/// With constraints, unknown sizes stay 1, because steps of powers of ten along a parameter leave the
/// feasible set.
fn knows_sizes(setup: &Setup) -> bool {
    let has_constraints = setup.space.has_linear() || !setup.constraints.nonlinear.is_empty();
    has_constraints
        || !setup.start_given
        || (0..setup.space.n_free()).all(|k| !setup.space.size_is_unknown(k))
}

impl<O: NeedsSizes> WithSizes<O> {
    pub(crate) fn begin(options: &O, setup: Setup) -> Result<Self, Error> {
        let search = match knows_sizes(&setup) {
            true => Some((setup.clone(), options.search(setup.clone())?)),
            false => None,
        };
        Ok(Self::of(options, setup, search))
    }

    fn of(options: &O, setup: Setup, search: Option<(Setup, O::Search)>) -> Self {
        Self {
            options: options.clone(),
            setup,
            sizes: None,
            search,
            roles: Vec::new(),
            waiting: false,
            n_batches: 0,
            n_points: 0,
            best: Best::default(),
        }
    }

    /// Restores a state saved for this problem.
    pub(crate) fn restore(options: &O, setup: Setup, state: &[u8]) -> Result<Self, Error> {
        if knows_sizes(&setup) {
            let search = restored(state, |search: &O::Search| O::is_sound(search, &setup))?;
            return Ok(Self::of(options, setup.clone(), Some((setup, search))));
        }
        restored(state, |s: &Self| {
            s.setup.space == setup.space
                && s.sizes.as_ref().is_none_or(|sizes| sizes.is_sound(&setup.space))
                && s.best.is_sound(setup.space.n())
                && s.search.as_ref().is_none_or(|(begun, search)| {
                    let x0 = begun.space.x0();
                    x0.len() == setup.space.n()
                        && setup.space.bounds().contains(x0)
                        && setup.space.starting_at(x0).is_same_space(&begun.space)
                        && O::is_sound(search, begun)
                })
        })
    }

    /// Returns the search with known sizes, if it has started.
    pub(crate) fn search(&self) -> Option<&O::Search> {
        self.search.as_ref().map(|(_, search)| search)
    }

    /// Starts the search after all sizes that can be determined are known.
    fn begin_search(&mut self) -> Result<(), Error> {
        let mut begun = self.setup.clone();
        if let Some(sizes) = &self.sizes {
            begun.space = begun.space.starting_at(sizes.best().map_or(sizes.base().0, |(x, _)| x));
            for SizeFound { k, size, .. } in sizes.found(&self.setup.space) {
                begun.space.set_unit(k, size);
            }
        }
        let search = self.options.search(begun.clone())?;
        self.search = Some((begun, search));
        Ok(())
    }
}

impl<O: NeedsSizes> Method for WithSizes<O> {
    fn name(&self) -> &'static str {
        O::NAME
    }

    fn ask(&mut self, batch: &mut Batch) {
        if let Some((_, search)) = &mut self.search {
            search.ask(batch);
            batch.renumber(self.n_batches + batch.index(), self.n_points);
            return;
        }
        batch.start(self.setup.space.n(), self.n_batches, self.n_points);
        self.roles.clear();
        let Self { sizes, roles, setup, .. } = self;
        match sizes {
            Some(sizes) => sizes.ask(&setup.space, batch, |line| roles.push(Some(line))),
            None => {
                batch.push(setup.space.x0(), f64::INFINITY);
                roles.push(None);
            }
        }
        self.waiting = true;
    }

    fn speculate(&mut self, wanted: usize, answers_so_far: &dyn AnswersSoFar, batch: &mut Batch) {
        if let Some((_, search)) = &mut self.search {
            search.speculate(wanted, answers_so_far, batch);
        }
    }

    fn tell(&mut self, answers: &Answers) -> Result<(), Error> {
        if let Some((_, search)) = &mut self.search {
            return search.tell(answers);
        }
        let (requested, outcomes) = (self.roles.len(), answers.outcomes());
        if !self.waiting {
            return Err(Error::TellWithoutAsk);
        }
        if outcomes.len() > requested {
            return Err(Error::TooManyOutcomes { requested, received: outcomes.len() });
        }
        self.waiting = false;
        self.n_batches += 1;
        self.n_points += requested as u64;
        let space = &self.setup.space;
        for (outcome, role) in outcomes.iter().zip(&self.roles).filter(|(outcome, _)| outcome.is_conclusive())
        {
            match (role, &mut self.sizes, outcome.value()) {
                (Some(line), Some(sizes), cost) => sizes.see(space, *line, cost),
                (_, _, Some(cost)) => {
                    self.best.offer(space.x0(), cost);
                    self.sizes = Some(SizeSearch::from_start(space, space.x0(), cost));
                }
                // Without a cost at the start, no comparison is possible.
                (_, _, None) => return self.begin_search(),
            }
        }
        match &self.sizes {
            Some(sizes) if sizes.is_over() => self.begin_search(),
            _ => Ok(()),
        }
    }

    fn status(&self) -> Status {
        self.search().map_or(Status::Running, Method::status)
    }

    fn details(&self) -> MethodDetails<'_> {
        let details = self.search().map_or_else(MethodDetails::default, Method::details);
        let unmoved = |sizes: &SizeSearch| sizes.without_effect(&self.setup.space).collect();
        MethodDetails { without_effect: self.sizes.as_ref().map_or_else(Vec::new, unmoved), ..details }
    }

    fn best(&self) -> Option<(&[f64], f64)> {
        let seen = [
            self.best.get(),
            self.sizes.as_ref().and_then(SizeSearch::best),
            self.search().and_then(Method::best),
        ];
        seen.into_iter().flatten().reduce(|best, other| if other.1 < best.1 { other } else { best })
    }

    fn best_violation(&self) -> f64 {
        // With constraints, there is only the search.
        self.search().map_or(0.0, Method::best_violation)
    }

    fn save(&self) -> Option<Vec<u8>> {
        match &self.search {
            Some((_, search)) if knows_sizes(&self.setup) => search.save(),
            _ => saved(self),
        }
    }
}
