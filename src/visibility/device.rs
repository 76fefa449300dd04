//! What culling asks of whatever draws: draw this, would these boxes show?

use crate::geometry::{Aabb, View};
use crate::ids::TreeNodeId;

/// A question that was put; valid until the end of the next frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct QueryId(pub u64);

/// What is known of a question.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Answer {
    /// Not known yet.
    Unknown,
    /// Samples of the boxes that passed the depth test. Devices that only tell none from some say 0
    /// or a number of at least 1.
    Samples(u64),
}

/// Draws and answers, in the order in which it was told.
///
/// A frame runs from [`begin_frame`](Self::begin_frame) to [`end_frame`](Self::end_frame). A
/// question sees the depth of all that was drawn before it, and perhaps of more: a device may draw
/// everything of a round before it answers the round's questions.
pub trait OcclusionDevice {
    /// Starts a picture: clears depth, remembers the view. Questions of the last frame can still
    /// be read.
    fn begin_frame(&mut self, view: &View);

    /// Draws all that a subtree holds.
    fn draw(&mut self, node: TreeNodeId);

    /// Asks whether any of these world boxes would show.
    fn query(&mut self, boxes: &[Aabb]) -> QueryId;

    /// Draws a subtree and asks whether it showed.
    fn draw_and_query(&mut self, node: TreeNodeId) -> QueryId;

    /// What is known of a question.
    fn answer(&mut self, query: QueryId) -> Answer;

    /// Hands everything recorded to whoever does it, and waits until a question is answered.
    fn wait(&mut self, query: QueryId);

    /// Hands the rest over; nothing is waited for.
    fn end_frame(&mut self);

    /// Changes between drawing and asking since the frame began.
    fn state_switches(&self) -> u64;

    /// Submissions since the frame began.
    fn rounds(&self) -> u64;
}
