//! How often and when a read that failed for a passing reason is tried again.
//!
//! Lines and disks that hesitate get a few more tries, each after a wait twice as long; what is
//! damaged or gone gets none ([`NodeReadError::is_transient`]).

use std::time::Duration;

use crate::store::NodeReadError;

/// Tries after the first.
pub const MOST_RETRIES: u32 = 4;
/// Wait before the first of them; each further one is twice as long, 0.75 s in all.
const FIRST_WAIT: Duration = Duration::from_millis(50);

/// Wait before a retry, counted from 0.
pub fn wait_before(retry: u32) -> Duration {
    FIRST_WAIT.saturating_mul(1 << retry.min(16))
}

/// Reads, again and again while that may help, and waits in between. Returns how often it was
/// tried again.
pub fn read_with_retries<T>(
    mut read: impl FnMut() -> Result<T, NodeReadError>,
) -> (Result<T, NodeReadError>, u32) {
    for retry in 0..MOST_RETRIES {
        match read() {
            Err(error) if error.is_transient() => std::thread::sleep(wait_before(retry)),
            other => return (other, retry),
        }
    }
    (read(), MOST_RETRIES)
}

#[cfg(test)]
mod tests {
    use std::io;

    use super::*;
    use crate::ids::NodeId;

    fn error(kind: io::ErrorKind) -> NodeReadError {
        let (level, start, end) = (0, 0, 1);
        let (node, section) = (NodeId(0), "positions".into());
        NodeReadError::Io { node, level, section, source: kind.into(), start, end }
    }

    #[test]
    fn what_passes_is_tried_again_and_what_stays_is_not() {
        let tries = |fails: u32, kind: io::ErrorKind| {
            let mut tried = 0;
            let (result, retries) = read_with_retries(|| {
                tried += 1;
                if tried <= fails { Err(error(kind)) } else { Ok(()) }
            });
            (result.is_ok(), tried, retries)
        };
        assert_eq!(tries(0, io::ErrorKind::TimedOut), (true, 1, 0));
        assert_eq!(tries(2, io::ErrorKind::TimedOut), (true, 3, 2));
        assert_eq!(tries(9, io::ErrorKind::ConnectionReset), (false, 5, 4), "bounded");
        assert_eq!(tries(1, io::ErrorKind::UnexpectedEof), (false, 1, 0), "it became shorter");
        assert_eq!(tries(1, io::ErrorKind::NotFound), (false, 1, 0));
        let waits: Vec<_> = (0..MOST_RETRIES).map(|retry| wait_before(retry).as_millis()).collect();
        assert_eq!(waits, [50, 100, 200, 400]);
    }
}
