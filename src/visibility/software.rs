//! The exact device: draws into an item buffer and counts samples, with answers as late as one
//! likes.

use std::collections::VecDeque;

use crate::geometry::{Aabb, View};
use crate::hierarchy::Bvh;
use crate::ids::TreeNodeId;
use crate::mesh::Model;
use crate::visibility::item_buffer::ItemBuffer;
use crate::visibility::{Answer, OcclusionDevice, QueryId};

/// What nodes hold, as something an item buffer can show.
pub trait Drawables {
    /// Draws all that a subtree holds; the number of pixels that passed the depth test.
    fn draw(&self, node: TreeNodeId, target: &mut ItemBuffer) -> u64;
}

/// The objects of a model under a tree over them; items are object ids.
#[derive(Clone, Copy, Debug)]
pub struct ModelLeaves<'a> {
    /// The objects.
    pub model: &'a Model,
    /// The tree.
    pub tree: &'a Bvh,
}

impl Drawables for ModelLeaves<'_> {
    fn draw(&self, node: TreeNodeId, target: &mut ItemBuffer) -> u64 {
        let mut passed = 0;
        for id in self.tree.objects_of(node) {
            let object = &self.model.objects[id.index()];
            let mesh = self.model.mesh(object);
            let place = |p: &[f32; 3]| {
                object.world_from_mesh.transform_point3(glam::Vec3::from(*p).as_dvec3())
            };
            passed += target.triangles(id.0, mesh.positions.iter().map(place), &mesh.triangles);
        }
        passed
    }
}

/// When answers are known.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Latency {
    /// After this many further commands (draws and questions), or when waited for: a GPU that works
    /// while it is fed.
    Commands(u64),
    /// When waited for; all that was recorded before is then known too: a GPU that works by
    /// submissions.
    Rounds,
    /// As `Rounds`, and each submission draws everything before it answers: questions see a fuller
    /// depth buffer, and drawing and asking change twice a submission.
    Batches,
}

/// Draws on the CPU and counts exactly.
pub struct SoftwareDevice<D> {
    drawables: D,
    picture: ItemBuffer,
    latency: Latency,
    commands: u64,
    /// Of the last frame and this one, the oldest first: samples, and the command's number.
    answers: VecDeque<(u64, u64)>,
    /// Questions of the present submission that wait for its draws, by number.
    waiting: Vec<(u64, Vec<Aabb>)>,
    /// Number of the first question in `answers`.
    first: u64,
    /// Number of the first question of this frame.
    first_of_frame: u64,
    /// Commands up to here were waited for.
    waited: u64,
    asking: Option<bool>,
    state_switches: u64,
    rounds: u64,
    /// Whether anything was recorded since the last submission.
    recorded: bool,
    /// What was drawn in this frame, in order.
    draws: Vec<TreeNodeId>,
}

impl<D: Drawables> SoftwareDevice<D> {
    /// A device that draws `drawables`.
    pub fn new(drawables: D, view: &View, latency: Latency) -> Self {
        SoftwareDevice {
            drawables,
            picture: ItemBuffer::new(view),
            latency,
            commands: 0,
            answers: VecDeque::new(),
            waiting: Vec::new(),
            first: 0,
            first_of_frame: 0,
            waited: 0,
            asking: None,
            state_switches: 0,
            rounds: 0,
            recorded: false,
            draws: Vec::new(),
        }
    }

    /// The picture so far.
    pub fn picture(&self) -> &ItemBuffer {
        &self.picture
    }

    /// What was drawn in this frame, in order.
    pub fn draws(&self) -> &[TreeNodeId] {
        &self.draws
    }

    /// What nodes hold; may be changed between frames.
    pub fn drawables_mut(&mut self) -> &mut D {
        &mut self.drawables
    }

    fn command(&mut self, asking: bool) {
        self.commands += 1;
        self.recorded = true;
        if self.latency == Latency::Batches && asking {
            // Counted when the submission gets to its questions.
            return;
        }
        self.switch(asking);
    }

    fn switch(&mut self, asking: bool) {
        if self.asking.is_some_and(|before| before != asking) {
            self.state_switches += 1;
        }
        self.asking = Some(asking);
    }

    fn answered(&mut self, samples: u64) -> QueryId {
        self.answers.push_back((samples, self.commands));
        QueryId(self.first + self.answers.len() as u64 - 1)
    }

    fn submit(&mut self) {
        if !self.recorded {
            return;
        }
        self.rounds += 1;
        self.recorded = false;
        let waiting = std::mem::take(&mut self.waiting);
        if !waiting.is_empty() {
            self.switch(true);
        }
        for (query, boxes) in waiting {
            let samples = boxes.iter().map(|bounds| self.picture.count_box(bounds)).sum();
            self.answers[(query - self.first) as usize].0 = samples;
        }
    }
}

impl<D: Drawables> OcclusionDevice for SoftwareDevice<D> {
    fn begin_frame(&mut self, view: &View) {
        self.picture.clear(view);
        let old = self.first_of_frame - self.first;
        self.answers.drain(..old as usize);
        self.first = self.first_of_frame;
        self.first_of_frame = self.first + self.answers.len() as u64;
        // A whole frame has passed: the last one's questions are answered.
        self.waited = self.commands;
        self.asking = None;
        self.state_switches = 0;
        self.rounds = 0;
        self.draws.clear();
    }

    fn draw(&mut self, node: TreeNodeId) {
        self.command(false);
        self.draws.push(node);
        self.drawables.draw(node, &mut self.picture);
    }

    fn query(&mut self, boxes: &[Aabb]) -> QueryId {
        self.command(true);
        if self.latency == Latency::Batches {
            let query = self.answered(0);
            self.waiting.push((query.0, boxes.to_vec()));
            return query;
        }
        let samples = boxes.iter().map(|bounds| self.picture.count_box(bounds)).sum();
        self.answered(samples)
    }

    fn draw_and_query(&mut self, node: TreeNodeId) -> QueryId {
        self.command(false);
        self.draws.push(node);
        let samples = self.drawables.draw(node, &mut self.picture);
        self.answered(samples)
    }

    fn answer(&mut self, query: QueryId) -> Answer {
        let (samples, command) = self.answers[(query.0 - self.first) as usize];
        let known = match self.latency {
            Latency::Commands(delay) => self.commands >= command + delay,
            Latency::Rounds | Latency::Batches => false,
        };
        if known || command <= self.waited { Answer::Samples(samples) } else { Answer::Unknown }
    }

    fn wait(&mut self, query: QueryId) {
        self.submit();
        let (_, command) = self.answers[(query.0 - self.first) as usize];
        self.waited = match self.latency {
            Latency::Commands(_) => self.waited.max(command),
            Latency::Rounds | Latency::Batches => self.commands,
        };
    }

    fn end_frame(&mut self) {
        self.submit();
    }

    fn state_switches(&self) -> u64 {
        self.state_switches
    }

    fn rounds(&self) -> u64 {
        self.rounds
    }
}
