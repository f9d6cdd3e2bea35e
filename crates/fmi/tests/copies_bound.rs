//! The bound on private copies of libraries, in a process of its own.

#![allow(clippy::unwrap_used)]

mod support;

use fmi::ode::Ignore;
use fmi::{Pool, Sharing, SimulateOptions, SimulationPlan};
use std::sync::Arc;
use support::evil;

/// 64 copies and the library itself make 65 simulators at once; the 66th waits until the one that has the library itself
/// is returned.
#[test]
fn beyond_the_bound_simulations_take_turns() {
    let folder = evil(&["SHARED_GLOBALS"]);
    let options = SimulateOptions::new().parameters(["k"]).ncp(2);
    let pool = Pool::new(Arc::new(SimulationPlan::new(&folder.open(), &options).unwrap()));
    assert_eq!(pool.sharing().unwrap(), Sharing::PrivateCopies);
    let mut leases: Vec<_> = (0..65).map(|_| pool.lend().unwrap()).collect();
    for (i, lease) in leases.iter_mut().enumerate() {
        lease.run(&[f64::from(i as u32)], &mut Ignore).unwrap();
    }
    for (i, lease) in leases.iter_mut().enumerate() {
        assert_eq!(lease.get("twice_k").unwrap(), 2.0 * f64::from(i as u32));
    }
    let (sender, receiver) = std::sync::mpsc::channel();
    std::thread::scope(|scope| {
        scope.spawn(|| {
            let mut last = pool.lend().unwrap();
            last.run(&[0.5], &mut Ignore).unwrap();
            sender.send(last.get("twice_k").unwrap()).unwrap();
        });
        assert!(receiver.recv_timeout(std::time::Duration::from_millis(100)).is_err());
        drop(leases);
        assert_eq!(receiver.recv_timeout(std::time::Duration::from_secs(20)).unwrap(), 1.0);
    });
}
